//! The examples as people run them: each without a window, into a picture that shows what it is about.

use glam::{Mat4, Vec3};
use gpu_test::gpu_test;

use crate::files::temporary;
use crate::png_file::Png;
use crate::programs::{example, stderr};

const SIZE: (usize, usize) = (128, 72);

/// The picture of an example, row by row from the top left.
fn picture(name: &str) -> Vec<[u8; 3]> {
    let path = temporary("examples", &format!("{name}.png"));
    let output = example(name)
        .arg(&path)
        .arg(format!("{}x{}", SIZE.0, SIZE.1))
        .output()
        .expect("the example starts");
    assert!(output.status.success(), "{name}: {}", stderr(&output));
    // What it leaves out, or has to put right, it says.
    let complains = stderr(&output).contains("ERROR") || stderr(&output).contains("bevy_vdb::");
    assert!(!complains, "{name}: {}", stderr(&output));
    let png = Png::read(&path);
    assert_eq!((png.size.x as usize, png.size.y as usize), SIZE);
    png.pixels
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

/// Three fires, each at another time of one sequence.
#[gpu_test]
fn sequence_shows_three_fires() {
    let picture = picture("sequence");
    let is_fire = |[r, g, b]: [i32; 3]| r > 150 && r > 2 * b && g < r;
    let thirds = [0..46, 46..82, 82..128].map(|columns| {
        let within = |(i, _): &(usize, &[u8; 3])| columns.contains(&(i % SIZE.0));
        let part = picture.iter().enumerate().filter(within).map(|(_, pixel)| *pixel);
        count(&part.collect::<Vec<_>>(), is_fire)
    });
    assert!(thirds.iter().all(|pixels| (5..1_500).contains(pixels)), "{thirds:?}");
    let dark = count(&picture, |[r, g, b]| r + g + b < 90);
    assert!(dark * 3 > picture.len(), "{dark} dark pixels");
}

#[gpu_test]
fn many_volumes_are_of_all_colours() {
    let picture = picture("many_volumes");
    // Teapots and shapes are of every hue, and between them is next to nothing.
    assert_eq!(hues(&picture), 6);
    let dark = count(&picture, |[r, g, b]| r + g + b < 90);
    assert!(dark * 5 > picture.len() && dark * 5 < picture.len() * 4, "{dark} dark pixels");
}

#[gpu_test]
#[ignore = "slow: reflections in reflections"]
fn gold_and_chrome_mirror_the_studio() {
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

#[gpu_test]
#[ignore = "slow: ten seconds of edits"]
fn clay_is_carved_and_set_with_beads() {
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

/// The crates stand on the hill at first, and fall when the worm has been below them.
#[gpu_test]
#[ignore = "slow: four seconds of physics in a development build"]
fn crates_fall_into_the_trench() {
    let picture = picture("physics");
    let wood = |[r, g, b]: [i32; 3]| r > 90 && r > g + 25 && g > b + 20;
    let highest = picture.chunks(SIZE.0).position(|row| count(row, wood) > 0);
    // The top of the pyramid that stands on the hill, seen from where the example's camera is.
    let view = Mat4::look_at_rh(Vec3::new(2.2, 3.6, 5.6), Vec3::Y * 0.8, Vec3::Y);
    let lens = Mat4::perspective_rh(std::f32::consts::FRAC_PI_4, 16.0 / 9.0, 0.1, 100.0);
    let standing = (lens * view).project_point3(Vec3::Y * (1.4 + 3.0 * 0.36));
    let standing = 0.5 * (1.0 - standing.y) * SIZE.1 as f32;
    println!("wood from row {highest:?} of {}, at first from row {standing}", SIZE.1);
    let highest = highest.expect("no crate is visible");
    assert!(highest as f32 > standing + 5.0, "the crates still stand: row {highest}");
    let grass = count(&picture, |[r, g, b]| g > r + 8 && g > b + 20);
    assert!(grass > picture.len() / 8, "{grass} pixels of grass");
}

#[gpu_test]
#[ignore = "slow: a large scene"]
fn the_rover_is_on_the_island() {
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

#[gpu_test]
#[ignore = "slow: fog under every kind of light"]
fn volumes_under_lights_are_drawn() {
    let picture = picture("lights_and_shadows");
    assert!(count(&picture, |[r, g, b]| r > 110 && r > g + 40 && r > b + 40) > 100, "no clay");
    assert!(count(&picture, |[r, g, b]| r.min(g).min(b) > 150) > 50, "no cloud");
}

#[gpu_test]
#[ignore = "slow: fog in the sun"]
fn planes_cut_a_teapot_and_a_cloud() {
    let picture = picture("clip_planes");
    // The cut is flat, and so evenly lit: most of what is amber has one colour.
    let amber = |[r, g, b]: [i32; 3]| r > g + 30 && g > b + 30;
    let (mut most, mut all) = (0, 0);
    for &pixel in picture.iter().filter(|pixel| amber(pixel.map(i32::from))) {
        let like = |other: [i32; 3]| (0..3).all(|i| (other[i] - i32::from(pixel[i])).abs() <= 3);
        most = most.max(count(&picture, like));
        all += 1;
    }
    assert!(all > 400 && 2 * most > all, "{most} of {all} pixels of the teapot are of one colour");
    let cloud = count(&picture, |[r, g, b]| r.min(g).min(b) > 160);
    assert!(cloud > 200, "{cloud} pixels of cloud");
}

#[gpu_test]
#[ignore = "slow: fire in smoke"]
fn smoke_and_fire_glow_and_are_mirrored() {
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

#[gpu_test]
#[cfg(feature = "record")]
fn a_turn_around_the_teapot_is_recorded() {
    let folder = temporary("examples", "record");
    let output = example("record").arg(&folder).arg("64x36").output().expect("the example starts");
    assert!(output.status.success(), "{}", stderr(&output));
    let frames: Vec<Png> =
        (0..90).map(|frame| Png::read(&folder.join(format!("{frame:08}.png")))).collect();
    assert!(!folder.join("00000090.png").exists(), "it ends after a turn");
    let off = |a: &[u8; 3], b: &[u8; 3]| (0..3).any(|i| a[i].abs_diff(b[i]) > 40);
    let differ =
        |a: &Png, b: &Png| a.pixels.iter().zip(&b.pixels).filter(|(a, b)| off(a, b)).count();
    for frame in &frames {
        assert_eq!((frame.size.x, frame.size.y), (64, 36));
        let drawn = frame.pixels.iter().filter(|pixel| **pixel != frame.pixels[0]).count();
        assert!(drawn > 200, "{drawn} pixels of the teapot");
    }
    // The spout is on the right, then on the left, and comes back, but for the last of the 90 steps.
    let [half, whole] = [45, 89].map(|frame| differ(&frames[0], &frames[frame]));
    assert!(half > 20 && 2 * whole < half, "{half} pixels differ after a half, {whole} in the end");
}

#[gpu_test]
fn what_cannot_be_drawn_is_an_error() {
    let nowhere = temporary("examples", "no/such/folder/picture.png");
    let output = example("glossy").arg(&nowhere).arg("16x9").output().expect("it starts");
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("could not be written"), "{}", stderr(&output));
    let output = example("glossy").args(["picture.png", "0x9"]).output().expect("it starts");
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("not a size"), "{}", stderr(&output));
}

/// A pale ghost before a dusky sky, over sand that is darker where it is wet.
#[gpu_test]
#[ignore = "slow: a large scene"]
fn materials_shows_a_ghost_and_wet_sand() {
    let picture = picture("materials");
    let (above, below) = picture.split_at(SIZE.0 * SIZE.1 / 2);
    let is_pale = |[r, g, b]: [i32; 3]| r > 170 && g > 165 && b > 165;
    assert!(count(above, is_pale) > 40, "{} pale pixels", count(above, is_pale));
    let is_sand = |[r, g, b]: [i32; 3]| r > g && g > b + 10;
    let [bright, dark] = [true, false]
        .map(|is_bright| count(below, |pixel| is_sand(pixel) && (pixel[0] > 150) == is_bright));
    assert!(bright > 400 && dark > 60, "{bright} bright and {dark} dark pixels of sand");
}
