//! Sequences in the viewer: folders, patterns and `.vdbseq` files, on the command line and dropped on the window.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use bevy::prelude::*;
use bevy::time::TimeUpdateStrategy;
use bevy_egui::egui::accesskit::Role;
use bevy_vdb::prelude::*;

use crate::args::Args;
use crate::files::temporary;
use crate::sequence_files::save;
use crate::viewer::{drawn, picture, refused};
use crate::viewer_app::Viewer;

/// A folder with frames, each with more smoke than the one before.
fn folder(name: &str, frames: std::ops::RangeInclusive<u64>) -> PathBuf {
    let folder = temporary("viewer_sequences", name);
    save(&folder, frames);
    folder
}

/// The smoke in a picture by the CPU, with the same camera for all frames, in pixels.
fn smoke(out: &str, change: impl FnOnce(&mut Command)) -> usize {
    let (pixels, _) = picture(out, |command| change(command.arg("--cpu")));
    drawn(&pixels)
}

#[test]
fn a_frame_of_a_folder_is_a_picture() {
    let folder = folder("pictures", 1..=6);
    let of = |frame: &str| {
        smoke(&format!("{frame}.png"), |c| _ = c.arg(&folder).args(["--frame", frame]))
    };
    let sizes = ["1", "3", "6"].map(of);
    // The radii are 3, 5 and 8 voxels.
    let ratio = |a: usize, b: usize| b as f64 / a as f64;
    assert!(sizes[0] > 100, "{sizes:?}");
    assert!(ratio(sizes[0], sizes[1]) > 1.8 && ratio(sizes[1], sizes[2]) > 1.8, "{sizes:?}");
    let first = smoke("first.png", |c| _ = c.arg(&folder));
    assert_eq!(first, sizes[0]);
    // A pattern, and a file that describes the sequence.
    let by_pattern = |c: &mut Command| _ = c.arg(folder.join("smoke_####.vdb"));
    let pattern = smoke("pattern.png", |c| _ = (by_pattern(c), c.args(["--frame", "3"])));
    assert_eq!(pattern, sizes[1]);
    let described = folder.join("some.vdbseq");
    std::fs::write(&described, "(frames: \"smoke_####.vdb\", first: 3, last: 6)").expect("written");
    let described = smoke("described.png", |c| _ = c.arg(&described).args(["--frame", "6"]));
    // The camera is closer: there is no frame 1. But frame 6 is the larger end of both.
    assert_eq!(described, sizes[2]);
}

#[test]
fn the_gpu_shows_the_frame_that_is_asked_for() {
    let folder = folder("gpu", 1..=4);
    let of = |frame: &str| {
        let out = format!("gpu-{frame}.png");
        picture(&out, |c| _ = c.arg(&folder).args(["--frame", frame, "--scatter-once"])).0
    };
    let [small, large] = ["1", "4"].map(|frame| drawn(&of(frame)));
    // Radii of 3 and 6 voxels.
    assert!(small > 100 && large as f64 > 2.5 * small as f64, "{small} {large}");
}

#[test]
fn a_sequence_that_cannot_be_shown_is_one_clear_error() {
    let missing = temporary("viewer_sequences", "missing");
    let said = refused(|c| _ = c.arg(&missing));
    assert!(said.contains("missing: no such file or folder"), "{said}");

    let empty = temporary("viewer_sequences", "empty");
    std::fs::create_dir_all(&empty).expect("a folder");
    let said = refused(|c| _ = c.arg(&empty));
    assert!(said.contains("empty' has no frame") && said.contains(".vdb"), "{said}");
    assert_eq!(said.matches("empty").count(), 1, "{said}");

    let said = refused(|c| _ = c.arg(missing.join("smoke_####.vdb")));
    assert!(said.contains("missing' of the sequence cannot be listed"), "{said}");

    let folder = folder("refused", 2..=4);
    let said = refused(|c| _ = c.arg(folder.join("fire_####.vdb")));
    assert!(said.contains("has no frame of the sequence 'fire_####.vdb'"), "{said}");
    let said = refused(|c| _ = c.arg(&folder).args(["--frame", "1"]));
    assert!(said.contains("--frame 1: the frames are 2 to 4"), "{said}");
    let said = refused(|c| _ = c.arg(&folder).args(["--frame", "one"]));
    assert!(said.contains("--frame one: it is the number of a frame"), "{said}");
    let said = refused(|c| _ = c.arg(&folder).args(["--grid", "lava"]));
    assert!(said.contains("lava"), "{said}");
    let said = refused(|c| _ = c.arg(&folder).args(["--surface", "density=0.5"]));
    assert!(said.contains("--surface and --fog are for single files"), "{said}");

    let described = folder.join("broken.vdbseq");
    std::fs::write(&described, "(frames: 7)").expect("written");
    let said = refused(|c| _ = c.arg(&described));
    assert!(said.contains("broken.vdbseq: line 1"), "{said}");

    std::fs::write(folder.join("smoke_0003.vdb"), "not a volume").expect("written");
    let said = refused(|c| _ = c.arg(&folder).args(["--frame", "3"]));
    assert!(said.contains("frame 3: ") && said.contains("not a VDB file"), "{said}");
    // The others are not affected.
    assert!(smoke("unbroken.png", |c| _ = c.arg(&folder)) > 100);
}

impl Viewer {
    fn status(&mut self) -> VdbPlayerStatus {
        let world = self.app.world_mut();
        world.query::<&VdbPlayerStatus>().single(world).expect("one player").clone()
    }

    fn player(&mut self) -> VdbPlayer {
        let world = self.app.world_mut();
        world.query::<&VdbPlayer>().single(world).expect("one player").clone()
    }

    fn until(&mut self, holds: impl Fn(&VdbPlayerStatus) -> bool) {
        for _ in 0..4_000 {
            self.frames(1);
            let status = self.status();
            if holds(&status) {
                return self.frames(3);
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        panic!("it did not come: {:?}", self.status());
    }

    /// A window whose time stands still.
    fn still(files: Vec<PathBuf>) -> Self {
        let mut viewer = Self::new(&Args { files, ..default() });
        viewer.stop();
        viewer.wait();
        viewer
    }

    fn stop(&mut self) {
        self.app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::ZERO));
    }

    fn has_timeline(&self) -> bool {
        let is_bar = |node: &bevy_egui::egui::accesskit::Node| {
            node.role() == Role::Slider && node.label() == Some("frame")
        };
        self.nodes().iter().any(|(_, node)| is_bar(node))
    }
}

#[test]
fn a_dropped_folder_is_played() {
    let mut viewer = Viewer::still(vec![crate::files::model("teapot.vdb")]);
    assert!(!viewer.has_timeline());
    let folder = folder("dropped", 1..=6);
    viewer.drop_file(&folder);
    viewer.wait();
    viewer.until(|status| status.loaded().len() == 6);
    assert_eq!(viewer.labels(), ["density"]);
    assert!(viewer.title().starts_with("dropped: density, lit"), "{}", viewer.title());
    assert!(viewer.has_timeline() && viewer.says("of 1–6") && viewer.says("6 of 6 in memory"));
    // It plays, and goes round.
    let step = Duration::from_secs(1) / 24;
    viewer.app.insert_resource(TimeUpdateStrategy::ManualDuration(step));
    let frames: Vec<_> = (0..7)
        .map(|_| {
            viewer.frames(1);
            viewer.status().frame().expect("a frame")
        })
        .collect();
    assert!(frames.windows(2).all(|two| two[1] == two[0] % 6 + 1), "{frames:?}");
    // The whole sequence is in view: the last frame is the largest.
    let view = viewer.app.world().resource::<crate::app::Status>().view.expect("a view");
    assert!(view.bounds.1.y > 7.0, "{view:?}");
    // A file takes its place.
    viewer.stop();
    viewer.drop_file(&crate::files::model("teapot.vdb"));
    viewer.wait();
    assert_eq!(viewer.labels(), ["surface"]);
    assert!(!viewer.has_timeline());
}

#[test]
fn keys_control_a_sequence() {
    let folder = folder("keys", 1..=6);
    let mut viewer = Viewer::still(vec![folder.clone()]);
    viewer.until(|status| status.loaded().len() == 6);
    let plain = Args { files: vec![folder], ..default() };
    assert_eq!(viewer.args(), plain);
    viewer.press(KeyCode::Space);
    assert!(viewer.player().is_paused());
    viewer.press(KeyCode::Space);
    assert!(!viewer.player().is_paused());
    for (key, frame) in [
        (KeyCode::Period, 2),
        (KeyCode::Period, 3),
        (KeyCode::Comma, 2),
        (KeyCode::PageDown, 6),
        (KeyCode::Period, 6),
        (KeyCode::PageUp, 1),
        (KeyCode::Comma, 1),
        (KeyCode::Period, 2),
    ] {
        viewer.press(key);
        assert_eq!(viewer.status().frame(), Some(frame), "{key:?}");
    }
    assert!(viewer.player().is_paused());
    viewer.press(KeyCode::F1);
    assert!(viewer.says("play, pause") && viewer.says("one frame back, forwards"));
    // The command line comes back to the frame.
    let args = viewer.args();
    assert_eq!(args, Args { frame: Some(2), ..plain });
    let mut again = Viewer::ready(&args);
    again.until(|status| status.frame().is_some());
    assert_eq!((again.status().frame(), again.player().is_paused()), (Some(2), true));
    assert_eq!(again.args(), args);
}

#[test]
fn what_is_wrong_with_a_sequence_stands_in_the_window() {
    let empty = temporary("viewer_sequences", "dropped_empty");
    std::fs::create_dir_all(&empty).expect("a folder");
    let mut viewer = Viewer::still(vec![empty]);
    assert!(viewer.says("dropped_empty' has no frame of the sequence"));
    viewer.drop_file(Path::new("/nowhere/missing_folder"));
    viewer.wait();
    assert!(viewer.says("missing_folder: no such file or folder"));
    // One broken frame: the others are played, and the window says which it is, once.
    let folder = folder("dropped_broken", 1..=5);
    for number in [1, 3] {
        let path = folder.join(format!("smoke_{number:04}.vdb"));
        std::fs::write(path, "not a volume").expect("written");
    }
    viewer.drop_file(&folder);
    viewer.wait();
    viewer.until(|status| status.loaded() == [2, 4, 5] && status.failed() == [1, 3]);
    assert!(viewer.says("frame 1 cannot be shown: ") && !viewer.says("frame 3 cannot"));
    assert!(viewer.says("2 failed") && viewer.says("3 of 5 in memory"));
    viewer.press(KeyCode::PageDown);
    assert_eq!(viewer.status().frame(), Some(5));
    viewer.click("Close");
    assert!(!viewer.says("frame 1 cannot"));
}
