//! Writes a sequence with its frames in between.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use vdb_core::display::quoted;
use vdb_core::{Grid, VdbFile, WriteOptions};

use super::frame::Numbered;
use super::{Args, Maker, Pair};
use crate::files::{make_folder, open, shown};
use crate::terminal;

struct Writer<'a> {
    maker: Maker<'a>,
    out: &'a Path,
    /// What a frame's number is multiplied by.
    times: u64,
    written: [u64; 2],
    /// The grids that have been named as left out.
    left_out: HashSet<String>,
}

/// Writes all frames that can be written.
pub fn run(args: &Args, frames: &[Numbered]) -> Result<ExitCode, String> {
    let out = args.out.as_deref().unwrap_or(Path::new("."));
    let times = u64::from(args.steps.get()) + 1;
    check_numbers(frames, times)?;
    make_folder(out)?;
    check_folder(out, frames)?;
    let maker = Maker { args, found: None };
    let mut writer = Writer { maker, out, times, written: [0; 2], left_out: HashSet::new() };
    let mut code = ExitCode::SUCCESS;
    let mut before: Option<(&Numbered, VdbFile)> = None;
    for frame in frames {
        let file = open(&frame.path, &args.limits);
        let done = file.and_then(|file| {
            let from = before.take();
            let done = writer.keep(frame, &file).and_then(|()| match &from {
                Some((from, from_file)) => {
                    writer.fill(&Pair { from: (from, from_file), to: (frame, &file) })
                }
                None => Ok(()),
            });
            before = Some((frame, file));
            done
        });
        if let Err(error) = done {
            terminal::complain(&error);
            code = ExitCode::FAILURE;
        }
    }
    let [kept, made] = writer.written;
    let summary = format!("{kept} of {} frames written, and {made} in between\n", frames.len());
    Ok(terminal::print(&summary, code).break_value().unwrap_or(code))
}

/// The most frames that an app plays as one sequence.
const MOST: u64 = 100_000;

/// Whether the new sequence has as many frames as can be played, and numbers for them.
fn check_numbers(frames: &[Numbered], times: u64) -> Result<(), String> {
    if let Some(frame) = frames.iter().find(|frame| frame.number.checked_mul(times).is_none()) {
        return Err(format!(
            "{}: a number too large to be multiplied by {times}; rename the frames",
            shown(&frame.path)
        ));
    }
    if let [first, .., last] = frames {
        let count = ((last.number - first.number) * times).saturating_add(1);
        if count > MOST {
            return Err(format!(
                "{} to {} with all frames in between would be {count} frames, and a sequence has \
                 at most {MOST}; name fewer frames",
                shown(&first.path),
                shown(&last.path)
            ));
        }
    }
    Ok(())
}

/// Whether the folder is another than that of the frames, which new ones would replace.
fn check_folder(out: &Path, frames: &[Numbered]) -> Result<(), String> {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    let parent = |path: &Path| match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    let target = real(out);
    if frames.iter().any(|frame| target.is_some() && real(&parent(&frame.path)) == target) {
        return Err(format!(
            "{}: the frames themselves are in this folder, and would be replaced; choose another",
            shown(out)
        ));
    }
    Ok(())
}

impl Writer<'_> {
    /// Writes the grids of a frame under its new number.
    fn keep(&mut self, frame: &Numbered, file: &VdbFile) -> Result<(), String> {
        let names = self.maker.names(file);
        for grid in file.grids.iter().filter(|grid| !names.iter().any(|name| is(grid, name))) {
            if self.left_out.insert(grid.unique_name.clone()) {
                let name = quoted(&grid.unique_name);
                terminal::complain(&format!("{}: grid {name} is left out", shown(&frame.path)));
            }
        }
        let grids = file.grids.iter().filter(|grid| names.iter().any(|name| is(grid, name)));
        self.save(frame, frame.number * self.times, file, grids.cloned().collect())?;
        self.written[0] += 1;
        Ok(())
    }

    /// Writes the frames between two.
    fn fill(&mut self, pair: &Pair) -> Result<(), String> {
        let names = self.maker.names_between(pair);
        let options = self.maker.options(pair, &names)?;
        let steps = pair.gap() * self.times;
        for step in 1..steps {
            let t = step as f64 / steps as f64;
            let make = |name: &String| self.maker.make(pair, name, t, &options);
            let grids = names.iter().map(make).collect::<Result<Vec<_>, _>>()?;
            let nearer = if t < 0.5 { pair.from } else { pair.to };
            self.save(nearer.0, pair.from.0.number * self.times + step, nearer.1, grids)?;
            self.written[1] += 1;
        }
        Ok(())
    }

    fn save(
        &self,
        frame: &Numbered,
        number: u64,
        file: &VdbFile,
        grids: Vec<Grid>,
    ) -> Result<(), String> {
        let path = self.out.join(frame.named(number));
        let file = VdbFile { metadata: file.metadata.clone(), ..VdbFile::new(grids) };
        file.save(path, &WriteOptions::default()).map_err(|error| error.to_string())
    }
}

fn is(grid: &Grid, name: &str) -> bool {
    grid.name == name || grid.unique_name == name
}
