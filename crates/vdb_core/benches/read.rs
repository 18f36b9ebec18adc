//! From file to tree: time and peak memory, beside OpenVDB's own reader.
//!
//! `scripts/bench-read` builds the other side and starts this. Rounds of both alternate, each in a
//! process of its own, so that both see the same machine; the file is in the system's cache.

use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use vdb_core::VdbFile;

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
        ["child", file, runs] => child(file, runs.parse()?),
        [peer, ref files @ ..] if !files.is_empty() => compare(peer, files),
        _ => {
            println!("nothing measured; start this with scripts/bench-read");
            Ok(())
        }
    }
}

fn child(file: &str, runs: usize) -> Result<(), Box<dyn Error>> {
    for _ in 0..runs {
        let start = Instant::now();
        let read = VdbFile::open(file)?;
        println!("{}", start.elapsed().as_nanos());
        black_box(read);
    }
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    println!("{}", peak.ok_or("no VmHWM")?.trim().trim_end_matches(" kB"));
    Ok(())
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
    println!("| file | size | ours | OpenVDB | ratio | ours | OpenVDB | ratio |");
    println!("|---|---|---|---|---|---|---|---|");
    let mut ratios = (Vec::new(), Vec::new());
    for file in files {
        let ours =
            |runs: usize| measure(Command::new(&own).args(["child", *file, &runs.to_string()]));
        let theirs = |runs: usize| measure(Command::new(peer).args([*file, &runs.to_string()]));
        let (our_peak, their_peak) = (ours(1)?.peak as f64, theirs(1)?.peak as f64);
        let (mut our_times, mut their_times) = (Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            our_times.extend(ours(RUNS)?.nanoseconds);
            their_times.extend(theirs(RUNS)?.nanoseconds);
        }
        let (our_time, their_time) = (median(&mut our_times), median(&mut their_times));
        ratios.0.push(our_time / their_time);
        ratios.1.push(our_peak / their_peak);
        println!(
            "| {} | {:.1} MB | {:.1} | {:.1} | {:.2} | {:.0} | {:.0} | {:.2} |",
            Path::new(file).file_stem().unwrap_or_default().to_string_lossy(),
            std::fs::metadata(file)?.len() as f64 / 1e6,
            our_time / 1e6,
            their_time / 1e6,
            our_time / their_time,
            our_peak / 1e3,
            their_peak / 1e3,
            our_peak / their_peak,
        );
    }
    let middle = |ratios: &mut Vec<f64>| {
        ratios.sort_by(f64::total_cmp);
        (ratios[(ratios.len() - 1) / 2] + ratios[ratios.len() / 2]) / 2.0
    };
    println!(
        "Median ratio: time {:.2}, memory {:.2}.",
        middle(&mut ratios.0),
        middle(&mut ratios.1)
    );
    Ok(())
}
