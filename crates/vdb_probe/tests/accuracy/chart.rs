//! The table as a picture.

use vdb_probe::{INK, PALE, Svg};

use crate::report::{Bound, Report, Row};

/// Pixels.
const LINE: f64 = 13.0;
const LABEL: f64 = 250.0;
const PLOT: f64 = 400.0;
const GAP: f64 = 50.0;
const TOP: f64 = 96.0;
/// Decades of the axis of errors, up to ten times the bound.
const DECADES: f64 = 10.0;

const GOOD: &str = "#2f7d4f";
const BAD: &str = "#c23b22";
const DOTS: [(&str, &str); 3] = [("p50", "#9db8d9"), ("p99.99", "#4a7fbf"), ("max", "#173f73")];

/// The whole picture: to the left first voxels, how many are wrong here and by the nudged traversal, and
/// below the errors of the rays themselves and of fog, to the right those of smooth surfaces, all in
/// parts of their bounds.
pub fn svg(report: &Report) -> String {
    let own = || report.rows.iter().filter(|row| !row.again || row.unit == "degrees");
    let blocky: Vec<&Row> =
        own().filter(|row| row.unit == "of t" && row.group == "voxels").collect();
    let rays: Vec<&Row> = own().filter(|row| row.group == "rays").collect();
    let of = |groups: &[&str]| -> Vec<&Row> {
        own().filter(|row| groups.contains(&row.group) && row.unit != "of t").collect()
    };
    let (fog, smooth) = (of(&["fog"]), of(&["smooth", "corpus"]));
    // A panel's head and foot take eight lines.
    let left = blocky.len() + rays.len() + fog.len() + 16;
    let height = TOP + LINE * left.max(smooth.len()) as f64 + 60.0;
    let width = 2.0 * (LABEL + PLOT) + 3.0 * GAP;
    let mut svg = Svg::new(width, height);
    svg.text(
        GAP / 2.0,
        24.0,
        "start",
        r#"font-size="17" font-weight="bold""#,
        "Accuracy: the shaders against the f64 reference tracer",
    );
    svg.text(GAP / 2.0, 42.0, "start", r#"font-size="11""#, &report.heading());
    wrong_voxels(&mut svg, report, &blocky, GAP / 2.0, TOP);
    let below = TOP + LINE * (blocky.len() + 8) as f64;
    errors(&mut svg, "Rays of cameras", &rays, GAP / 2.0, below);
    let below_rays = below + LINE * (rays.len() + 8) as f64;
    errors(&mut svg, "Fog", &fog, GAP / 2.0, below_rays);
    let right = LABEL + PLOT + 2.0 * GAP;
    errors(&mut svg, "Smooth surfaces", &smooth, right, TOP);
    svg.finish()
}

/// Bars: the part of the rays whose first voxel or face is wrong, on a scale of decades.
fn wrong_voxels(svg: &mut Svg, report: &Report, rows: &[&Row], x: f64, y: f64) {
    /// Decades down from all rays.
    const DOWN: f64 = 5.0;
    let zero = x + LABEL;
    svg.text(
        x,
        y - 26.0,
        "start",
        r#"font-size="13" font-weight="bold""#,
        "First voxels: rays with a wrong voxel or face",
    );
    svg.text(
        zero,
        y - 26.0 + LINE,
        "start",
        &format!(r#"fill="{BAD}""#),
        "bars: by a traversal that nudges its position by 4e-4 a step",
    );
    let bottom = y + LINE * rows.len() as f64;
    for decade in 0..=DOWN as i32 {
        let at = zero + PLOT * f64::from(decade) / DOWN;
        svg.line((at, y - 4.0), (at, bottom), PALE, 1.0);
        let percent = 100.0 * 10.0_f64.powi(decade - DOWN as i32);
        svg.text(at, bottom + LINE, "middle", "", &format!("{percent} %"));
    }
    for (i, row) in rows.iter().enumerate() {
        let middle = y + LINE * (i as f64 + 0.5);
        svg.text(zero - 34.0, middle + 3.0, "end", "", &row.case);
        let (color, weight) = if row.wrong == 0 { (GOOD, "normal") } else { (BAD, "bold") };
        let style = format!(r#"fill="{color}" font-weight="{weight}""#);
        svg.text(zero - 6.0, middle + 3.0, "end", &style, &row.wrong.to_string());
        let Some(nudged) = report.beside.iter().find(|other| other.case == row.case) else {
            continue;
        };
        let part = nudged.wrong as f64 / nudged.rays.max(1) as f64;
        if part > 0.0 {
            let length = PLOT * (part.log10() + DOWN).max(0.0) / DOWN;
            svg.bar(zero, middle, (length, LINE * 0.7), BAD);
        }
    }
    svg.text(zero - 6.0, y - 8.0, "end", &format!(r#"fill="{GOOD}""#), "wrong here");
    svg.text(zero + PLOT / 2.0, bottom + 2.2 * LINE, "middle", "", "of the rays, nudged traversal");
}

/// Dots: errors in parts of their bounds, on a scale of decades; the bound is the line at 1.
fn errors(svg: &mut Svg, title: &str, rows: &[&Row], x: f64, y: f64) {
    if rows.is_empty() {
        return;
    }
    let zero = x + LABEL;
    svg.text(
        x,
        y - 26.0,
        "start",
        r#"font-size="13" font-weight="bold""#,
        &format!("{title}: errors in parts of their bounds"),
    );
    for (i, (name, color)) in DOTS.iter().enumerate() {
        let at = zero + 60.0 * i as f64;
        svg.dot(at, y - 12.0, color);
        svg.text(at + 7.0, y - 8.5, "start", "", name);
    }
    let bottom = y + LINE * rows.len() as f64;
    let place =
        |part: f64| zero + PLOT * ((part.log10() + DECADES - 1.0) / DECADES).clamp(0.0, 1.0);
    for decade in 0..=DECADES as i32 {
        let power = decade - DECADES as i32 + 1;
        let at = place(10.0_f64.powi(power));
        let (color, width) = if power == 0 { (BAD, 1.5) } else { (PALE, 1.0) };
        svg.line((at, y - 4.0), (at, bottom), color, width);
        let label = match decade {
            0 => "less".into(),
            _ if power == 0 => "the bound".into(),
            _ => format!("1e{power}"),
        };
        svg.text(at, bottom + LINE, "middle", "", &label);
    }
    svg.text(zero + PLOT / 2.0, bottom + 2.2 * LINE, "middle", "", "error / bound");
    for (i, row) in rows.iter().enumerate() {
        let middle = y + LINE * (i as f64 + 0.5);
        let color = if row.holds() == Some(false) { BAD } else { INK };
        let label = format!("{}: {}", row.group, row.case);
        svg.text(zero - 6.0, middle + 3.0, "end", &format!(r#"fill="{color}""#), &label);
        let (most, max) = match row.bound {
            Bound::Max(max) => (max, max),
            Bound::Quantile(most, max) => (most, max),
            Bound::None => continue,
        };
        let at = [row.p50 / most, row.p9999 / most, row.max / max].map(place);
        svg.line((at[0].min(at[1]), middle), (at[2].max(at[1]), middle), PALE, 3.0);
        for (at, (_, color)) in at.into_iter().zip(DOTS) {
            svg.dot(at, middle, color);
        }
    }
}
