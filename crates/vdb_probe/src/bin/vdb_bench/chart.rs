//! Rays a second as a picture.

use vdb_probe::{PALE, Svg};

use crate::report::Row;

/// Pixels.
const LINE: f64 = 13.0;
const LABEL: f64 = 250.0;
const PLOT: f64 = 300.0;
const GAP: f64 = 30.0;
const TOP: f64 = 96.0;

/// From the farthest view to the nearest.
const DOTS: [&str; 4] = ["#9db8d9", "#4a7fbf", "#173f73", "#c23b22"];

/// The values of all rows once, in their order.
fn distinct<T: PartialEq>(rows: &[Row], of: impl Fn(&Row) -> T) -> Vec<T> {
    let mut all = Vec::new();
    for value in rows.iter().map(of) {
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}

/// What a line of the picture shows.
fn label(row: &Row) -> String {
    let parts = [row.model.as_str(), row.kind, row.rays, row.variant.as_str()];
    let shown = parts.into_iter().filter(|part| !part.is_empty() && *part != "primary");
    shown.collect::<Vec<_>>().join(" ")
}

/// A panel for each size of picture, a line for each model and variant, a dot for each camera with all
/// its runs from the slowest to the fastest.
pub fn svg(rows: &[Row], heading: &str) -> String {
    let sizes = distinct(rows, |row| row.size);
    let labels = distinct(rows, label);
    let mut dists = distinct(rows, |row| row.dist);
    dists.sort_by(|a, b| b.total_cmp(a));
    let width = GAP + LABEL + (PLOT + GAP) * sizes.len() as f64;
    let bottom = TOP + LINE * labels.len() as f64;
    let height = bottom + 4.0 * LINE;
    let mut svg = Svg::new(width, height);
    let bold = r#"font-size="17" font-weight="bold""#;
    svg.text(GAP / 2.0, 24.0, "start", bold, "Millions of rays a second");
    svg.text(GAP / 2.0, 42.0, "start", r#"font-size="11""#, heading);
    let color_of = |rank: usize| DOTS[rank.min(DOTS.len() - 1)];
    for (i, dist) in dists.iter().enumerate() {
        let color = color_of(i);
        let at = GAP + 110.0 * i as f64;
        svg.dot(at, 58.0, color);
        svg.text(at + 7.0, 61.5, "start", "", &format!("distance {dist:.1}"));
    }
    for (i, label) in labels.iter().enumerate() {
        let y = TOP + LINE * (i as f64 + 0.5) + 3.0;
        svg.text(GAP / 2.0 + LABEL, y, "end", "", label);
    }
    // Whole decades around all that was measured; without a row there is no panel to have an axis.
    let least = rows.iter().map(|row| row.mrays(row.times.max)).fold(f64::INFINITY, f64::min);
    let most = rows.iter().map(|row| row.mrays(row.times.min)).fold(0.0, f64::max);
    let (low, high) = (least.log10().floor(), (most.log10() + 1e-9).ceil());
    let decades = (high - low).max(1.0);
    for (panel, size) in sizes.into_iter().enumerate() {
        let zero = GAP + LABEL + (PLOT + GAP) * panel as f64;
        let place = |mrays: f64| zero + PLOT * (mrays.log10() - low) / decades;
        let [x, y] = size;
        let title = format!("{x}×{y}");
        let bold = r#"font-size="13" font-weight="bold""#;
        svg.text(zero + PLOT / 2.0, TOP - 12.0, "middle", bold, &title);
        for decade in 0..=decades as i32 {
            let mrays = 10.0_f64.powi(low as i32 + decade);
            let at = place(mrays);
            svg.line((at, TOP - 4.0), (at, bottom), PALE, 1.0);
            svg.text(at, bottom + LINE, "middle", "", &format!("{mrays}"));
        }
        for row in rows.iter().filter(|row| row.size == size) {
            let Some(line) = labels.iter().position(|other| *other == label(row)) else { continue };
            let rank = dists.iter().position(|dist| *dist == row.dist).unwrap_or(0);
            let color = color_of(rank);
            let y = TOP + LINE * (line as f64 + 0.5);
            let [slow, fast] = [row.times.max, row.times.min].map(|time| place(row.mrays(time)));
            svg.line((slow, y), (fast, y), color, 1.5);
            svg.dot(place(row.mrays(row.times.median)), y, color);
        }
    }
    let foot = "dots: medians; lines: all runs, from the slowest to the fastest";
    svg.text(GAP / 2.0, bottom + 2.8 * LINE, "start", "", foot);
    svg.finish()
}
