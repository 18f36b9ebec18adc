//! Cooked files: size, time to cook and to decode on one thread, in new memory and in memory that is
//! used again, and on all threads.
//!
//! `cargo bench -p vdb_core --bench cooked -- FILE.vdb …` prints a row of a table for each format;
//! without files nothing is measured.

use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use vdb_core::cooked::{CookOptions, CookedError, CookedFile};
use vdb_core::pack::{PackKind, SpareWords, ValueFormat};
use vdb_core::{ReadOptions, VdbFile};

/// Decodings of each file.
const RUNS: usize = 31;

fn main() -> Result<(), Box<dyn Error>> {
    let files: Vec<String> = std::env::args().skip(1).filter(|a| a.ends_with(".vdb")).collect();
    if files.is_empty() {
        println!("nothing measured; name .vdb files");
        return Ok(());
    }
    println!(
        "| file | format | MB | of the .vdb | GPU words, MB | cook, ms | decode, ms | in used memory | on {} threads |",
        rayon::current_num_threads()
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    files.iter().try_for_each(|file| measure(file))
}

fn measure(path: &str) -> Result<(), Box<dyn Error>> {
    let size = std::fs::metadata(path)?.len() as f64;
    let file = VdbFile::open(path)?;
    let stem = Path::new(path).file_stem().unwrap_or_default().to_string_lossy();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let kinds = [("", None), (", smooth", Some(PackKind::Smooth { iso: 0.0 }))];
    for (name, format) in [
        ("byte", ValueFormat::Byte),
        ("half", ValueFormat::Half),
        ("exact", ValueFormat::Exact),
        ("full", ValueFormat::Full),
    ] {
        for (suffix, kind) in kinds {
            let options = CookOptions { format, kind, ..CookOptions::default() };
            let start = Instant::now();
            let cooked = CookedFile::cook(&file, &options)?;
            if kind.is_some() && cooked.grids.iter().all(|grid| grid.packed.occupied.is_none()) {
                continue;
            }
            let bytes = cooked.write()?;
            let cook = start.elapsed();
            let words: u64 = cooked.grids.iter().map(|grid| grid.packed.bytes()).sum();
            drop(cooked);
            println!(
                "| {stem} | {name}{suffix} | {:.2} | {:.2} | {:.1} | {:.0} | {:.2} | {:.2} | {:.2} |",
                bytes.len() as f64 / 1e6,
                bytes.len() as f64 / size,
                words as f64 / 1e6,
                cook.as_secs_f64() * 1e3,
                one.install(|| decode(&bytes, SpareWords::new(0)))?,
                one.install(|| decode(&bytes, SpareWords::new(u64::MAX)))?,
                decode(&bytes, SpareWords::new(0))?,
            );
        }
    }
    Ok(())
}

/// The median time to decode a file, in ms, each time in the memory of `spare`, if there is any.
fn decode(bytes: &[u8], spare: SpareWords) -> Result<f64, CookedError> {
    let (mut times, spare) = (Vec::new(), Arc::new(spare));
    for _ in 0..RUNS {
        let start = Instant::now();
        let read = CookedFile::read_reusing(bytes, &ReadOptions::default(), &spare)?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
        drop(black_box(read));
    }
    times.sort_by(f64::total_cmp);
    Ok(times[RUNS / 2])
}
