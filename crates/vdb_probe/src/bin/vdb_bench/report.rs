//! Results, for programs and for people.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::chart::{self, Dot};
use crate::timing::Times;

/// The measurements of one image.
pub struct Row {
    pub model: String,
    pub kind: &'static str,
    /// The format of samples.
    pub format: &'static str,
    /// The shader defs.
    pub variant: String,
    pub rays: &'static str,
    pub size: [u32; 2],
    /// The distance from the camera to the centre of the model, in half diagonals.
    pub dist: f64,
    pub pixels: u64,
    pub times: Times,
    /// The fraction of rays that hit something.
    pub hits: f64,
    /// Average steps per ray.
    pub steps: f64,
    /// The size of the grid on the GPU.
    pub bytes: u64,
    pub active_voxels: u64,
    pub pack_ms: f64,
}

impl Row {
    /// Millions of rays per second for a time in milliseconds.
    pub fn mrays(&self, milliseconds: f64) -> f64 {
        self.pixels as f64 / milliseconds / 1e3
    }

    /// The columns of a table row.
    fn columns(&self, adapter: &str) -> Vec<(&'static str, Value)> {
        let round = |number: f64, digits: i32| {
            let scale = 10.0_f64.powi(digits);
            json!((number * scale).round() / scale)
        };
        let Times { median, min, max, spread, runs } = self.times;
        vec![
            ("model", json!(self.model)),
            ("kind", json!(self.kind)),
            ("format", json!(self.format)),
            ("variant", json!(self.variant)),
            ("rays", json!(self.rays)),
            ("width", json!(self.size[0])),
            ("height", json!(self.size[1])),
            ("dist", round(self.dist, 2)),
            ("median_ms", round(median, 4)),
            ("min_ms", round(min, 4)),
            ("max_ms", round(max, 4)),
            ("spread_percent", round(100.0 * spread, 1)),
            ("runs", json!(runs)),
            ("mrays_per_s", round(self.mrays(median), 3)),
            ("hit_percent", round(100.0 * self.hits, 1)),
            ("steps_per_ray", round(self.steps, 2)),
            ("bytes", json!(self.bytes)),
            ("bytes_per_voxel", round(self.bytes as f64 / self.active_voxels as f64, 3)),
            ("pack_ms", round(self.pack_ms, 1)),
            ("adapter", json!(adapter)),
        ]
    }
}

/// All rows so far.
pub struct Report {
    adapter: String,
    /// The output folder, if files are to be written.
    out: Option<PathBuf>,
    rows: Vec<Row>,
    csv: Vec<u8>,
}

impl Report {
    /// Creates a report. Fails at once if the output folder cannot be written to.
    pub fn new(adapter: String, out: Option<&Path>) -> Result<Self, String> {
        eprintln!("adapter: {adapter}");
        let report =
            Self { adapter, out: out.map(Path::to_owned), rows: Vec::new(), csv: Vec::new() };
        report.write("bench.csv", b"")?;
        Ok(report)
    }

    fn write(&self, name: &str, text: &[u8]) -> Result<(), String> {
        let Some(dir) = &self.out else { return Ok(()) };
        std::fs::create_dir_all(dir)
            .and_then(|()| std::fs::write(dir.join(name), text))
            .map_err(|error| format!("{}: {error}", dir.join(name).display()))
    }

    /// Adds a row and prints it.
    pub fn add(&mut self, row: Row) -> Result<(), String> {
        let columns = row.columns(&self.adapter);
        let mut table = csv::Writer::from_writer(Vec::new());
        let names = self.rows.is_empty().then(|| columns.iter().map(|(name, _)| *name));
        let cells = columns.iter().map(|(_, value)| match value.as_str() {
            Some(text) => text.to_owned(),
            None => value.to_string(),
        });
        let written = names.map_or(Ok(()), |names| table.write_record(names));
        written.and_then(|()| table.write_record(cells)).map_err(|error| error.to_string())?;
        let text = table.into_inner().map_err(|error| error.to_string())?;
        std::io::stdout().write_all(&text).map_err(|error| format!("standard output: {error}"))?;
        self.csv.extend(text);
        self.rows.push(row);
        // Written after each row, so that an interrupted run of an hour keeps its results.
        self.write("bench.csv", &self.csv)
    }

    /// The rows so far.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Writes the files that summarise all rows.
    pub fn finish(&self) -> Result<(), String> {
        let (date, commit) = (date(), commit());
        let rows = self.rows.iter().map(|row| Value::from_iter(row.columns(&self.adapter)));
        let all = json!({
            "adapter": self.adapter,
            "date": date,
            "commit": commit,
            "rows": rows.collect::<Vec<_>>(),
        });
        self.write("bench.json", format!("{all:#}\n").as_bytes())?;
        let heading = format!("{}, {date}, commit {commit}", self.adapter);
        let dots: Vec<Dot> = self.rows.iter().map(|row| Dot::of(row, &self.adapter)).collect();
        self.write("bench.svg", chart::svg(&dots, &heading).as_bytes())
    }
}

/// The current time, in UTC.
pub fn date() -> String {
    humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string()
}

/// The commit of the build, which the scripts pass to the compiler.
pub fn commit() -> &'static str {
    option_env!("BEVY_VDB_COMMIT").unwrap_or("unknown")
}
