//! Charts of rays per second.

use std::path::Path;

use serde::Deserialize;
use vdb_probe::{PALE, Svg};

use crate::report::Row;

/// Layout, in pixels.
const LINE: f64 = 13.0;
const LABEL: f64 = 250.0;
const PLOT: f64 = 300.0;
const GAP: f64 = 30.0;
const TOP: f64 = 96.0;

/// Colours of the views, from the farthest to the nearest.
const DOTS: [&str; 4] = ["#9db8d9", "#4a7fbf", "#173f73", "#c23b22"];
/// The background of peers' lines.
const PEER: &str = "#f3ead9";

/// A dot of the chart: one view of a model.
#[derive(Debug, PartialEq)]
pub struct Dot {
    model: String,
    /// The label of its line.
    label: String,
    is_peer: bool,
    /// The size of the image, in pixels.
    pub size: [u32; 2],
    dist: f64,
    /// Millions of rays per second: minimum, median, maximum.
    mrays: [f64; 3],
    /// The adapter, as the table names it.
    pub adapter: String,
}

/// The columns common to all tables: ours, NanoVDB's and Bevy's.
#[derive(Deserialize)]
struct Record {
    /// Only in the tables of peers.
    peer: Option<String>,
    model: String,
    kind: String,
    variant: String,
    rays: String,
    width: u32,
    height: u32,
    dist: f64,
    median_ms: f64,
    min_ms: f64,
    max_ms: f64,
    /// Peers' tables name this column differently.
    #[serde(alias = "device")]
    adapter: String,
}

impl Dot {
    pub fn of(row: &Row, adapter: &str) -> Self {
        Self::new(&Record {
            peer: None,
            model: row.model.clone(),
            kind: row.kind.into(),
            variant: row.variant.clone(),
            rays: row.rays.into(),
            width: row.size[0],
            height: row.size[1],
            dist: row.dist,
            median_ms: row.times.median,
            min_ms: row.times.min,
            max_ms: row.times.max,
            adapter: adapter.into(),
        })
    }

    fn new(record: &Record) -> Self {
        let Record { width, height, .. } = *record;
        let pixels = f64::from(width) * f64::from(height);
        let shown = [
            record.model.as_str(),
            record.peer.as_deref().unwrap_or(&record.kind),
            &record.rays,
            &record.variant,
        ];
        let shown = shown.into_iter().filter(|part| !part.is_empty() && *part != "primary");
        Self {
            model: record.model.clone(),
            label: shown.collect::<Vec<_>>().join(" "),
            is_peer: record.peer.is_some(),
            size: [width, height],
            dist: record.dist,
            mrays: [record.max_ms, record.median_ms, record.min_ms].map(|ms| pixels / ms / 1e3),
            adapter: record.adapter.clone(),
        }
    }

    /// The rows of a table written by [`Report`](crate::report::Report) or by a peer.
    pub fn read(table: &Path) -> Result<Vec<Self>, String> {
        let at = |error: csv::Error| format!("{}: {error}", table.display());
        let mut reader = csv::Reader::from_path(table).map_err(at)?;
        reader
            .deserialize()
            .map(|record| record.map(|record| Self::new(&record)).map_err(at))
            .collect()
    }
}

/// The distinct values over all dots, in order.
pub fn distinct<T: PartialEq>(dots: &[Dot], of: impl Fn(&Dot) -> T) -> Vec<T> {
    let mut all = Vec::new();
    for value in dots.iter().map(of) {
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}

/// A chart with a panel for each image size, a line for each model and variant, and for each camera
/// a dot with a range from the slowest to the fastest run.
pub fn svg(dots: &[Dot], heading: &str) -> String {
    let sizes = distinct(dots, |dot| dot.size);
    let models = distinct(dots, |dot| dot.model.clone());
    // Groups the lines of peers with ours of the same model.
    let mut lines = distinct(dots, |dot| (dot.model.clone(), dot.label.clone(), dot.is_peer));
    lines.sort_by_key(|(model, ..)| models.iter().position(|other| other == model));
    let mut dists = distinct(dots, |dot| dot.dist);
    dists.sort_by(|a, b| b.total_cmp(a));
    let width = GAP + LABEL + (PLOT + GAP) * sizes.len() as f64;
    let bottom = TOP + LINE * lines.len() as f64;
    let height = bottom + 4.0 * LINE;
    let mut svg = Svg::new(width, height);
    let bold = r#"font-size="17" font-weight="bold""#;
    svg.text(GAP / 2.0, 24.0, "start", bold, "Millions of rays per second");
    svg.text(GAP / 2.0, 42.0, "start", r#"font-size="11""#, heading);
    let color_of = |rank: usize| DOTS[rank.min(DOTS.len() - 1)];
    for (i, dist) in dists.iter().enumerate() {
        let color = color_of(i);
        let at = GAP + 110.0 * i as f64;
        svg.dot(at, 58.0, color);
        svg.text(at + 7.0, 61.5, "start", "", &format!("distance {dist:.1}"));
    }
    for (i, (_, label, is_peer)) in lines.iter().enumerate() {
        let y = TOP + LINE * (i as f64 + 0.5);
        if *is_peer {
            svg.bar(0.0, y, (width, LINE), PEER);
        }
        svg.text(GAP / 2.0 + LABEL, y + 3.0, "end", "", label);
    }
    // Whole decades around all measurements. (Without rows there are no panels, and so no axes.)
    let least = dots.iter().map(|dot| dot.mrays[0]).fold(f64::INFINITY, f64::min);
    let most = dots.iter().map(|dot| dot.mrays[2]).fold(0.0, f64::max);
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
        for dot in dots.iter().filter(|dot| dot.size == size) {
            let is_own = |(_, label, _): &(String, String, bool)| *label == dot.label;
            let Some(line) = lines.iter().position(is_own) else { continue };
            let rank = dists.iter().position(|dist| *dist == dot.dist).unwrap_or(0);
            let color = color_of(rank);
            let y = TOP + LINE * (line as f64 + 0.5);
            let [slow, median, fast] = dot.mrays.map(place);
            svg.line((slow, y), (fast, y), color, 1.5);
            svg.dot(median, y, color);
        }
    }
    let foot = "dots: medians; lines: all runs, from the slowest to the fastest";
    svg.text(GAP / 2.0, bottom + 2.8 * LINE, "start", "", foot);
    svg.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tables in the formats of `benches/peers/nanovdb.cu` and of this program.
    #[test]
    fn peers_stand_beside_ours() {
        let peers = "peer,variant,model,kind,rays,width,height,dist,block,median_ms,min_ms,max_ms,\
                     device\n\
                     nanovdb,stock,a,level_set,primary,1000,1000,3.0,8x8,2.0,1.0,4.0,\"GPU, X\"\n";
        let ours = "model,kind,format,variant,rays,width,height,dist,median_ms,min_ms,max_ms,adapter\n\
                    a,voxels,exact,BEAMS,primary,1000,1000,3,0.5,0.5,0.5,G\n\
                    b,fog,exact,,shuffled,1000,1000,3,0.5,0.5,0.5,G\n";
        let folder = std::env::temp_dir().join(format!("vdb_chart_{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let read = |name: &str, text: &str| {
            let path = folder.join(name);
            std::fs::write(&path, text).unwrap();
            Dot::read(&path)
        };
        let mut dots = read("ours.csv", ours).unwrap();
        dots.extend(read("peers.csv", peers).unwrap());
        let wrong = read("wrong.csv", "model,kind\na,b\n").unwrap_err();
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(wrong.contains("wrong.csv") && wrong.contains("variant"), "{wrong}");
        assert_eq!(dots[2].mrays, [250.0, 500.0, 1000.0]);
        let drawing = svg(&dots, "somewhere");
        let at = |label: &str| drawing.find(label).unwrap_or_else(|| panic!("no {label}"));
        assert!(at(">a voxels BEAMS<") < at(">a nanovdb stock<"));
        assert!(at(">a nanovdb stock<") < at(">b fog shuffled<"));
        assert_eq!(drawing.matches(PEER).count(), 1);
    }
}
