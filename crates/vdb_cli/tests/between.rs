//! The command `vdb between`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::{DVec3, IVec3};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, MetaValue, Metadata, VdbFile, WriteOptions};

fn vdb(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// A new folder of this test.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vdb-between-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn path(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

/// The names of all files in a folder.
fn names(folder: &str) -> Vec<String> {
    let name = |entry: std::io::Result<std::fs::DirEntry>| {
        entry.unwrap().file_name().into_string().unwrap()
    };
    let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().map(name).collect();
    names.sort();
    names
}

/// A ball of smoke, 6 voxels in radius, that moves by 5 voxels along x for each number, with its
/// velocity per second at 25 frames per second, and a surface that cannot be made.
fn ball(number: f64) -> VdbFile {
    let middle = DVec3::X * 5.0 * number;
    let (mut density, mut velocity) = (Vdb543::new(0.0_f32), Vdb543::new([0.0_f32; 3]));
    for k in 0..16 * 16 * 16 {
        let ijk = IVec3::new(k >> 8, k >> 4 & 15, k & 15) - 8 + middle.round().as_ivec3();
        let r = (ijk.as_dvec3() - middle).length() / 6.0;
        if r < 1.0 {
            density.set(ijk, (1.0 - r * r).powi(2) as f32);
        }
        velocity.set(ijk, [125.0, 0.0, 0.0]);
    }
    let mut density = Grid::new("density", AnyTree::Float(density.into()));
    density.class = GridClass::FogVolume;
    let mut surface = density.clone();
    (surface.name, surface.unique_name) = ("surface".into(), "surface".into());
    surface.class = GridClass::LevelSet;
    let velocity = Grid::new("vel", AnyTree::Vec3s(velocity.into()));
    let mut file = VdbFile::new(vec![density, surface, velocity]);
    file.metadata.insert("title", MetaValue::String(format!("frame {number}")));
    file
}

/// Writes frames, and gives their paths.
fn write(folder: &Path, numbers: impl IntoIterator<Item = u32>) -> Vec<String> {
    let one = |number| {
        let path = path(folder, &format!("smoke_{number:04}.vdb"));
        ball(f64::from(number)).save(&path, &WriteOptions::default()).unwrap();
        path
    };
    numbers.into_iter().map(one).collect()
}

fn all<'a>(before: &[&'a str], frames: &'a [String], after: &[&'a str]) -> Vec<&'a str> {
    let frames = frames.iter().map(String::as_str);
    before.iter().copied().chain(frames).chain(after.iter().copied()).collect()
}

/// The middle of a file's smoke along x.
fn middle(path: &str) -> f64 {
    let file = VdbFile::open(path).unwrap();
    let AnyTree::Float(tree) = &file.grid("density").unwrap().tree else { panic!("{path}") };
    let (mut sum, mut mass) = (0.0, 0.0);
    for voxel in tree.active_values() {
        sum += f64::from(voxel.value) * f64::from(voxel.origin.x);
        mass += f64::from(voxel.value);
    }
    sum / mass
}

#[test]
fn a_sequence_is_written_with_its_frames_in_between() {
    let folder = folder("sequence");
    // In any order, and with a number left out.
    let frames = write(&folder, [4, 1, 2]);
    let out = path(&folder, "new/slow");
    let output = vdb(&all(&["between"], &frames, &["--out", &out, "--steps", "2"]));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(text(&output.stdout), "3 of 3 frames written, and 7 in between\n");
    let expected: Vec<_> = (3..=12).map(|n| format!("smoke_{n:04}.vdb")).collect();
    assert_eq!(names(&out), expected, "and nothing temporary");
    // What is left out is said once.
    let said = text(&output.stderr);
    for name in ["surface", "vel"] {
        let left_out = format!("grid \"{name}\" is left out");
        assert_eq!(said.matches(&left_out).count(), 1, "{said}");
    }
    for number in 3..=12_u32 {
        let path = path(Path::new(&out), &format!("smoke_{number:04}.vdb"));
        let (found, expected) = (middle(&path), 5.0 * f64::from(number) / 3.0);
        assert!((found - expected).abs() < 0.1, "{number}: {found} instead of {expected}");
    }
    // The metadata are those of the nearer frame.
    let title = |number: u32| {
        let path = path(Path::new(&out), &format!("smoke_{number:04}.vdb"));
        VdbFile::open(path).unwrap().metadata.get_str("title").unwrap().to_owned()
    };
    assert_eq!(
        [title(4), title(5), title(8), title(10)],
        ["frame 1", "frame 2", "frame 2", "frame 4"]
    );
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_damaged_frame_is_told_of_and_filled_from_its_neighbours() {
    let folder = folder("damaged");
    let frames = write(&folder, 1..=3);
    std::fs::write(&frames[1], b"no volume").unwrap();
    let out = path(&folder, "out");
    let output = vdb(&all(&["between"], &frames, &["--out", &out]));
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let said = text(&output.stderr);
    assert!(said.lines().any(|line| line.starts_with(&frames[1])), "{said}");
    assert_eq!(text(&output.stdout), "2 of 3 frames written, and 3 in between\n");
    assert_eq!(names(&out).len(), 5);
    let filled = middle(&path(Path::new(&out), "smoke_0004.vdb"));
    assert!((filled - 10.0).abs() < 0.1, "{filled}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_check_prints_the_errors_of_every_second_frame() {
    let folder = folder("check");
    let frames = write(&folder, 1..=5);
    for (method, most) in [("register", 0.5), ("advect", 0.2), ("fade", 1.0)] {
        let output = vdb(&all(&["between", "--check", "--method", method], &frames, &[]));
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let shown = text(&output.stdout);
        assert!(shown.starts_with("density\n\n| frame | L1: fade | made | ratio |"), "{shown}");
        let ratio = |frame: &str| -> f64 {
            let line = shown.lines().find(|line| line.starts_with(&format!("| {frame} |")));
            line.unwrap().split(" | ").nth(3).unwrap().parse().unwrap()
        };
        for frame in ["2", "4", "all"] {
            assert!(ratio(frame) <= most, "{method}: {shown}");
            assert!((ratio(frame) == 1.0) == (method == "fade"), "{method}: {shown}");
        }
        assert!(!shown.contains("\n| 3 |"), "{shown}");
        // Seconds per frame, as it was found.
        let scale = shown.lines().find_map(|line| line.strip_prefix("velocity scale: "));
        match scale.map(|line| line.split(' ').next().unwrap().parse::<f64>().unwrap()) {
            Some(scale) => assert!((scale * 25.0 - 1.0).abs() < 0.05, "{scale}"),
            None => assert_eq!(method, "fade"),
        }
    }
    // Two frames are not made: the damaged one is a neighbour of one, and the other cannot be read.
    for (damaged, left) in [(1, "| 4 |"), (2, "all")] {
        let frames = write(&folder, 1..=5);
        std::fs::write(&frames[damaged], b"no volume").unwrap();
        let output = vdb(&all(&["between", "--check", "--method", "fade"], &frames, &[]));
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        assert!(text(&output.stderr).lines().any(|line| line.starts_with(&frames[damaged])));
        assert_eq!(text(&output.stdout).contains(left), damaged == 1, "{output:?}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_grid_that_one_frame_lacks_is_empty_there() {
    let folder = folder("lacks");
    let frames = write(&folder, 1..=2);
    // Blender writes no flame before there is one.
    let mut second = ball(2.0);
    let mut flame = second.grids[0].clone();
    (flame.name, flame.unique_name) = ("flame".into(), "flame".into());
    flame.metadata = Metadata::default();
    second.grids.push(flame);
    second.save(&frames[1], &WriteOptions::default()).unwrap();
    let out = path(&folder, "out");
    let output = vdb(&all(&["between"], &frames, &["--out", &out]));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let made = VdbFile::open(path(Path::new(&out), "smoke_0003.vdb")).unwrap();
    let AnyTree::Float(flame) = &made.grid("flame").unwrap().tree else { panic!("not floats") };
    // Half of the way from nothing to a maximum of 1, and half of the way to where that is.
    for x in [7, 8] {
        let value = flame.get(IVec3::new(x, 0, 0));
        assert!((value - 0.5).abs() < 0.02, "{x}: {value}");
    }

    // What is asked for is made, and nothing else.
    let output = vdb(&all(&["between", "--grids", "flame"], &frames, &["--out", &out]));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let made = VdbFile::open(path(Path::new(&out), "smoke_0003.vdb")).unwrap();
    assert_eq!(made.grids.iter().map(|grid| &*grid.name).collect::<Vec<_>>(), ["flame"]);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn wrong_input_gives_one_message() {
    let folder = folder("wrong");
    let frames = write(&folder, 1..=2);
    let [one, two] = [&*frames[0], &*frames[1]];
    let out = path(&folder, "out");
    let copy = |name: &str| {
        let path = path(&folder, name);
        std::fs::copy(one, &path).unwrap();
        path
    };
    let [none, other, same, far, huge] = [
        copy("smoke.vdb"),
        copy("fire_0002.vdb"),
        copy("smoke_01.vdb"),
        copy("smoke_200000.vdb"),
        copy("smoke_99999999999999999999.vdb"),
    ];
    let here = folder.to_str().unwrap();
    let to = |frames: &[&str], more: &[&str]| {
        [&["between", "--out", &out], frames, more]
            .concat()
            .iter()
            .map(|s| (*s).to_owned())
            .collect()
    };
    let cases: [(Vec<String>, i32, String); 11] = [
        (to(&[one], &[]), 1, "nothing is in between of one frame; name two or more".into()),
        (
            to(&[one, &none], &[]),
            1,
            format!(
                "{none}: no number in the name, by which frames are put in order; rename it like `smoke_0001.vdb`"
            ),
        ),
        (to(&[one, &huge], &[]), 1, format!("{huge}: the number in the name is too large")),
        (
            to(&[one, &other], &[]),
            1,
            format!("{one} and {other} are not of one sequence: their names differ"),
        ),
        (to(&[one, &same], &[]), 1, format!("{one} and {same} are both frame 1; name one")),
        (
            to(&[one, &far], &[]),
            1,
            format!(
                "{one} to {far} with all frames in between would be 399999 frames, and a sequence has at most 100000; name fewer frames"
            ),
        ),
        (
            to(&[one, two], &["--out", here]),
            2,
            "error: the argument '--out <DIR>' cannot be used multiple times".into(),
        ),
        (
            to(&[one, two], &["--velocity", "wind"]),
            1,
            format!("{one}: the file has no grid \"wind\""),
        ),
        (
            to(&[one, two], &["--velocity", "density"]),
            1,
            format!(
                "{one}, grid \"density\": values of type float, which are no velocities; name a grid of vectors"
            ),
        ),
        (to(&[one, two], &["--grids", "fog"]), 1, format!("{one}: the file has no grid \"fog\"")),
        (
            to(&[one, two], &["--grids", "surface"]),
            1,
            format!(
                "{one}, grid \"surface\": a level set, of which no frames in between are made: its values would no longer be distances; use densities"
            ),
        ),
    ];
    for (arguments, code, expected) in cases {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let output = vdb(&arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {output:?}");
        let said = text(&output.stderr);
        assert_eq!(said.lines().filter(|line| *line == expected).count(), 1, "{expected}\n{said}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn frames_are_neither_replaced_nor_made_by_wrong_options() {
    let folder = folder("options");
    let frames = write(&folder, 1..=2);
    let [one, two] = [&*frames[0], &*frames[1]];
    let out = path(&folder, "out");
    let here = folder.to_str().unwrap();
    let replaced = vdb(&["between", one, two, "--out", here]);
    assert_eq!(replaced.status.code(), Some(1), "{replaced:?}");
    assert_eq!(
        text(&replaced.stderr),
        format!(
            "{here}: the frames themselves are in this folder, and would be replaced; choose another\n"
        )
    );
    let few = vdb(&["between", "--check", one, two]);
    assert_eq!(few.status.code(), Some(1), "{few:?}");
    assert_eq!(text(&few.stderr), "too few frames to leave one out; name three or more\n");
    for wrong in [
        &["--steps", "0"][..],
        &["--velocity-scale", "NaN"],
        &["--method", "morph"],
        &["--check"],
        &["--extinction", "1"],
    ] {
        let output = vdb(&[&["between", one, two, "--out", &out], wrong].concat());
        assert_eq!(output.status.code(), Some(2), "{wrong:?}: {output:?}");
    }
    for wrong in ["-1", "NaN"] {
        let output = vdb(&["between", one, two, "--check", "--extinction", wrong]);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}
