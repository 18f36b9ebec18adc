//! The table: as text, as CSV.

use std::fmt::Write as _;

use vdb_probe::judge::{Errors, Tally};

/// What a row is held to.
#[derive(Clone, Copy, Debug)]
pub enum Bound {
    /// No wrong ray, and no error above this.
    Max(f64),
    /// As before, and 99.99 % of the errors below the first.
    Quantile(f64, f64),
    /// Not held to anything: shown beside the others.
    None,
}

/// A line of the table.
#[derive(Clone, Debug)]
pub struct Row {
    /// Which part of the suite it belongs to.
    pub group: &'static str,
    pub case: String,
    pub unit: &'static str,
    pub rays: u64,
    /// How many of them met something.
    pub met: u64,
    pub wrong: u64,
    /// Of what is wrong, what is only a wrong face.
    pub wrong_faces: u64,
    pub p50: f64,
    pub p9999: f64,
    pub max: f64,
    pub bound: Bound,
    /// What else is to be said.
    pub note: String,
    /// Whether the rays are also those of another row.
    pub again: bool,
}

impl Row {
    pub fn new(
        group: &'static str,
        case: impl Into<String>,
        unit: &'static str,
        bound: Bound,
        tally: &Tally,
    ) -> Self {
        Self::of_errors(group, case, unit, bound, &tally.errors)
            .counts(tally)
            .and(tally.near_double, "near-double")
            .and(tally.at_end, "at an end of the ray")
            .and(tally.cut, "longer than llvmpipe's loops")
    }

    /// Adds to what else is to be said.
    pub fn and(mut self, count: u64, what: &str) -> Self {
        if count > 0 {
            let comma = if self.note.is_empty() { "" } else { ", " };
            let _ = write!(self.note, "{comma}{count} {what}");
        }
        self
    }

    /// A row of errors alone.
    pub fn of_errors(
        group: &'static str,
        case: impl Into<String>,
        unit: &'static str,
        bound: Bound,
        errors: &Errors,
    ) -> Self {
        Self {
            group,
            case: case.into(),
            unit,
            rays: errors.count(),
            met: errors.count(),
            wrong: 0,
            wrong_faces: 0,
            p50: errors.quantile(0.5),
            p9999: errors.quantile(0.9999),
            max: errors.max(),
            bound,
            note: String::new(),
            again: false,
        }
    }

    fn counts(self, tally: &Tally) -> Self {
        let Tally { rays, met, wrong, wrong_faces, .. } = *tally;
        Self { rays, met, wrong, wrong_faces, ..self }
    }

    /// `None`, where there is no bound.
    pub fn holds(&self) -> Option<bool> {
        let within = match self.bound {
            Bound::None => return None,
            Bound::Max(max) => self.max <= max,
            Bound::Quantile(p9999, max) => self.p9999 <= p9999 && self.max <= max,
        };
        // Rays that meet nothing prove nothing.
        let is_telling = self.met * 100 > self.rays;
        Some(within && self.wrong == 0 && is_telling)
    }

    pub fn verdict(&self) -> &'static str {
        match self.holds() {
            None => "",
            Some(true) => "holds",
            Some(false) => "BROKEN",
        }
    }

    pub fn bound_text(&self) -> String {
        match self.bound {
            Bound::None => String::new(),
            Bound::Max(max) => number(max),
            Bound::Quantile(p9999, max) => format!("{}; {}", number(p9999), number(max)),
        }
    }
}

/// Two digits, and a plain zero.
pub fn number(x: f64) -> String {
    if x == 0.0 { "0".into() } else { format!("{x:.1e}") }
}

/// All rows, and what is said above them.
#[derive(Debug, Default)]
pub struct Report {
    pub adapter: String,
    pub seed: u64,
    pub times: usize,
    pub rows: Vec<Row>,
    /// Rows that are not held to anything, beside the others: of the nudged traversal.
    pub beside: Vec<Row>,
    printed: usize,
}

impl Report {
    pub fn new(adapter: String, seed: u64, times: usize) -> Self {
        Self { adapter, seed, times, ..Self::default() }
    }

    /// Takes a row and prints it.
    pub fn add(&mut self, row: Row, tally: &Tally) {
        if self.printed == 0 {
            println!("{}", header());
        }
        self.printed += 1;
        println!("{}", line(&row));
        if row.holds() == Some(false) {
            tally.examples.iter().for_each(|example| println!("    {example}"));
        }
        self.rows.push(row);
    }

    /// Takes a row of the table beside.
    pub fn add_beside(&mut self, row: Row) {
        if self.beside.is_empty() {
            println!("\n{BESIDE}\n{}", beside_header());
        }
        println!("{}", beside_line(&row));
        self.beside.push(row);
    }

    pub fn broken(&self) -> usize {
        self.rows.iter().filter(|row| row.holds() == Some(false)).count()
    }

    /// One line a row.
    pub fn csv(&self) -> String {
        let mut csv = "table,group,case,unit,rays,met,wrong,wrong_faces,p50,p99_99,max,bound,verdict,note,adapter,seed\n".to_owned();
        let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
        for (table, rows) in [("suite", &self.rows), ("nudged", &self.beside)] {
            for row in rows {
                let _ = writeln!(
                    csv,
                    "{table},{},{},{},{},{},{},{},{:e},{:e},{:e},{},{},{},{},{}",
                    quoted(row.group),
                    quoted(&row.case),
                    quoted(row.unit),
                    row.rays,
                    row.met,
                    row.wrong,
                    row.wrong_faces,
                    row.p50,
                    row.p9999,
                    row.max,
                    quoted(&row.bound_text()),
                    row.verdict(),
                    quoted(&row.note),
                    quoted(&self.adapter),
                    self.seed,
                );
            }
        }
        csv
    }

    /// Both tables as text.
    pub fn table(&self) -> String {
        let mut text = format!("{}\n{}\n", self.heading(), header());
        self.rows.iter().for_each(|row| {
            let _ = writeln!(text, "{}", line(row));
        });
        if !self.beside.is_empty() {
            let _ = writeln!(text, "\n{BESIDE}\n{}", beside_header());
        }
        self.beside.iter().for_each(|row| {
            let _ = writeln!(text, "{}", beside_line(row));
        });
        let _ = writeln!(text, "\n{}", self.sum());
        text
    }

    /// What it comes to.
    pub fn sum(&self) -> String {
        let own = || self.rows.iter().filter(|row| !row.again);
        let rays = |holds: &dyn Fn(&Row) -> bool| -> u64 {
            own().filter(|row| holds(row)).map(|row| row.rays).sum()
        };
        let blocky = |row: &Row| row.unit == "of t";
        let hard = |row: &Row| blocky(row) && row.case.ends_with(", hard");
        let ends = |row: &Row| row.case.ends_with(", ends");
        let wrong: u64 = own().filter(|row| blocky(row)).map(|row| row.wrong).sum();
        format!(
            "{} rays to first voxels, {} of them made to be hard, {} with ends: {wrong} wrong. {} rays in \
             all, {} with ends. {}",
            rays(&blocky),
            rays(&hard),
            rays(&|row| blocky(row) && ends(row)),
            rays(&|row| row.group != "rays"),
            rays(&ends),
            match self.broken() {
                0 => "Every bound holds.".to_owned(),
                broken => format!("{broken} bounds are BROKEN."),
            }
        )
    }

    pub fn heading(&self) -> String {
        format!(
            "{}, seed {}, {} times the rays of the short form",
            self.adapter, self.seed, self.times
        )
    }
}

/// Above the table beside.
const BESIDE: &str = "The same questions to a traversal that nudges its position by 4e-4 a step, 1000 steps at most:";

fn beside_header() -> String {
    format!("{:<52} {:>13} {:>13} {:>9}  {}", "case", "rays", "wrong voxels", "", "of which")
}

fn beside_line(row: &Row) -> String {
    let name = format!("{}: {}", row.group, row.case);
    let part = 100.0 * row.wrong as f64 / row.rays.max(1) as f64;
    format!("{name:<52} {:>13} {:>13} {part:>7.2} %  {}", row.rays, row.wrong, row.note)
}

fn header() -> String {
    format!(
        "{:<52} {:>11} {:>11} {:>6}  {:>8} {:>8} {:>8}  {:<16} {:<14} {}",
        "case", "rays", "that met", "wrong", "p50", "p99.99", "max", "bound", "unit", "verdict"
    )
}

fn line(row: &Row) -> String {
    let name = format!("{}: {}", row.group, row.case);
    let mut text = format!(
        "{name:<52} {:>11} {:>11} {:>6}  {:>8} {:>8} {:>8}  {:<16} {:<14} {}",
        row.rays,
        row.met,
        row.wrong,
        number(row.p50),
        number(row.p9999),
        number(row.max),
        row.bound_text(),
        row.unit,
        row.verdict(),
    );
    if !row.note.is_empty() {
        let _ = write!(text, "  ({})", row.note);
    }
    text
}
