use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use bevy::math::UVec2;

use super::super::session::{Frame, Session};
use super::super::{
    VdbRecordError, VdbRecordFormat, VdbRecordPhase, VdbRecordSettings, VdbRecordStatus,
    VdbRecorder,
};
use super::*;

const SIZE: UVec2 = UVec2::new(48, 32);

fn start(settings: VdbRecordSettings) -> Result<Arc<Session>, VdbRecordError> {
    Session::start(settings, encode)
}

/// An empty folder.
fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("bevy_vdb_{name}_{}", std::process::id()));
    fs::remove_dir_all(&path).ok();
    fs::create_dir_all(&path).unwrap();
    path
}

/// Whether videos can be encoded and decoded; otherwise prints that a test is skipped.
fn has_ffmpeg() -> bool {
    let found = ["ffmpeg", "ffprobe"]
        .iter()
        .all(|program| Command::new(program).arg("-version").output().is_ok());
    if !found {
        eprintln!("SKIPPED: ffmpeg and ffprobe are not on the PATH (Debian: apt install ffmpeg)");
    }
    found
}

fn color(slot: u64) -> [u8; 4] {
    [(slot * 9) as u8, 200, 255 - (slot * 5) as u8, 255]
}

fn frame(slot: u64) -> Frame {
    Frame { slot, size: SIZE, pixels: color(slot).repeat((SIZE.x * SIZE.y) as usize) }
}

/// Noise, which does not compress.
fn noise(slot: u64) -> Frame {
    let mut state = slot.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let pixels = (0..SIZE.x * SIZE.y * 4).map(|_| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    });
    Frame { slot, size: SIZE, pixels: pixels.collect() }
}

fn send(session: &Session, frame: Frame) {
    assert!(session.claim());
    assert!(session.deliver(frame, true).is_ok());
}

/// Stops the recording, and waits for its end.
fn end(session: &Session) -> VdbRecordStatus {
    session.stop();
    session.join();
    let status = session.status();
    assert_eq!(status.phase, VdbRecordPhase::Ended);
    status
}

fn read_png(path: &Path) -> (UVec2, Vec<u8>) {
    let file = std::io::BufReader::new(fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    (UVec2::new(info.width, info.height), pixels)
}

/// The number of frames of a video that can be decoded.
fn count_frames(path: &Path) -> u64 {
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-count_frames", "-select_streams", "v:0"])
        .args(["-show_entries", "stream=nb_read_frames", "-of", "csv=p=0"])
        .arg(path)
        .output()
        .unwrap();
    String::from_utf8_lossy(&output.stdout).trim().trim_end_matches(',').parse().unwrap_or(0)
}

#[test]
fn pictures_are_what_was_captured_and_gaps_repeat() {
    let target = folder("png").join("new").join("sequence");
    let session = start(VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)).unwrap();
    [0, 1, 4, 5].into_iter().for_each(|slot| send(&session, frame(slot)));
    let status = end(&session);
    assert!(status.error.is_none(), "{status:?}");
    assert_eq!((status.captured, status.dropped, status.written), (4, 0, 6));
    for (file, slot) in [0, 1, 1, 1, 4, 5].into_iter().enumerate() {
        let (size, pixels) = read_png(&target.join(format!("{file:08}.png")));
        assert_eq!(size, SIZE);
        assert!(pixels.chunks_exact(3).all(|pixel| *pixel == color(slot)[..3]), "file {file}");
    }
    assert_eq!(fs::read_dir(&target).unwrap().count(), 6);
}

/// An encoder that stalls on its first frame until it is released.
#[test]
fn a_full_queue_gives_frames_back_or_waits() {
    let target = folder("queue");
    let settings = VdbRecordSettings {
        queue: 2,
        ..VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)
    };
    let (go_on, gate) = mpsc::channel();
    let session = Session::start(settings, move |session, frames| {
        let first = frames.recv();
        gate.recv().ok();
        first.into_iter().chain(frames).for_each(|_| session.count_written());
        Ok(())
    })
    .unwrap();
    // One frame is at the encoder, and two are in the queue.
    (0..3).for_each(|slot| send(&session, frame(slot)));
    assert!(session.claim());
    let refused = session.deliver(frame(3), false);
    assert_eq!(refused.map_err(|frame| frame.slot), Err(3), "the queue took more than it may");

    let waiting = std::thread::spawn({
        let session = session.clone();
        move || session.deliver(frame(3), true).is_ok()
    });
    std::thread::sleep(Duration::from_millis(100));
    assert!(!waiting.is_finished(), "a frame did not wait for room");
    assert_eq!(session.status().written, 0);
    go_on.send(()).unwrap();
    assert!(waiting.join().unwrap());
    let status = end(&session);
    assert!(status.error.is_none(), "{status:?}");
    assert_eq!(status.written, 4);
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let file = folder("unwritable").join("file");
    fs::write(&file, "").unwrap();
    for format in [VdbRecordFormat::PngSequence, VdbRecordFormat::Mp4] {
        let session = start(VdbRecordSettings::new(file.join("in").join("it"), format)).unwrap();
        let error = end(&session).error.unwrap();
        assert!(matches!(&error, VdbRecordError::Write { .. }), "{error:?}");
        assert!(error.to_string().contains(file.to_str().unwrap()), "{error}");
        // Sending more frames does not block.
        assert!(!session.claim());
        assert!(session.deliver(frame(0), true).is_ok());
    }
}

#[test]
fn a_picture_that_cannot_be_written_ends_a_sequence_of_whole_ones() {
    let target = folder("obstacle");
    fs::create_dir(target.join("00000002.png")).unwrap();
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    let session = start(VdbRecordSettings { overwrite: true, ..settings }).unwrap();
    for slot in 0..20 {
        if session.claim() {
            session.deliver(frame(slot), true).ok();
        }
    }
    let status = end(&session);
    assert_eq!(status.written, 2);
    let error = status.error.unwrap().to_string();
    assert!(error.contains("00000002.png"), "{error}");
    assert_eq!(fs::read_dir(&target).unwrap().count(), 3);
    (0..2).for_each(|file| drop(read_png(&target.join(format!("{file:08}.png")))));
}

/// `/dev/full` behaves like a full disk.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_no_half_picture() {
    let target = folder("full");
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    let pulse = Pulse::default();
    let mut sequence = PngSequence::new(&settings, &pulse, SIZE);
    sequence.write(&frame(0).pixels).unwrap();
    std::os::unix::fs::symlink("/dev/full", &sequence.part).unwrap();
    let error = sequence.write(&frame(1).pixels).unwrap_err().to_string();
    assert!(error.contains("00000001.png") && error.contains("No space left"), "{error}");
    assert_eq!(fs::read_dir(&target).unwrap().count(), 1);
    read_png(&target.join("00000000.png"));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_ends_a_video() {
    if !has_ffmpeg() {
        return;
    }
    let target = folder("full_video").join("full.mp4");
    std::os::unix::fs::symlink("/dev/full", target.with_extension("part.mp4")).unwrap();
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::Mp4);
    let session = start(VdbRecordSettings { overwrite: true, ..settings }).unwrap();
    for slot in 0..200 {
        if session.claim() {
            session.deliver(noise(slot), true).ok();
        }
    }
    let error = end(&session).error.unwrap();
    assert!(matches!(&error, VdbRecordError::Ffmpeg { .. }), "{error:?}");
    assert!(error.to_string().contains("No space left on device"), "{error}");
    assert!(!target.exists(), "what is cut short looks whole");
}

/// The id of the `ffmpeg` process that writes a file.
#[cfg(target_os = "linux")]
fn encoder_of(target: &Path) -> u32 {
    let until = Instant::now() + Duration::from_secs(20);
    while Instant::now() < until {
        for entry in fs::read_dir("/proc").unwrap().flatten() {
            let Some(id) = entry.file_name().to_str().and_then(|id| id.parse().ok()) else {
                continue;
            };
            let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
            if line.starts_with(b"ffmpeg\0")
                && String::from_utf8_lossy(&line).contains(target.to_str().unwrap())
            {
                return id;
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("no ffmpeg writes {}", target.display());
}

#[cfg(target_os = "linux")]
#[test]
fn a_killed_encoder_leaves_a_video_that_plays() {
    if !has_ffmpeg() {
        return;
    }
    for (format, name) in [(VdbRecordFormat::Mp4, "a.mp4"), (VdbRecordFormat::WebM, "a.webm")] {
        let target = folder("killed").join(name);
        let session =
            start(VdbRecordSettings { frame_rate: 10, ..VdbRecordSettings::new(&target, format) })
                .unwrap();
        // Until a few seconds of video are on the disk.
        let mut slot = 0;
        let part = part_of(&session.settings).unwrap();
        let large = |path: &Path| fs::metadata(path).is_ok_and(|file| file.len() > 200_000);
        while !large(&part) {
            assert!(slot < 2000, "nothing is written");
            send(&session, noise(slot));
            slot += 1;
        }
        let id = encoder_of(&part).to_string();
        assert!(Command::new("kill").args(["-9", &id]).status().unwrap().success());
        // The app continues to send frames.
        for slot in slot..slot + 50 {
            if session.claim() {
                session.deliver(noise(slot), true).ok();
            }
        }
        let status = end(&session);
        let error = status.error.unwrap();
        assert!(matches!(&error, VdbRecordError::Ffmpeg { .. }), "{error:?}");
        assert!(error.to_string().contains("signal: 9"), "{error}");
        assert!(!target.exists(), "what is cut short looks whole");
        assert_eq!(status.unfinished.as_ref(), Some(&part));
        let playable = count_frames(&part);
        println!("{name}: {slot} frames sent until the kill, {playable} can be played");
        assert!(playable >= 10, "{playable} of {slot} frames can be played");
    }
}

#[test]
fn colours_survive_a_video() {
    if !has_ffmpeg() {
        return;
    }
    let target = folder("colours").join("a.mp4");
    let session = start(VdbRecordSettings::new(&target, VdbRecordFormat::Mp4)).unwrap();
    (0..12).for_each(|slot| send(&session, frame(slot)));
    let status = end(&session);
    assert!(status.error.is_none(), "{status:?}");
    let output = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(&target)
        .args(["-vf", "scale=in_color_matrix=bt709", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
        .output()
        .unwrap();
    let frames: Vec<_> = output.stdout.chunks_exact((SIZE.x * SIZE.y * 3) as usize).collect();
    assert_eq!(frames.len(), 12);
    for (slot, pixels) in frames.into_iter().enumerate() {
        let middle = &pixels[pixels.len() / 2..][..3];
        // The rounding of luma and chroma to 8 bits in limited range, and coding losses.
        let near = |(a, b): (&u8, u8)| a.abs_diff(b) <= 4;
        assert!(
            middle.iter().zip(color(slot as u64)).all(near),
            "frame {slot}: {middle:?}, was {:?}",
            color(slot as u64)
        );
    }
}

#[test]
fn arguments_overrule_those_of_the_format() {
    if !has_ffmpeg() {
        return;
    }
    let size = |crf: &str| {
        let target = folder("arguments").join(format!("{crf}.mp4"));
        let session = start(VdbRecordSettings {
            ffmpeg_args: vec!["-crf".into(), crf.into()],
            ..VdbRecordSettings::new(&target, VdbRecordFormat::Mp4)
        })
        .unwrap();
        (0..12).for_each(|slot| send(&session, noise(slot)));
        assert!(end(&session).error.is_none());
        fs::metadata(&target).unwrap().len()
    };
    let (fine, coarse) = (size("10"), size("51"));
    assert!(coarse * 4 < fine, "{fine} bytes fine, {coarse} coarse");
}

#[test]
fn what_makes_no_sense_is_refused() {
    let target = folder("refused");
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    let mut recorder = VdbRecorder::default();
    assert_eq!(recorder.status().phase, VdbRecordPhase::Idle);
    let still = VdbRecordSettings { frame_rate: 0, ..settings.clone() };
    assert!(matches!(recorder.start(still), Err(VdbRecordError::NoFrameRate)));
    recorder.start(settings.clone()).unwrap();
    assert!(matches!(recorder.start(settings.clone()), Err(VdbRecordError::AlreadyRecording)));
    let session: Arc<Session> = recorder.session.clone().unwrap();
    let status = end(&session);
    assert!(matches!(status.error, Some(VdbRecordError::NoFrames)), "{status:?}");
    recorder.start(settings).unwrap();
}

mod existing;
#[cfg(unix)]
mod stalls;

#[test]
fn frames_that_do_not_come_are_told() {
    let target = folder("lost");
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    let session = start(settings).unwrap();
    send(&session, frame(0));
    assert!(session.claim() && session.claim());
    session.close();
    session.join();
    let status = session.status();
    assert!(matches!(status.error, Some(VdbRecordError::Lost { frames: 2 })), "{status:?}");
    assert_eq!((status.captured, status.written), (3, 1));
}
