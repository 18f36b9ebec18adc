//! What recording costs the app that is recorded: times of frames with a recorder and without one, in
//! turns. `scripts/bench-record` builds and runs it; `docs/benchmarks.md` tells of it.

mod frames;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::Instant;

use bevy::prelude::*;
use bevy::render::renderer::RenderAdapterInfo;
use bevy_vdb::prelude::*;
use bevy_vdb::{VdbRecordClock, VdbRecordPhase, VdbRecordWhenFull};
use frames::Studio;
use lexopt::{Arg, Parser, ValueExt};

const HELP: &str = "\
record [OPTION…]
Times frames of a cloud in the sun with a recorder and without one, in turns. Needs nothing but itself;
with the program ffmpeg, videos are recorded as well.

  --out DIR       where the recordings go, to be deleted at once; a folder for temporary files
  --size WxH      of the picture; 1920x1080
  --ms N          milliseconds that a frame should take by itself, by longer or shorter steps; 7
  --frames N      frames a turn, at least 10; 300
  --rounds N      turns of each kind, at least 1; 5
  --rate N        frames a second of the recordings; 60
";

struct Args {
    out: PathBuf,
    size: UVec2,
    ms: f64,
    frames: usize,
    rounds: usize,
    rate: u32,
}

impl Args {
    fn parse() -> Result<Option<Self>, String> {
        let out = std::env::temp_dir().join(format!("bevy_vdb_record_{}", std::process::id()));
        let size = UVec2::new(1920, 1080);
        let mut args = Self { out, size, ms: 7.0, frames: 300, rounds: 5, rate: 60 };
        let mut parser = Parser::from_env();
        while let Some(arg) = parser.next().map_err(|error| error.to_string())? {
            let name = match arg {
                // `cargo bench` adds an option of its own.
                Arg::Long("bench") => continue,
                Arg::Long("help") => {
                    print!("{HELP}");
                    return Ok(None);
                }
                Arg::Long(name) => name.to_owned(),
                other => return Err(other.unexpected().to_string()),
            };
            let value = parser.value().and_then(|value| value.string());
            let value = value.map_err(|error| error.to_string())?;
            let wrong = || format!("--{name} {value}: not understood; see --help");
            let count = |least: u32| {
                value.parse::<u32>().ok().filter(|count| *count >= least).ok_or_else(wrong)
            };
            match name.as_str() {
                "out" => args.out = value.clone().into(),
                "frames" => args.frames = count(10)? as usize,
                "rounds" => args.rounds = count(1)? as usize,
                "rate" => args.rate = count(1)?,
                "ms" => {
                    let ms = value.parse().ok().filter(|ms: &f64| ms.is_finite() && *ms > 0.0);
                    args.ms = ms.ok_or_else(wrong)?;
                }
                "size" => {
                    let (x, y) = value.split_once('x').ok_or_else(wrong)?;
                    let size = (x.parse().ok(), y.parse().ok());
                    let (Some(x), Some(y)) = size else { return Err(wrong()) };
                    args.size = Some(UVec2::new(x, y))
                        .filter(|size| size.min_element() >= 16 && size.max_element() <= 8192)
                        .ok_or_else(wrong)?;
                }
                _ => return Err(format!("--{name}: no such option; see --help")),
            }
        }
        Ok(Some(args))
    }
}

fn main() -> ExitCode {
    let done = match Args::parse() {
        Ok(Some(args)) => run(&args),
        Ok(None) => return ExitCode::SUCCESS,
        Err(message) => Err(message),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("record: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::new(args.size)?;
    let info = studio.app.world().resource::<RenderAdapterInfo>().clone();
    println!("{} ({} {}), {:?}", info.name, info.driver, info.driver_info, info.backend);
    let (step, ms) = studio.calibrate(args.ms);
    println!(
        "{}x{}, a cloud in the sun, fog_light_step {step}: {ms:.2} ms a frame\n",
        args.size.x, args.size.y
    );
    let mut formats = vec![("PNG", VdbRecordFormat::PngSequence, "frames")];
    if has_ffmpeg() {
        formats.push(("MP4", VdbRecordFormat::Mp4, "film.mp4"));
    } else {
        println!("there is no ffmpeg: no MP4\n");
    }
    println!(
        "| recorded | when full | median, ms | without | ratio | mean, ms | without | ratio | 99 %, ms | without | written | repeated |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (name, format, file) in formats {
        for when_full in [VdbRecordWhenFull::Drop, VdbRecordWhenFull::Wait] {
            let target = args.out.join(file);
            let settings = VdbRecordSettings {
                frame_rate: args.rate,
                clock: VdbRecordClock::RealTime,
                when_full,
                ..VdbRecordSettings::new(target, format)
            };
            let (mut without, mut with) = (Vec::new(), Vec::new());
            let (mut written, mut dropped) = (0, 0);
            for _ in 0..args.rounds {
                without.extend(studio.frames(args.frames));
                let (times, status) = studio.recorded(args.frames, settings.clone())?;
                with.extend(times);
                written += status.written;
                dropped += status.dropped;
                clear(&args.out);
            }
            let [own, other] = [&mut with, &mut without].map(|times| summary(times));
            let cells: String = (0..3)
                .map(|i| match i {
                    2 => format!(" {:.2} | {:.2} |", own[2], other[2]),
                    i => format!(" {:.2} | {:.2} | {:.3} |", own[i], other[i], own[i] / other[i]),
                })
                .collect();
            println!("| {name} | {when_full:?} |{cells} {written} | {dropped} |");
        }
    }
    Ok(())
}

/// Median, mean and 99th percentile, ms.
fn summary(times: &mut [f64]) -> [f64; 3] {
    times.sort_by(f64::total_cmp);
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    [times[times.len() / 2], mean, times[times.len() * 99 / 100]]
}

fn clear(folder: &Path) {
    if let Err(error) = std::fs::remove_dir_all(folder) {
        eprintln!("record: {}: {error}", folder.display());
    }
}

fn has_ffmpeg() -> bool {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.arg("-version").stdout(Stdio::null()).stderr(Stdio::null());
    ffmpeg.status().is_ok_and(|status| status.success())
}

impl Studio {
    /// Frames with a recorder; it has ended when they come back.
    fn recorded(
        &mut self,
        frames: usize,
        settings: VdbRecordSettings,
    ) -> Result<(Vec<f64>, bevy_vdb::VdbRecordStatus), String> {
        self.recorder().start(settings).map_err(|error| error.to_string())?;
        // The first ones make the buffers.
        self.frames(4);
        let times = self.frames(frames);
        self.recorder().stop();
        let start = Instant::now();
        loop {
            self.frames(1);
            let status = self.recorder().status();
            match (status.phase, status.error.clone()) {
                (_, Some(error)) => return Err(error.to_string()),
                (VdbRecordPhase::Ended, None) => return Ok((times, status)),
                _ if start.elapsed().as_secs() > 300 => return Err("it does not end".into()),
                _ => {}
            }
        }
    }
}
