//! Translates the shader variants in a folder with naga's back ends for Metal, Direct3D and OpenGL ES, for
//! `scripts/compilers`. Fails if a translation fails for a reason that is not among those expected.

mod targets;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{Module, front};
use rayon::prelude::*;

use targets::TARGETS;

/// What has come of one target, over all variants.
#[derive(Default)]
struct Outcome {
    translated: usize,
    bytes: usize,
    /// By the reason: the number of variants, and the first line of one of them, which has its defs.
    failed: BTreeMap<String, (usize, String)>,
}

impl Outcome {
    fn add(&mut self, translated: &Result<usize, String>, title: &str) {
        match translated {
            Ok(bytes) => {
                self.translated += 1;
                self.bytes += bytes;
            }
            Err(reason) => {
                self.failed.entry(reason.clone()).or_insert_with(|| (0, title.into())).0 += 1;
            }
        }
    }
}

thread_local! {
    /// Where this thread has last panicked, and why.
    static LAST_PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(|panic| {
        let file = panic.location().and_then(|location| Path::new(location.file()).file_name());
        let file = file.unwrap_or_default().display();
        let line = panic.location().map_or(0, |location| location.line());
        let text = panic.payload_as_str().unwrap_or_default();
        LAST_PANIC.set(format!("naga panics in {file}, line {line}: {text}"));
    }));
    let folder = std::env::args_os().nth(1).map(PathBuf::from);
    let checked = folder
        .ok_or_else(|| "name the folder of the variants".into())
        .and_then(|folder| check(&folder));
    match checked {
        Ok(0) => ExitCode::SUCCESS,
        Ok(unexpected) => {
            eprintln!("compilers: {unexpected} unexpected results, marked with *");
            ExitCode::FAILURE
        }
        Err(message) => {
            eprintln!("compilers: {message}");
            ExitCode::FAILURE
        }
    }
}

/// Translates all variants in a folder, prints the table, and returns how many results were not expected.
fn check(folder: &Path) -> Result<usize, String> {
    let files = files(folder)?;
    let results: Vec<(String, Vec<Result<usize, String>>)> =
        files.par_iter().map(|file| translate(file)).collect::<Result<_, _>>()?;
    let mut outcomes: Vec<Outcome> = TARGETS.iter().map(|_| Outcome::default()).collect();
    for (title, results) in &results {
        for (outcome, result) in outcomes.iter_mut().zip(results) {
            outcome.add(result, title);
        }
    }
    println!("{} variants\n", files.len());
    println!("| target | translated | failed | MB written |\n|---|---|---|---|");
    for (target, outcome) in TARGETS.iter().zip(&outcomes) {
        let failed = files.len() - outcome.translated;
        let size = outcome.bytes as f64 / 1e6;
        println!("| {} | {} | {failed} | {size:.0} |", target.name, outcome.translated);
    }
    Ok(TARGETS.iter().zip(&outcomes).map(|(target, outcome)| explain(target, outcome)).sum())
}

/// Prints why translations failed, and returns how many reasons were not expected, with those that were expected and
/// did not occur.
fn explain(target: &targets::Target, outcome: &Outcome) -> usize {
    let is_expected = |reason: &str| target.lacks.iter().any(|(text, _)| reason.contains(text));
    for (reason, (count, title)) in &outcome.failed {
        let mark = if is_expected(reason) { ' ' } else { '*' };
        println!("\n{mark} {}, {count} variants: {reason}\n    for example {title}", target.name);
    }
    let gone = |text: &str| !outcome.failed.keys().any(|reason| reason.contains(text));
    let stale = target.lacks.iter().filter(|(text, _)| gone(text));
    let stale = stale.inspect(|(text, why)| {
        println!("\n* {}: expected and not found: {text} ({why})", target.name);
    });
    stale.count() + outcome.failed.keys().filter(|reason| !is_expected(reason)).count()
}

fn files(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let told = |error| format!("{}: {error}", folder.display());
    let entries = std::fs::read_dir(folder).map_err(told)?;
    let paths: Vec<_> = entries
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()
        .map_err(told)?;
    let mut files: Vec<_> =
        paths.into_iter().filter(|path| path.extension().is_some_and(|e| e == "wgsl")).collect();
    files.sort();
    if files.is_empty() { Err(format!("no variants in {}", folder.display())) } else { Ok(files) }
}

/// The first line of a variant, and the bytes that each target takes or why it has none.
fn translate(file: &Path) -> Result<(String, Vec<Result<usize, String>>), String> {
    let text =
        std::fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?;
    let title = text.lines().next().unwrap_or_default().trim_start_matches("// ").to_owned();
    let (module, info) = read(&text).map_err(|error| format!("{title}: {error}"))?;
    let one = |target: &targets::Target| {
        let points = 0..module.entry_points.len();
        // Back ends panic at some of what they do not support.
        let translated =
            catch_unwind(|| points.map(|point| (target.translate)(&module, &info, point)).sum());
        translated.unwrap_or_else(|_| Err(LAST_PANIC.take()))
    };
    Ok((title, TARGETS.iter().map(one).collect()))
}

fn read(text: &str) -> Result<(Module, ModuleInfo), String> {
    let module = front::wgsl::parse_str(text).map_err(|error| error.emit_to_string(text))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .map_err(|error| error.emit_to_string(text))?;
    if module.entry_points.is_empty() {
        return Err("no entry point".into());
    }
    Ok((module, info))
}
