//! Videos, by encoders that work, that are slow, and that hang.

use super::*;

/// What ffprobe says of the video stream, and the duration of the file in seconds.
fn probe(path: &Path, entry: &str) -> Vec<f64> {
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-count_frames", "-select_streams", "v:0", "-show_entries", entry])
        .args(["-of", "csv=p=0"])
        .arg(path)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    said.trim().split(',').map(|number| number.parse().unwrap()).collect()
}

/// Whether videos can be made and looked at; says aloud where a test is left out.
fn has_ffmpeg() -> bool {
    let found = ["ffmpeg", "ffprobe"]
        .iter()
        .all(|program| Command::new(program).arg("-version").output().is_ok());
    if !found {
        eprintln!("SKIPPED: ffmpeg and ffprobe are not on the PATH (Debian: apt install ffmpeg)");
    }
    found
}

/// Two cameras at once into two formats, one of them the half of an 8-bit image, with MSAA, that nobody
/// may copy from.
#[gpu_test]
fn videos_have_the_size_the_length_and_the_picture() {
    if !has_ffmpeg() {
        return;
    }
    let mut stage = stage();
    let (whole, _) = camera(&mut stage);
    let image = Image::new_target_texture(128, 64, TextureFormat::Rgba8UnormSrgb, None);
    let image = stage.world().resource_mut::<Assets<Image>>().add(image);
    let viewport = Viewport {
        physical_position: UVec2::new(60, 0),
        physical_size: UVec2::new(63, 64),
        ..default()
    };
    let half = stage
        .world()
        .spawn((
            Camera3d::default(),
            Camera { viewport: Some(viewport), ..default() },
            RenderTarget::Image(image.into()),
            Msaa::Sample4,
            Tonemapping::None,
            bevy::camera::Exposure { ev100: -(1.2_f32.log2()) },
            orthographic(),
            Transform::from_xyz(0.0, 0.0, 10.0),
            VdbRecorder::default(),
        ))
        .id();
    stage.update(4);
    put_back(&mut stage);
    let folder = folder("record_videos");
    let (mp4, webm) = (folder.join("half.mp4"), folder.join("whole.webm"));
    for (camera, target, format) in
        [(half, &mp4, VdbRecordFormat::Mp4), (whole, &webm, VdbRecordFormat::WebM)]
    {
        let max_frames = Some(20);
        let settings = VdbRecordSettings::new(target, format);
        start(&mut stage, camera, VdbRecordSettings { frame_rate: 10, max_frames, ..settings });
    }
    for camera in [half, whole] {
        let ended = wait_for_end(&mut stage, camera);
        assert!(ended.status.error.is_none(), "{ended:?}");
        assert_eq!(ended.status.written, 20);
    }
    // H.264 has no odd width.
    for (path, width) in [(&mp4, 62.0), (&webm, 64.0)] {
        assert_eq!(probe(path, "stream=width,height,nb_read_frames"), [width, 64.0, 20.0]);
        assert_eq!(probe(path, "format=duration"), [2.0]);
    }
    // The tenth picture of the half: a sphere in its middle, not where it would be in the image.
    let output = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(&mp4)
        .args(["-vf", "select=eq(n\\,10)", "-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .arg("-")
        .output()
        .unwrap();
    assert_eq!(output.stdout.len(), 62 * 64 * 3, "{}", String::from_utf8_lossy(&output.stderr));
    let at = |x: usize, y: usize| &output.stdout[(y * 62 + x) * 3..][..3];
    assert!(at(31, 32)[1] > 230 && at(31, 32)[0] < 20, "{:?}", at(31, 32));
    assert!(at(2, 2)[1] < 20 && at(60, 60)[1] < 20);
}

/// A program in place of `ffmpeg`, in the folder of what is recorded: a script, in which `$target` is the
/// file that it is to write.
#[cfg(unix)]
fn program(folder: &Path, lines: &str) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let (text, program) = (folder.join("encoder.sh"), folder.join("encoder"));
    let begin = "for target; do :; done; target=${target#file:}";
    std::fs::write(&text, format!("#!/bin/sh\n{begin}\n{lines}\n")).unwrap();
    std::fs::set_permissions(&text, std::fs::Permissions::from_mode(0o755)).unwrap();
    // By another process: a file that this one has written may be open in one that it is just starting,
    // and then cannot be run.
    assert!(Command::new("cp").args([&text, &program]).status().unwrap().success());
    program
}

/// An encoder that stands still until there is a file of some name.
#[cfg(unix)]
#[gpu_test]
fn a_slow_encoder_costs_frames_or_time() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    for when_full in [VdbRecordWhenFull::Drop, VdbRecordWhenFull::Wait] {
        let folder = folder("record_slow");
        let (go_on, target) = (folder.join("go_on"), folder.join("film.mp4"));
        let wait = format!("while [ ! -e {} ]; do sleep 0.01; done", go_on.display());
        let settings = VdbRecordSettings {
            frame_rate: 1000,
            when_full,
            queue: 2,
            max_frames: Some(40),
            ffmpeg: program(&folder, &format!("{wait}; cat > $target")),
            ..VdbRecordSettings::new(&target, VdbRecordFormat::Mp4)
        };
        start(&mut stage, camera, settings);
        let waits = when_full == VdbRecordWhenFull::Wait;
        let other = waits.then(|| {
            let go_on = go_on.clone();
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_secs(1));
                std::fs::write(go_on, "").unwrap();
            })
        });
        let begin = Instant::now();
        stage.update(25);
        let stuck = status(&mut stage, camera);
        // What the pipe to the program holds: 64 KiB on Linux.
        let pipe = (1 << 16) / u64::from(4 * SIZE.x * SIZE.y);
        if let Some(other) = other {
            assert!(begin.elapsed() > Duration::from_millis(900), "it did not wait: {stuck:?}");
            assert_eq!(stuck.dropped, 0);
            other.join().unwrap();
        } else {
            assert!(stuck.written <= pipe, "{stuck:?}");
            // Buffers, the queue, and what the encoder has: see VdbRecordSettings::queue.
            assert!(stuck.captured <= 2 + 6 + pipe, "{stuck:?}");
            assert_eq!(stuck.captured + stuck.dropped, 25);
            std::fs::write(&go_on, "").unwrap();
        }
        let ended = wait_for_end(&mut stage, camera);
        assert!(ended.status.error.is_none(), "{ended:?}");
        println!("{when_full:?}: {:?}", ended.status);
        // Whatever was left out, the recording has its length.
        assert_eq!(ended.status.written, 40);
        let length = std::fs::metadata(&target).unwrap().len();
        assert_eq!(length, 40 * 4 * u64::from(SIZE.x * SIZE.y));
        assert_eq!(ended.status.captured == 40, waits);
        assert_eq!(ended.status.dropped == 0, waits);
    }
}

/// One that stands still for ever costs the recording, not the app, which draws on and can be left.
#[cfg(unix)]
#[gpu_test]
fn an_encoder_that_hangs_ends_the_recording_and_not_the_app() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    let folder = folder("record_hangs");
    let settings = VdbRecordSettings {
        stall_timeout: Duration::from_secs(1),
        queue: 2,
        ffmpeg: program(&folder, "printf begun > $target; exec sleep 600"),
        ..VdbRecordSettings::new(folder.join("film.mp4"), VdbRecordFormat::Mp4)
    };
    let begin = Instant::now();
    start(&mut stage, camera, settings.clone());
    let ended = wait_for_end(&mut stage, camera);
    assert!(begin.elapsed() < Duration::from_secs(30), "{:?}", begin.elapsed());
    assert!(matches!(ended.status.error, Some(VdbRecordError::Stalled { .. })), "{ended:?}");
    let unfinished = ended.status.unfinished.unwrap();
    assert_eq!(std::fs::read(&unfinished).unwrap(), b"begun");
    // The app draws on, and the recorder can be used again.
    stage.update(10);
    let target = self::folder("record_hung");
    let sequence = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    start(&mut stage, camera, VdbRecordSettings { max_frames: Some(2), ..sequence });
    assert!(wait_for_end(&mut stage, camera).status.error.is_none());
    // What was not finished is not overwritten either; asked to, it hangs again, and the app goes.
    start(&mut stage, camera, settings.clone());
    let refused = wait_for_end(&mut stage, camera).status.error;
    assert!(
        matches!(&refused, Some(VdbRecordError::Exists { path }) if *path == unfinished),
        "{refused:?}"
    );
    let drops = VdbRecordSettings { when_full: VdbRecordWhenFull::Drop, ..settings };
    start(&mut stage, camera, VdbRecordSettings { overwrite: true, ..drops });
    stage.update(20);
    let begin = Instant::now();
    drop(stage);
    assert!(begin.elapsed() < Duration::from_secs(30), "{:?}", begin.elapsed());
}
