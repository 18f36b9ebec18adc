//! From file to tree: time and peak memory, beside OpenVDB's own reader.
//!
//! `scripts/bench-read` builds the other side and starts this. Rounds of both alternate, each in a
//! process of its own, so that both see the same machine; the file is in the system's cache.

use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::{AnyTree, GridClass, VdbFile};

/// Processes of each side for each file.
const ROUNDS: usize = 7;
/// Reads in each process.
const RUNS: usize = 5;

/// What one process measured.
struct Sample {
    nanoseconds: Vec<u64>,
    /// Kilobytes.
    peak: u64,
}

fn main() -> Result<(), Box<dyn Error>> {
    // `cargo bench` adds an option of its own.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["child", "tree", file, runs] => child(file, runs.parse()?, false),
        ["child", "gpu", file, runs] => child(file, runs.parse()?, true),
        [peer, ref files @ ..] if !files.is_empty() => compare(peer, files),
        _ => {
            println!("nothing measured; start this with scripts/bench-read");
            Ok(())
        }
    }
}

/// Reads a file some times, to the tree or on to the words that the GPU walks.
fn child(file: &str, runs: usize, to_gpu: bool) -> Result<(), Box<dyn Error>> {
    for _ in 0..runs {
        let start = Instant::now();
        let read = VdbFile::open(file)?;
        let packed = if to_gpu { Some(pack(&read)?) } else { None };
        println!("{}", start.elapsed().as_nanos());
        black_box((read, packed));
    }
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    println!("{}", peak.ok_or("no VmHWM")?.trim().trim_end_matches(" kB"));
    Ok(())
}

fn pack(file: &VdbFile) -> Result<Vec<PackedGrid>, Box<dyn Error>> {
    let mut packed = Vec::new();
    for grid in &file.grids {
        let kind = match grid.class {
            GridClass::LevelSet => PackKind::Surface { iso: 0.0 },
            _ => PackKind::Fog,
        };
        let AnyTree::Float(tree) = &grid.tree else { return Err("not a grid of floats".into()) };
        packed.push(PackedGrid::new(tree, kind)?);
    }
    Ok(packed)
}

fn measure(command: &mut Command) -> Result<Sample, Box<dyn Error>> {
    let output = command.output()?;
    if !output.status.success() {
        return Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let mut numbers: Vec<u64> =
        str::from_utf8(&output.stdout)?.lines().map(str::parse).collect::<Result<_, _>>()?;
    let peak = numbers.pop().ok_or("no peak")?;
    Ok(Sample { nanoseconds: numbers, peak })
}

fn median(numbers: &mut [u64]) -> f64 {
    numbers.sort_unstable();
    numbers[numbers.len() / 2] as f64
}

fn compare(peer: &str, files: &[&str]) -> Result<(), Box<dyn Error>> {
    let own = std::env::current_exe()?;
    println!("Median of {} reads, ms; peak memory of one read, MB.", ROUNDS * RUNS);
    println!(
        "| file | size | tree | OpenVDB's | ratio | GPU words | ratio | memory | OpenVDB's | ratio |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let mut ratios = [const { Vec::new() }; 3];
    for file in files {
        let ours = |to: &str, runs: usize| {
            measure(Command::new(&own).args(["child", to, *file, &runs.to_string()]))
        };
        let theirs = |runs: usize| measure(Command::new(peer).args([*file, &runs.to_string()]));
        let (our_peak, their_peak) = (ours("tree", 1)?.peak as f64, theirs(1)?.peak as f64);
        let (mut our_times, mut their_times, mut gpu_times) = (vec![], vec![], vec![]);
        for _ in 0..ROUNDS {
            our_times.extend(ours("tree", RUNS)?.nanoseconds);
            their_times.extend(theirs(RUNS)?.nanoseconds);
            gpu_times.extend(ours("gpu", RUNS)?.nanoseconds);
        }
        let (our_time, their_time) = (median(&mut our_times), median(&mut their_times));
        let gpu_time = median(&mut gpu_times);
        ratios[0].push(our_time / their_time);
        ratios[1].push(gpu_time / their_time);
        ratios[2].push(our_peak / their_peak);
        println!(
            "| {} | {:.1} MB | {:.1} | {:.1} | {:.2} | {:.1} | {:.2} | {:.0} | {:.0} | {:.2} |",
            Path::new(file).file_stem().unwrap_or_default().to_string_lossy(),
            std::fs::metadata(file)?.len() as f64 / 1e6,
            our_time / 1e6,
            their_time / 1e6,
            our_time / their_time,
            gpu_time / 1e6,
            gpu_time / their_time,
            our_peak / 1e3,
            their_peak / 1e3,
            our_peak / their_peak,
        );
    }
    let middle = |ratios: &mut Vec<f64>| {
        ratios.sort_by(f64::total_cmp);
        (ratios[(ratios.len() - 1) / 2] + ratios[ratios.len() / 2]) / 2.0
    };
    let [tree, gpu, memory] = ratios.each_mut().map(middle);
    println!("Median ratio: tree {tree:.2}, GPU words {gpu:.2}, memory {memory:.2}.");
    Ok(())
}
