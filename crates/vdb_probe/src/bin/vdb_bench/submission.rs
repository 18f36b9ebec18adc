//! A report of one adapter, in Markdown: for users to paste into an issue.

use std::fmt::Write as _;

use vdb_core::pack::exact::T_ERROR;
use vdb_probe::judge::{Tally, fog, smooth};
use wgpu::{AdapterInfo, DeviceType};

use crate::check::Check;
use crate::model::Kind;
use crate::report::{Row, commit, date};
use crate::system::operating_system;

/// What two columns of the table of rays mean.
const NOTES: &str = "
*Undefined*: the answer depends on the rounding of f32, within the limits of \
    [Accuracy](https://github.com/bevy-vdb/bevy_vdb/blob/main/docs/reference/accuracy.md#near-double-roots). \
    *Cut short*: too many steps for the loops of a software driver, and not judged.
";

/// Everything that the report says.
pub struct Submission<'a> {
    /// The adapter and the machine: names and values, in rows.
    about: Vec<(&'static str, String)>,
    is_software: bool,
    rows: &'a [Row],
    checks: &'a [Check],
    /// The models that could not be measured, with the reasons.
    failed: &'a [String],
}

impl<'a> Submission<'a> {
    /// The report of an adapter on this machine.
    pub fn new(
        adapter: &AdapterInfo,
        rows: &'a [Row],
        checks: &'a [Check],
        failed: &'a [String],
    ) -> Self {
        let kind = match adapter.device_type {
            DeviceType::DiscreteGpu => "discrete GPU",
            DeviceType::IntegratedGpu => "integrated GPU",
            DeviceType::VirtualGpu => "virtual GPU",
            DeviceType::Cpu => "software",
            DeviceType::Other => "of unknown kind",
        };
        let AdapterInfo { name, vendor, device, driver, driver_info, .. } = adapter;
        let about = vec![
            ("bevy_vdb", format!("{}, commit {}", env!("CARGO_PKG_VERSION"), commit())),
            ("adapter", format!("{name} ({kind}, {vendor:04x}:{device:04x})")),
            ("backend", adapter.backend.to_string()),
            ("driver", format!("{driver} {driver_info}")),
            ("operating system", operating_system()),
            ("date", date()),
        ];
        let is_software = adapter.device_type == DeviceType::Cpu;
        Self { about, is_software, rows, checks, failed }
    }

    /// The text of the report.
    pub fn markdown(&self) -> String {
        let mut text = String::from("| | |\n|---|---|\n");
        for (name, value) in &self.about {
            let _ = writeln!(text, "| {name} | {} |", cell(value));
        }
        self.correctness(&mut text);
        self.speed(&mut text);
        for message in self.failed {
            let _ = writeln!(text, "\n**Not measured:** {}", cell(message));
        }
        text
    }

    fn correctness(&self, text: &mut String) {
        let sum = |of: fn(&Tally) -> u64| self.checks.iter().map(|check| of(&check.tally)).sum();
        let (wrong, rays): (u64, u64) = (sum(|tally| tally.wrong), sum(judged));
        let mark = if wrong == 0 { "" } else { "⚠ " };
        let _ = writeln!(
            text,
            "\n**{mark}{} of {} rays wrong**, compared one by one with the reference tracer.\n\n\
             | model | kind | rays | hits | wrong | undefined | cut short | largest error | bound |\n\
             |---|---|---|---|---|---|---|---|---|",
            grouped(wrong),
            grouped(rays),
        );
        for Check { model, kind, tally } in self.checks {
            let (bound, unit) = match kind {
                Kind::Voxels => (f64::from(T_ERROR), "of t"),
                Kind::Smooth => (smooth::FARTHEST_OFF, "voxel"),
                Kind::Fog => (fog::TRANSMITTANCE, "transmittance"),
            };
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {} | {} | {:.1e} | {bound:.1e} {unit} |",
                cell(model),
                kind.name(),
                grouped(judged(tally)),
                grouped(tally.met),
                grouped(tally.wrong),
                grouped(tally.near_double + tally.at_end + tally.steep),
                grouped(tally.cut),
                tally.errors.max(),
            );
        }
        text.push_str(NOTES);
        let examples: Vec<_> = self.checks.iter().flat_map(|check| &check.tally.examples).collect();
        if !examples.is_empty() {
            let _ = writeln!(text, "\nSome of the wrong rays:\n\n```text");
            for example in examples {
                let _ = writeln!(text, "{example}");
            }
            text.push_str("```\n");
        }
    }

    fn speed(&self, text: &mut String) {
        let Some(first) = self.rows.first() else { return };
        let [width, height] = first.size;
        let software =
            if self.is_software { " **A software adapter: the times are the CPU's.**" } else { "" };
        let _ = writeln!(
            text,
            "\nMillions of rays per second in images of {width}×{height}, medians of {} runs; the \
             spread is the interquartile range.{software}\n\n\
             | model | kind | rays | hit | Mrays/s | spread | ms |\n|---|---|---|---|---|---|---|",
            first.times.runs,
        );
        for row in self.rows {
            let _ = writeln!(
                text,
                "| {} | {} | {} | {:.1} % | {} | {:.1} % | {} |",
                cell(&row.model),
                row.kind,
                row.rays,
                100.0 * row.hits,
                significant(row.mrays(row.times.median)),
                100.0 * row.times.spread,
                significant(row.times.median),
            );
        }
    }
}

/// Rays that have a verdict.
fn judged(tally: &Tally) -> u64 {
    tally.rays - tally.cut
}

/// Text within one cell of a table: drivers may say anything.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}

/// A number with three significant digits, as far as four decimals give them.
fn significant(number: f64) -> String {
    let decimals = (2.0 - number.log10().floor()).clamp(0.0, 4.0);
    format!("{number:.*}", decimals as usize)
}

/// A number with its digits in groups of three.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy).collect();
    groups.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::timing::Times;

    fn row(rays: &'static str, median: f64) -> Row {
        Row {
            model: "a|b".into(),
            kind: "voxels",
            format: "exact",
            variant: String::new(),
            rays,
            size: [1000, 500],
            dist: 1.8,
            pixels: 500_000,
            times: Times { median, min: median, max: median, spread: 0.0123, runs: 40 },
            hits: 0.25,
            steps: 3.0,
            bytes: 1,
            active_voxels: 1,
            pack_ms: 1.0,
        }
    }

    fn submission<'a>(rows: &'a [Row], checks: &'a [Check], failed: &'a [String]) -> String {
        let about = vec![("adapter", "Some | GPU\nof mine".into()), ("backend", "Vulkan".into())];
        Submission { about, is_software: false, rows, checks, failed }.markdown()
    }

    fn has(text: &str, line: &str) {
        assert!(text.lines().any(|own| own == line), "no line {line:?} in\n{text}");
    }

    #[test]
    fn a_report_has_speed_correctness_and_what_failed() {
        let rows = [row("primary", 0.5), row("shuffled", 32.5)];
        let mut tally = Tally { rays: 1_234_567, met: 1_000, cut: 67, ..Tally::default() };
        tally.near_double = 2;
        tally.at_end = 3;
        tally.errors.add(2e-7);
        let checks = [Check { model: "a|b".into(), kind: Kind::Voxels, tally }];
        let text = submission(&rows, &checks, &["c: too\nlarge".into()]);
        // Text of a driver can end neither a cell nor a row.
        has(&text, r"| adapter | Some \| GPU of mine |");
        has(&text, "| backend | Vulkan |");
        has(&text, "**0 of 1,234,500 rays wrong**, compared one by one with the reference tracer.");
        has(&text, r"| a\|b | voxels | 1,234,500 | 1,000 | 0 | 5 | 67 | 2.0e-7 | 1.9e-6 of t |");
        has(&text, r"| a\|b | voxels | primary | 25.0 % | 1000 | 1.2 % | 0.500 |");
        has(&text, r"| a\|b | voxels | shuffled | 25.0 % | 15.4 | 1.2 % | 32.5 |");
        has(&text, "**Not measured:** c: too large");
        assert!(text.contains("1000×500, medians of 40 runs"), "{text}");
        assert!(!text.contains("wrong rays") && !text.contains("software adapter"), "{text}");
    }

    #[test]
    fn wrong_rays_are_shown() {
        let check = |kind, wrong: u64| {
            let examples = vec![format!("ray {wrong}")];
            let tally = Tally { rays: 10, wrong, examples, ..Tally::default() };
            Check { model: "m".into(), kind, tally }
        };
        let checks = [check(Kind::Smooth, 1), check(Kind::Fog, 2)];
        let text = submission(&[], &checks, &[]);
        has(&text, "**⚠ 3 of 20 rays wrong**, compared one by one with the reference tracer.");
        has(&text, "| m | fog | 10 | 0 | 2 | 0 | 0 | 0.0e0 | 1.0e-3 transmittance |");
        assert!(text.contains("```text\nray 1\nray 2\n```"), "{text}");
        // Nothing was timed.
        assert!(!text.contains("Mrays/s"), "{text}");
    }
}
