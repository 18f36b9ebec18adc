//! Encoders that hang.

use std::os::unix::fs::PermissionsExt;

use super::*;

/// The stall timeout of these tests, and the longest time until a stall is detected on a busy
/// machine.
const LIMIT: Duration = Duration::from_millis(400);
const SEEN: Duration = Duration::from_secs(10);

/// Settings for a video in an empty folder, encoded by a shell script; `$target` is the file to
/// write.
fn script(name: &str, lines: &str) -> VdbRecordSettings {
    let folder = folder(name);
    let (text, program) = (folder.join("encoder.sh"), folder.join("encoder"));
    let begin = "for target; do :; done; target=${target#file:}";
    fs::write(&text, format!("#!/bin/sh\n{begin}\n{lines}\n")).unwrap();
    fs::set_permissions(&text, fs::Permissions::from_mode(0o755)).unwrap();
    // Copied by another process: a file written by this one may still be open in a child that is
    // just starting, and then cannot be executed.
    assert!(Command::new("cp").args([&text, &program]).status().unwrap().success());
    VdbRecordSettings {
        ffmpeg: program,
        stall_timeout: LIMIT,
        ..VdbRecordSettings::new(folder.join("film.mp4"), VdbRecordFormat::Mp4)
    }
}

/// Sends more frames than a pipe and a queue hold.
fn send_many(session: &Session) {
    for slot in 0..100 {
        if session.claim() {
            session.deliver(noise(slot), true).ok();
        }
    }
}

fn assert_stalled(status: &VdbRecordStatus, settings: &VdbRecordSettings) {
    let error = status.error.as_ref().unwrap();
    assert!(matches!(error, VdbRecordError::Stalled { after } if *after == LIMIT), "{error}");
    let part = settings.target.with_extension("part.mp4");
    assert_eq!(status.unfinished.as_ref(), Some(&part));
    // The output so far is kept, under the name of an unfinished video.
    assert_eq!(fs::read(part).unwrap(), b"begun");
    assert!(!settings.target.exists());
}

/// Including a program with a child, which keeps the pipe open after the program is killed.
#[test]
fn a_program_that_stops_reading_is_given_up() {
    for (name, line) in [("hangs", "exec sleep 60"), ("child_hangs", "sleep 60")] {
        let settings = script(name, &format!("printf begun > $target; {line}"));
        let begin = Instant::now();
        let session = start(settings.clone()).unwrap();
        send_many(&session);
        assert!(begin.elapsed() >= LIMIT, "{name}: it was not waited for");
        let status = end(&session);
        assert!(begin.elapsed() < SEEN, "{name}: {:?}", begin.elapsed());
        assert_stalled(&status, &settings);
        assert!(!session.claim());
    }
}

/// The app exits while the queue is full and never drained.
#[test]
fn a_program_that_hangs_does_not_hold_up_the_end_of_the_app() {
    let settings = script("exit", "printf begun > $target; sleep 60");
    let session = start(settings.clone()).unwrap();
    for slot in 0..40 {
        if session.claim() && session.deliver(noise(slot), false).is_err() {
            break;
        }
    }
    let begin = Instant::now();
    session.close();
    session.join();
    assert!(begin.elapsed() < SEEN, "{:?}", begin.elapsed());
    assert_stalled(&session.status(), &settings);
}

#[test]
fn a_program_that_does_not_end_is_given_up() {
    let settings = script("endless", "printf begun > $target; cat > /dev/null; sleep 60");
    let begin = Instant::now();
    let session = start(settings.clone()).unwrap();
    send_many(&session);
    let status = end(&session);
    assert!(begin.elapsed() < SEEN, "{:?}", begin.elapsed());
    assert_eq!((status.captured, status.written), (100, 100));
    assert_stalled(&status, &settings);
}

/// A growing file counts as progress, and so does reading from the pipe.
#[test]
fn a_slow_program_is_not_given_up() {
    let settings = script(
        "slow",
        "for i in 1 2 3 4 5; do sleep 0.2; dd bs=6144 count=1 > /dev/null; done
         cat > /dev/null
         for i in 1 2 3 4 5; do sleep 0.2; printf $i >> $target; done",
    );
    let settings = VdbRecordSettings { stall_timeout: 2 * LIMIT, ..settings };
    let begin = Instant::now();
    let session = start(settings.clone()).unwrap();
    send_many(&session);
    let status = end(&session);
    assert!(begin.elapsed() > Duration::from_secs(2), "{:?}", begin.elapsed());
    assert!(status.error.is_none() && status.unfinished.is_none(), "{status:?}");
    assert_eq!(fs::read(&settings.target).unwrap(), b"12345");
    assert_eq!(fs::read_dir(settings.target.parent().unwrap()).unwrap().count(), 3);
}

/// A disk hangs, and recovers after the recording has ended.
#[test]
fn an_encoder_that_comes_back_too_late_writes_nothing() {
    let target = folder("late");
    let settings = VdbRecordSettings {
        stall_timeout: LIMIT,
        ..VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)
    };
    let (go_on, gate) = mpsc::channel();
    let (over, is_over) = mpsc::channel();
    let session = Session::start(settings, move |session, frames| {
        gate.recv().ok();
        let result = encode(session, frames);
        over.send(result.is_err()).ok();
        result
    })
    .unwrap();
    send(&session, frame(0));
    let status = end(&session);
    assert!(matches!(status.error, Some(VdbRecordError::Stalled { .. })), "{status:?}");
    go_on.send(()).unwrap();
    assert!(is_over.recv().unwrap());
    assert_eq!(fs::read_dir(&target).unwrap().count(), 0);
    let status = session.status();
    assert!(matches!(status.error, Some(VdbRecordError::Stalled { .. })), "{status:?}");
    assert_eq!(status.written, 0);
}
