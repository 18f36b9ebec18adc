//! The examples as people run them: each without a window, into a picture that shows what it is about.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Examples and tests are built beside each other: `target/debug/{deps/examples-…,examples/NAME}`.
fn example(name: &str) -> Command {
    let test = std::env::current_exe().expect("the path of this test");
    let folder = test.parent().and_then(Path::parent).expect("tests are in target/…/deps");
    let path = folder.join(format!("examples/{name}{}", std::env::consts::EXE_SUFFIX));
    assert!(path.exists(), "{}: run `cargo build --example {name}` first", path.display());
    let mut command = Command::new(path);
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("RUST_LOG");
    command
}

fn temporary(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("examples");
    std::fs::create_dir_all(&folder).expect("a folder for what the tests write");
    folder.join(name)
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Whether there is a GPU; says aloud where a test is left out because the environment allows that.
fn has_gpu() -> bool {
    let instance = wgpu::Instance::default();
    let found = bevy::tasks::block_on(instance.request_adapter(&Default::default())).is_ok();
    if !found {
        assert!(
            std::env::var_os("BEVY_VDB_SKIP_GPU").is_some(),
            "no GPU adapter; install Mesa's software driver (Debian: mesa-vulkan-drivers), or set \
             BEVY_VDB_SKIP_GPU=1 to leave out these tests"
        );
        eprintln!("SKIPPED, as BEVY_VDB_SKIP_GPU says: no GPU adapter");
    }
    found
}

const SIZE: (usize, usize) = (128, 72);

/// The picture of an example, row by row from the top left.
fn picture(name: &str) -> Vec<[u8; 3]> {
    let path = temporary(&format!("{name}.png"));
    // That of an earlier run proves nothing.
    let _ = std::fs::remove_file(&path);
    let output = example(name)
        .arg(&path)
        .arg(format!("{}x{}", SIZE.0, SIZE.1))
        .output()
        .expect("the example starts");
    assert!(output.status.success(), "{name}: {}", said(&output));
    // What it leaves out, or has to put right, it says.
    let complains = said(&output).contains("ERROR") || said(&output).contains("bevy_vdb::");
    assert!(!complains, "{name}: {}", said(&output));
    let file = std::io::BufReader::new(std::fs::File::open(&path).expect("the picture is there"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("pixels");
    assert_eq!((info.width as usize, info.height as usize), SIZE);
    assert_eq!(info.color_type, png::ColorType::Rgb);
    let pixels = bytes[..info.buffer_size()].chunks_exact(3);
    pixels.map(|rgb| [rgb[0], rgb[1], rgb[2]]).collect()
}

fn count(pixels: &[[u8; 3]], holds: impl Fn([i32; 3]) -> bool) -> usize {
    pixels.iter().filter(|pixel| holds(pixel.map(i32::from))).count()
}

/// How many of six sections of the colour circle have many pixels.
fn hues(pixels: &[[u8; 3]]) -> usize {
    let section = |[r, g, b]: [i32; 3]| {
        let (most, least) = (r.max(g).max(b), r.min(g).min(b));
        (most - least > 50).then(|| match most {
            most if most == r => usize::from(g > b),
            most if most == g => 2 + usize::from(b > r),
            _ => 4 + usize::from(r > g),
        })
    };
    let mut found = [0; 6];
    for pixel in pixels {
        if let Some(section) = section(pixel.map(i32::from)) {
            found[section] += 1;
        }
    }
    found.iter().filter(|&&pixels| pixels > 60).count()
}

#[test]
fn many_volumes_are_of_all_colours() {
    if !has_gpu() {
        return;
    }
    let picture = picture("many_volumes");
    // Teapots and shapes are of every hue, and between them is next to nothing.
    assert_eq!(hues(&picture), 6);
    let dark = count(&picture, |[r, g, b]| r + g + b < 90);
    assert!(dark * 5 > picture.len() && dark * 5 < picture.len() * 4, "{dark} dark pixels");
}

#[test]
fn gold_and_chrome_mirror_the_studio() {
    if !has_gpu() {
        return;
    }
    let picture = picture("glossy");
    // Gold is yellow, chrome is bright without a hue: screens in it, dark walls elsewhere.
    let gold = count(&picture, |[r, g, b]| r > 120 && r > b + 50 && g > b + 20);
    assert!(gold > picture.len() / 60, "{gold} pixels of gold");
    let screens = count(&picture, |[r, g, b]| r.min(g).min(b) > 200);
    assert!((20..picture.len() / 4).contains(&screens), "{screens} pixels of screens");
    // The lower half is the plate, and what is mirrored in it.
    let plate = &picture[picture.len() * 3 / 4..];
    let mirrored = count(plate, |[r, _, b]| r > b + 20);
    assert!(mirrored > 30, "{mirrored} pixels of gold in the plate");
}

#[test]
fn clay_is_carved_and_set_with_beads() {
    if !has_gpu() {
        return;
    }
    let picture = picture("edit_voxels");
    let clay = |[r, g, b]: [i32; 3]| r > 50 && r > g + 15 && g >= b;
    let clays = count(&picture, clay);
    assert!(clays > picture.len() / 10, "{clays} pixels of clay");
    // Down its middle the ball is light and dark again and again, where it was even before.
    let column = picture[SIZE.0 / 2..].iter().step_by(SIZE.0);
    let brightness: Vec<i32> =
        column.filter(|rgb| clay(rgb.map(i32::from))).map(|rgb| rgb[0].into()).collect();
    let turns = |two: &[i32]| (two[0] - two[1]).abs() > 25;
    let edges = brightness.windows(2).filter(|two| turns(two)).count();
    assert!(edges > 6, "{edges} edges of grooves");
}

#[test]
fn the_rover_is_on_the_island() {
    if !has_gpu() {
        return;
    }
    let picture = picture("game");
    let (top, rest) = picture.split_at(picture.len() / 4);
    let sky = count(top, |[r, _, b]| b > r + 20);
    assert!(sky > top.len() / 3, "{sky} pixels of sky");
    // Were it in the ground or not there, no red would be in the picture.
    let red = count(rest, |[r, g, b]| r > 60 && r > 2 * g && r > 2 * b);
    assert!(red > 20, "{red} pixels of the rover");
    let ground = count(rest, |[r, g, b]| r > 40 && r >= g && g >= b);
    assert!(ground > rest.len() / 4, "{ground} pixels of ground");
}

#[test]
fn volumes_under_lights_are_drawn() {
    if !has_gpu() {
        return;
    }
    let picture = picture("lights_and_shadows");
    assert!(count(&picture, |[r, g, b]| r > 110 && r > g + 40 && r > b + 40) > 100, "no clay");
    assert!(count(&picture, |[r, g, b]| r.min(g).min(b) > 150) > 50, "no cloud");
}

#[test]
fn smoke_and_fire_glow_and_are_mirrored() {
    if !has_gpu() {
        return;
    }
    let picture = picture("smoke_and_fire");
    // The fire is to the left, and the floor that mirrors it below.
    let (above, below) = picture.split_at(picture.len() / 4 * 3);
    let is_fire = |[r, _, b]: [i32; 3]| r > 150 && r > 2 * b;
    let left: Vec<[u8; 3]> =
        above.chunks_exact(SIZE.0).flat_map(|row| &row[..SIZE.0 / 2]).copied().collect();
    assert!(count(&left, is_fire) > 80, "{} pixels of fire", count(&left, is_fire));
    assert!(count(below, |[r, ..]| r > 30) > 0, "the floor is dark");
    let blue = count(&picture, |[r, _, b]| b > 100 && b > 2 * r);
    assert!(blue > 8, "{blue} pixels of the ball are blue");
}

#[test]
fn what_cannot_be_drawn_is_an_error() {
    if !has_gpu() {
        return;
    }
    let nowhere = temporary("no/such/folder/picture.png");
    let output = example("glossy").arg(&nowhere).arg("16x9").output().expect("it starts");
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("could not be written"), "{}", said(&output));
    let output = example("glossy").args(["picture.png", "0x9"]).output().expect("it starts");
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));
    assert!(said(&output).contains("not a size"), "{}", said(&output));
}
