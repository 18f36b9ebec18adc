//! Measures made frames against true ones.

use std::fmt::Write;
use std::process::ExitCode;

use vdb_core::VdbFile;
use vdb_core::between::{BetweenOptions, Difference, Method, Rays, compare};
use vdb_core::display::{escaped, quoted};

use super::frame::Numbered;
use super::{Args, Maker, Pair};
use crate::files::{open, shown};
use crate::terminal;

/// The errors of one grid in one frame: of a cross-fade, and of the method.
struct Row {
    name: String,
    frame: String,
    errors: [Difference; 2],
}

const HEAD: &str = "\
| frame | L1: fade | made | ratio | L2: fade | made | ratio | rays: fade | made | ratio | worst: fade | made |
|---|---|---|---|---|---|---|---|---|---|---|---|
";

/// Leaves out every second frame, makes it from its neighbours, and prints the errors. A frame that
/// cannot be read or made is told of, and stops no other.
pub fn run(args: &Args, frames: &[Numbered]) -> Result<ExitCode, String> {
    if frames.len() < 3 {
        return Err("too few frames to leave one out; name three or more".into());
    }
    let mut maker = Maker { args, found: None };
    let (mut rows, mut code) = (Vec::new(), ExitCode::SUCCESS);
    let mut last: Option<VdbFile> = None;
    for three in frames.windows(3).step_by(2) {
        match left_out(&mut maker, three, &mut last) {
            Ok(more) => rows.extend(more),
            Err(error) => {
                terminal::complain(&error);
                code = ExitCode::FAILURE;
            }
        }
    }
    let mut names: Vec<&str> = Vec::new();
    for row in &rows {
        if !names.contains(&row.name.as_str()) {
            names.push(&row.name);
        }
    }
    let mut text = String::new();
    for name in names {
        let rows: Vec<&Row> = rows.iter().filter(|row| row.name == name).collect();
        table(&mut text, name, &rows);
    }
    if let Some(scale) = maker.found {
        let _ = writeln!(text, "velocity scale: {scale:.4} world units per frame and unit");
    }
    Ok(terminal::print(&text, code).break_value().unwrap_or(code))
}

/// Measures the second of three frames. The third one stays open for the next three.
fn left_out(
    maker: &mut Maker,
    three: &[Numbered],
    last: &mut Option<VdbFile>,
) -> Result<Vec<Row>, String> {
    let [first, second, third] = three else { return Ok(Vec::new()) };
    let limits = &maker.args.limits;
    let from = match last.take() {
        Some(file) => file,
        None => open(&first.path, limits)?,
    };
    let to = last.insert(open(&third.path, limits)?);
    let truth = open(&second.path, limits)?;
    measure(maker, &Pair { from: (first, &from), to: (third, to) }, (second, &truth))
}

/// Measures all grids of a frame that have anything in them.
fn measure(
    maker: &mut Maker,
    pair: &Pair,
    truth: (&Numbered, &VdbFile),
) -> Result<Vec<Row>, String> {
    let names = maker.names_between(pair);
    let options = maker.options(pair, &names)?;
    let fade = BetweenOptions { method: Method::CrossFade, ..options.clone() };
    let t = (truth.0.number - pair.from.0.number) as f64 / pair.gap() as f64;
    let mut rows = Vec::new();
    for name in names {
        let real = truth.1.grid(&name).filter(|grid| grid.tree.active_voxel_count() > 0);
        let Some(real) = real else {
            let path = shown(&truth.0.path);
            terminal::complain(&format!("{path}: nothing to compare in {}", quoted(&name)));
            continue;
        };
        let mut errors = [Difference::default(); 2];
        for (error, options) in errors.iter_mut().zip([&fade, &options]) {
            let made = maker.make(pair, &name, t, options)?;
            *error = compare(&made, real, maker.args.extinction)
                .map_err(|error| error.in_file(&truth.0.path).to_string())?;
        }
        rows.push(Row { name, frame: truth.0.number.to_string(), errors });
    }
    Ok(rows)
}

/// The rows of a grid, and their means; of the largest errors, the largest.
fn table(text: &mut String, name: &str, rows: &[&Row]) {
    let _ = writeln!(text, "{}\n", escaped(name));
    text.push_str(HEAD);
    rows.iter().for_each(|row| line(text, &row.frame, &row.errors));
    let count = rows.len() as f64;
    let all = [0, 1].map(|which: usize| {
        let mut all = Difference::default();
        for error in rows.iter().map(|row| &row.errors[which]) {
            all.l1 += error.l1 / count;
            all.l2 += error.l2 / count;
            for (all, rays) in all.rays.iter_mut().zip(error.rays) {
                *all = Rays { mean: all.mean + rays.mean / count, max: all.max.max(rays.max) };
            }
        }
        all
    });
    line(text, "all", &all);
    let extinctions = rows.iter().map(|row| row.errors[0].extinction);
    let range = extinctions.fold([f64::INFINITY, 0.0], |[low, high]: [f64; 2], extinction| {
        [low.min(extinction), high.max(extinction)]
    });
    let _ = writeln!(text, "\nextinction of the rays: {:.4} to {:.4}\n", range[0], range[1]);
}

fn line(text: &mut String, frame: &str, [fade, made]: &[Difference; 2]) {
    let mean = |error: &Difference| error.rays.iter().map(|rays| rays.mean).sum::<f64>() / 3.0;
    let worst = |error: &Difference| error.rays.iter().map(|rays| rays.max).fold(0.0, f64::max);
    let _ = write!(text, "| {frame} |");
    for [fade, made] in [[fade.l1, made.l1], [fade.l2, made.l2], [mean(fade), mean(made)]] {
        let _ = write!(text, " {fade:.3} | {made:.3} | {:.2} |", made / fade);
    }
    let _ = writeln!(text, " {:.3} | {:.3} |", worst(fade), worst(made));
}
