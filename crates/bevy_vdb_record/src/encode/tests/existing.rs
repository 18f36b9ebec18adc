//! Recordings whose targets exist.

use super::*;

/// The names and contents of the files in a folder, sorted.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| {
            let entry = entry.unwrap();
            let bytes = fs::read(entry.path()).unwrap_or_default();
            (entry.file_name().into_string().unwrap(), bytes)
        })
        .collect();
    files.sort();
    files
}

/// Records two frames.
fn record(settings: VdbRecordSettings) -> VdbRecordStatus {
    let session = start(settings).unwrap();
    for slot in 0..2 {
        if session.claim() {
            session.deliver(frame(slot), true).ok();
        }
    }
    end(&session)
}

#[test]
fn a_recording_is_not_overwritten_unasked() {
    let folder = folder("existing");
    // Files beyond the end of the new sequence count, too: they would be taken for a part of it.
    for (format, target, there) in [
        (VdbRecordFormat::PngSequence, "", "00000000.png"),
        (VdbRecordFormat::PngSequence, "", "00000070.png"),
        (VdbRecordFormat::PngSequence, "", "100000000.png"),
        (VdbRecordFormat::Mp4, "a.mp4", "a.mp4"),
        (VdbRecordFormat::Mp4, "a.mp4", "a.part.mp4"),
        (VdbRecordFormat::WebM, "a", "a.part"),
    ] {
        let there = folder.join(there);
        fs::write(&there, "mine").unwrap();
        let before = contents(&folder);
        let status = record(VdbRecordSettings::new(folder.join(target), format));
        let error = status.error.unwrap();
        assert!(matches!(&error, VdbRecordError::Exists { path } if *path == there), "{error}");
        let said = error.to_string();
        assert!(said.contains("overwrite") && said.contains(there.to_str().unwrap()), "{said}");
        assert_eq!((status.written, &status.unfinished), (0, &None));
        assert_eq!(contents(&folder), before);
        fs::remove_file(there).unwrap();
    }
}

/// Files with other names do not belong to a sequence.
#[test]
fn what_is_no_picture_of_a_sequence_stands_in_nobodys_way() {
    let target = folder("others");
    let others =
        ["a.png", "1.png", "0000000x.png", "00000001.PNG", "000000001.png", "-0000001.png"];
    others.iter().for_each(|name| fs::write(target.join(name), "mine").unwrap());
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    for overwrite in [false, true] {
        let status = record(VdbRecordSettings { overwrite, ..settings.clone() });
        assert!(status.error.is_none(), "{status:?}");
        assert_eq!(fs::read_dir(&target).unwrap().count(), others.len() + 2);
    }
    assert!(others.iter().all(|name| fs::read(target.join(name)).unwrap() == b"mine"));
}

#[test]
fn a_sequence_that_is_overwritten_ends_where_the_new_one_does() {
    let target = folder("overwritten");
    for number in [0, 1, 2, 3, 100_000_000] {
        fs::write(target.join(picture(number)), "old").unwrap();
    }
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    let status = record(VdbRecordSettings { overwrite: true, ..settings });
    assert!(status.error.is_none(), "{status:?}");
    let names: Vec<String> = contents(&target).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["00000000.png", "00000001.png"]);
    (0..2).for_each(|number| drop(read_png(&target.join(picture(number)))));
}

/// Two simultaneous recordings to one folder: the first one gets it, and is not damaged.
#[test]
fn two_recordings_do_not_share_a_target() {
    let target = folder("shared");
    let settings = VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence);
    let sessions = [0, 1].map(|_| start(settings.clone()).unwrap());
    send(&sessions[0], frame(0));
    while sessions[0].status().written == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    // The second recording may have failed already, and then takes no frame.
    if sessions[1].claim() {
        sessions[1].deliver(frame(1), true).ok();
    }
    let [first, second] = sessions.map(|session| end(&session));
    assert!(first.error.is_none(), "{first:?}");
    assert!(matches!(second.error, Some(VdbRecordError::Exists { .. })), "{second:?}");
    let (_, pixels) = read_png(&target.join(picture(0)));
    assert_eq!(pixels[..3], color(0)[..3]);
    assert_eq!(contents(&target).len(), 1);
}
