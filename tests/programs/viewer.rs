//! The viewer as people call it: pictures, exit codes and what it says.

use std::process::{Command, Output};

use bevy::math::UVec2;
use bevy_vdb::VdbRenderMode;

use crate::files::{self, model};
use crate::png_file::Png;
use crate::programs::{example, stderr};
use crate::{adapter, smoke_file};

const SIZE: UVec2 = UVec2::new(160, 120);

pub fn viewer() -> Command {
    let mut command = example("viewer");
    command.args(["--size", &format!("{}x{}", SIZE.x, SIZE.y)]);
    command
}

fn temporary(name: &str) -> std::path::PathBuf {
    files::temporary("viewer", name)
}

/// Runs the viewer into a picture: RGB pixels.
pub fn picture(out: &str, change: impl FnOnce(&mut Command)) -> (Vec<[u8; 3]>, Output) {
    let path = temporary(out);
    let mut command = viewer();
    command.arg("--out").arg(&path);
    change(&mut command);
    let output = command.output().expect("the viewer starts");
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), path.display().to_string());
    let png = Png::read(&path);
    assert_eq!(png.size, SIZE);
    (png.pixels, output)
}

/// Pixels that are clearly not the background, which the corner has.
pub fn drawn(pixels: &[[u8; 3]]) -> usize {
    pixels.iter().filter(|pixel| difference(pixel, &pixels[0]) > 16).count()
}

fn difference(a: &[u8; 3], b: &[u8; 3]) -> u8 {
    (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap_or(0)
}

/// Fails to show something: exit code 1, no panic. Returns all that it says.
pub fn fails(change: impl FnOnce(&mut Command)) -> String {
    let mut command = viewer();
    command.arg("--out").arg(temporary("refused.png"));
    change(&mut command);
    let output = command.output().expect("the viewer starts");
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(!text.contains("panicked"), "{text}");
    text
}

/// As [`fails`], with one line that starts with our name, which is returned.
pub fn refused(change: impl FnOnce(&mut Command)) -> String {
    let text = fails(change);
    let ours = text.lines().filter(|line| line.starts_with("viewer: "));
    let said: Vec<&str> = ours.filter(|line| !line.contains("instead")).collect();
    assert_eq!(said.len(), 1, "{text}");
    said[0].to_owned()
}

/// Whether pictures come from a GPU here, lavapipe counted in.
fn on_gpu(output: &Output) -> bool {
    let cpu = stderr(output).contains("tracing on the CPU instead");
    if cpu {
        adapter::skip();
    }
    !cpu
}

#[test]
fn the_bundled_models_are_shown_and_the_cpu_agrees() {
    for (name, fewest, most) in [("teapot.vdb", 2_000, 10_000), ("cloud.vdb", 1_000, 10_000)] {
        let (gpu, output) =
            picture(&format!("gpu-{name}.png"), |c| _ = c.arg("--scatter-once").arg(model(name)));
        assert!(stderr(&output).contains("active voxels"), "{}", stderr(&output));
        let count = drawn(&gpu);
        assert!((fewest..most).contains(&count), "{name}: {count} pixels");
        if !on_gpu(&output) {
            continue;
        }
        let (cpu, _) = picture(&format!("cpu-{name}.png"), |c| _ = c.arg("--cpu").arg(model(name)));
        let pairs = gpu.iter().zip(&cpu);
        // Rays that graze an edge may see either side of it.
        let differ = pairs.filter(|(gpu, cpu)| difference(gpu, cpu) > 3).count();
        assert!(differ * 200 < gpu.len(), "{name}: {differ} of {} pixels differ", gpu.len());
    }
}

#[test]
fn without_arguments_the_bundled_level_set_is_written_where_one_is() {
    let folder = temporary("default");
    std::fs::create_dir_all(&folder).expect("a folder");
    let output = viewer().current_dir(&folder).output().expect("the viewer starts");
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("teapot.vdb: surface"), "{}", stderr(&output));
    assert!(folder.join("viewer.png").exists());
}

#[test]
#[ignore = "slow: nine pictures"]
fn ground_and_modes_change_the_picture() {
    let (lit, output) = picture("lit.png", |_| ());
    if !on_gpu(&output) {
        return;
    }
    let (ground, _) = picture("ground.png", |c| _ = c.arg("--ground"));
    assert!(drawn(&ground) > drawn(&lit) + 2_000);
    for mode in VdbRenderMode::ALL.iter().map(|mode| mode.name()) {
        // The first picture; highlights, which are few; and what shows fog alone.
        if ["lit", "glossy", "maximum"].contains(&mode) {
            continue;
        }
        let (shown, _) = picture(&format!("{mode}.png"), |c| _ = c.args(["--mode", mode]));
        assert!(drawn(&shown) > 2_000, "{mode}: {} pixels", drawn(&shown));
    }
}

#[test]
fn the_camera_stands_where_it_is_put() {
    // The teapot's spout points along +x: from far off to the side, with a narrow view past it.
    let past = ["--eye", "0,1,30", "--target", "8,1,0", "--fov", "10"];
    let (nothing, _) = picture("past.png", |c| _ = c.args(past));
    assert_eq!(drawn(&nothing), 0);
    let (all, _) = picture("close.png", |c| {
        _ = c.args(["--eye", "0,1,4", "--target", "0,1,0", "--fov", "20"])
    });
    let shown = all.iter().filter(|pixel| difference(pixel, &nothing[0]) > 16).count();
    assert!(shown > all.len() * 9 / 10, "{shown} of {} pixels", all.len());
}

#[test]
fn a_file_that_cannot_be_shown_is_one_clear_error() {
    let missing = temporary("missing.vdb");
    let said = refused(|c| _ = c.arg(&missing));
    assert!(said.contains("missing.vdb") && said.contains("no such file"), "{said}");

    let whole = std::fs::read(model("teapot.vdb")).expect("the bundled model");
    let truncated = temporary("truncated.vdb");
    std::fs::write(&truncated, &whole[..whole.len() / 2]).expect("written");
    let said = refused(|c| _ = c.arg(&truncated));
    assert!(said.contains("truncated.vdb") && said.contains("damaged"), "{said}");

    let text = temporary("text.vdb");
    std::fs::write(&text, "this is a text, not a volume, and long enough to be read")
        .expect("written");
    let said = refused(|c| _ = c.arg(&text));
    assert!(said.contains("text.vdb") && said.contains("not a VDB file"), "{said}");

    let said = refused(|c| _ = c.arg(&text).arg("--cpu"));
    assert!(said.contains("text.vdb"), "{said}");

    let said = refused(|c| _ = c.arg(model("cloud.vdb")).args(["--grid", "smoke"]));
    assert!(said.contains("cloud.vdb") && said.contains("smoke"), "{said}");
}

#[test]
#[ignore = "slow: pictures of fire in smoke"]
fn grids_have_the_parts_that_are_asked_for() {
    let path = temporary("roles.vdb");
    smoke_file::save(&path);
    // Thin, and in light that is quick to draw.
    let quick = ["--density", "0.05", "--scatter-once", "--no-shadows"];
    let shown = |out, args: &[&str]| picture(out, |c| _ = c.arg(&path).args(quick).args(args));
    let (by_name, output) = shown("by_name.png", &[]);
    let said = stderr(&output);
    for line in ["Cd: vectors", "temperature: fog", "fuel: fog", "(hidden: --grid shows it)"] {
        assert!(said.contains(line), "{said}");
    }
    if !on_gpu(&output) {
        return;
    }
    let differ = |a: &[[u8; 3]], b: &[[u8; 3]], holds: &dyn Fn([i32; 3], [i32; 3]) -> bool| {
        let pairs = a.iter().zip(b).map(|(a, b)| (a.map(i32::from), b.map(i32::from)));
        pairs.filter(|(a, b)| holds(*a, *b)).count()
    };
    let (bare, _) = shown("bare.png", &["--no-fire", "--no-colors"]);
    let glows = differ(&by_name, &bare, &|a, b| a[0] > b[0] + 20 && a[0] > a[2] + 20);
    assert!(glows > 50, "{glows} pixels glow");
    // All of the ball but a voxel is black by its colours.
    let colored = differ(&by_name, &bare, &|a, b| a[1] + 60 < b[1]);
    assert!(colored > 50, "{colored} pixels have a colour");
    let other = ["--grid", "density", "--fire", "fuel", "--heat", "2000,300", "--glow", "3e-4"];
    let (other, output) = shown("other.png", &other);
    assert!(!stderr(&output).contains("surface"), "{}", stderr(&output));
    let (solid, output) = shown("solid.png", &["--grid", "density", "--surface", "density=0.5"]);
    assert!(stderr(&output).contains("density: surface"), "{}", stderr(&output));
    let glows = differ(&other, &solid, &|a, b| a[0] > a[2] + 20 && b[0] < b[2] + 20);
    assert!(glows > 50, "{glows} pixels glow");
    assert!(drawn(&solid) > 1_000, "{} pixels", drawn(&solid));
    let said = refused(|c| _ = c.arg(&path).args(["--fire", "lava"]));
    assert!(said.contains("--fire lava") && said.contains("no file has"), "{said}");
}

#[test]
fn what_makes_no_sense_is_refused() {
    for (wrong, about) in [
        (vec!["--size", "0x10"], "--size"),
        (vec!["--mode", "pretty"], "--mode"),
        (vec!["--eye", "1,2"], "--eye"),
        (vec!["--heat", "1000"], "--heat"),
        (vec!["--glow", "-1"], "--glow"),
        (vec!["--nothing"], "--nothing"),
        (vec!["--out", "picture.jpg"], "picture.jpg"),
        (vec!["--mode", "steps", "--cpu"], "modes"),
    ] {
        let said = refused(|c| _ = c.args(&wrong));
        assert!(said.contains(about), "{said}");
    }
    let help = viewer().arg("--help").output().expect("the viewer starts");
    assert!(help.status.success());
    let help = String::from_utf8_lossy(&help.stdout);
    assert!(help.contains("--ground"));
    for mode in VdbRenderMode::ALL {
        assert!(help.contains(mode.name()), "{mode:?}");
    }
}
