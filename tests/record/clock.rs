//! Recording in real time.

use super::*;

#[gpu_test]
fn real_time_is_kept_by_leaving_out_and_repeating() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    let target = folder("record_real_time");
    let rate = 20;
    let settings = VdbRecordSettings {
        frame_rate: rate,
        clock: VdbRecordClock::RealTime,
        ..VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)
    };
    start(&mut stage, camera, settings);
    // Nothing for a second, then more frames than the recording has.
    let mut draw = || {
        let begin = Instant::now();
        stage.update(1);
        (begin, Instant::now())
    };
    let first = draw();
    std::thread::sleep(Duration::from_secs(1));
    let mut last = draw();
    while first.0.elapsed() < Duration::from_millis(1500) {
        std::thread::sleep(Duration::from_millis(5));
        last = draw();
    }
    // From somewhere in the first frame to somewhere in the last.
    let frames = |time: Duration| time.as_secs_f64() * f64::from(rate) + 1.0;
    let (least, most) = (frames(last.0 - first.1), frames(last.1 - first.0));
    stage.world().get::<VdbRecorder>(camera).unwrap().stop();
    let VdbRecordStatus { captured, dropped, written, error, .. } =
        wait_for_end(&mut stage, camera).status;
    println!("{captured} captured, {written} written, between {least:.1} and {most:.1}");
    assert!(error.is_none(), "{error:?}");
    assert_eq!(dropped, 0);
    // A frame is half a frame off at most, at either end.
    assert!((least - 1.0..=most + 1.0).contains(&(written as f64)), "{written} frames");
    // At least those of the second in which nothing was drawn are repeated.
    assert!(captured + 18 <= written, "{captured} captured, {written} written");
    assert_eq!(sequence(&target).len() as u64, written);
}

/// An app that was suspended: a still picture for a while, not for as long as it was.
#[gpu_test]
fn a_long_gap_in_real_time_is_cut() {
    let mut stage = stage();
    let (camera, _) = camera(&mut stage);
    let target = folder("record_gap");
    let settings = VdbRecordSettings {
        frame_rate: 100,
        clock: VdbRecordClock::RealTime,
        max_gap: Duration::from_millis(200),
        ..VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence)
    };
    start(&mut stage, camera, settings);
    let begin = Instant::now();
    stage.update(3);
    for _ in 0..2 {
        std::thread::sleep(Duration::from_secs(2));
        stage.update(3);
    }
    stage.world().get::<VdbRecorder>(camera).unwrap().stop();
    let all = begin.elapsed();
    let status = wait_for_end(&mut stage, camera).status;
    assert!(status.error.is_none(), "{status:?}");
    // Two seconds, less what is filled, twice.
    assert!(status.cut >= 2 * 180, "{status:?}");
    assert!(status.written >= 2 * 20, "{status:?}");
    // Nothing else is lost: what is written and what is cut are the time that there was.
    let frames = (all.as_secs_f64() * 100.0) as u64;
    assert!(status.written + status.cut <= frames + 2, "{status:?}, {frames} in all");
    assert_eq!(sequence(&target).len() as u64, status.written);
}
