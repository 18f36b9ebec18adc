//! What recording costs the app that is recorded.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::fog;
use bevy_vdb::{VdbRecordClock, VdbRecordPhase, VdbRecordStatus, VdbRecordWhenFull};

use crate::studio::{Studio, WARM};
use crate::{Args, CELLS, cells, print_heading};

/// Voxels from the middle of the cloud to its rim.
const RADIUS: f64 = 90.0;
/// Fog as exact as it can be, but for how often a light asks for its shadow.
const QUALITY: VdbQuality = VdbQuality { fog_light_step: 8.0, ..VdbQuality::EXACT };

pub fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::new(args.size)?;
    let cloud = studio.grid(fog::cloud(RADIUS, 7), PackKind::Fog, 1.0 / RADIUS)?;
    let look = VdbMaterial { density_scale: 20.0, ..default() };
    studio.app.world_mut().spawn((VdbVolume(cloud), look));
    studio.camera_mut().insert((QUALITY, VdbRecorder::default()));
    studio.settle(1)?;
    let (step, ms) = calibrate(&mut studio, args.ms);
    print_heading(&studio, "Recording", args.size);
    println!("A cloud in the sun, fog_light_step {step}: {ms:.2} ms a frame.\n");
    let mut formats = vec![("PNG", VdbRecordFormat::PngSequence, "frames")];
    if has_ffmpeg() {
        formats.push(("MP4", VdbRecordFormat::Mp4, "film.mp4"));
    } else {
        println!("There is no ffmpeg: no MP4.\n");
    }
    println!("| recorded | when full |{CELLS} written | repeated |");
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
                let (times, status) = recorded(&mut studio, args.frames, settings.clone())?;
                with.extend(times);
                written += status.written;
                dropped += status.dropped;
                clear(&args.out);
            }
            let cells = cells(&mut with, &mut without);
            println!("| {name} | {when_full:?} |{cells} {written} | {dropped} |");
        }
    }
    Ok(())
}

/// Chooses steps along rays to lights with which a frame takes about so long; the steps in voxels, and
/// the time in ms.
fn calibrate(studio: &mut Studio, wanted: f64) -> (f32, f64) {
    let mut quality = QUALITY;
    let mut ms = 0.0;
    for _ in 0..4 {
        studio.camera_mut().insert(quality);
        studio.frames(WARM);
        let mut times = studio.frames(WARM);
        times.sort_by(f64::total_cmp);
        ms = times[WARM / 2];
        let step = f64::from(quality.fog_light_step) * ms / wanted;
        let step = step.clamp(0.25, 64.0) as f32;
        if (step / quality.fog_light_step).ln().abs() < 0.1 {
            break;
        }
        quality.fog_light_step = step;
    }
    (studio.camera_mut().get::<VdbQuality>().map_or(0.0, |quality| quality.fog_light_step), ms)
}

/// Frames with a recorder; it has ended when they come back.
fn recorded(
    studio: &mut Studio,
    frames: usize,
    settings: VdbRecordSettings,
) -> Result<(Vec<f64>, VdbRecordStatus), String> {
    recorder(studio).start(settings).map_err(|error| error.to_string())?;
    // The first ones make the buffers.
    studio.frames(4);
    let times = studio.frames(frames);
    recorder(studio).stop();
    let start = Instant::now();
    loop {
        studio.frames(1);
        let status = recorder(studio).status();
        match (status.phase, status.error.clone()) {
            (_, Some(error)) => return Err(error.to_string()),
            (VdbRecordPhase::Ended, None) => return Ok((times, status)),
            _ if start.elapsed().as_secs() > 300 => return Err("it does not end".into()),
            _ => {}
        }
    }
}

fn recorder(studio: &mut Studio) -> Mut<'_, VdbRecorder> {
    studio.camera_mut().into_mut().expect("the camera has one")
}

fn clear(folder: &Path) {
    if let Err(error) = std::fs::remove_dir_all(folder) {
        eprintln!("frames: {}: {error}", folder.display());
    }
}

fn has_ffmpeg() -> bool {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.arg("-version").stdout(Stdio::null()).stderr(Stdio::null());
    ffmpeg.status().is_ok_and(|status| status.success())
}
