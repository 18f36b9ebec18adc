//! `vdb render`: pictures against closed forms, what is in the picture by default, and mistakes.

mod light_in_fog;

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::{DVec2, DVec3};
use vdb_core::synth::{fog, level_set};
use vdb_core::tree::Vdb543;
use vdb_core::{AnyTree, Grid, GridClass, Transform, VdbFile, WriteOptions};

/// The middle of the balls, in voxels, and their radius.
const MIDDLE: DVec3 = DVec3::new(3.25, -2.0, 5.5);
const RADIUS: f64 = 20.0;
/// The layer in which the density of the fog falls to zero.
const SOFT: f64 = 4.0;
/// World units per voxel.
const VOXEL: f64 = 0.5;
/// Pixels along each edge of the pictures of balls.
const PIXELS: usize = 120;
/// The width of these pictures in world units.
const FRAME: f64 = 30.0;

struct Image {
    width: usize,
    channels: usize,
    bytes: Vec<u8>,
}

impl Image {
    fn open(path: &str) -> Self {
        let decoder = png::Decoder::new(BufReader::new(File::open(path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let channels = info.color_type.samples();
        Self { width: info.width as usize, channels, bytes }
    }

    fn at(&self, x: usize, y: usize) -> &[u8] {
        let first = (y * self.width + x) * self.channels;
        &self.bytes[first..first + self.channels]
    }
}

fn vdb(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vdb")).args(arguments).output().unwrap()
}

/// Draws a picture beside a file, with more options.
fn draw(file: &str, options: &[&str]) -> Image {
    let out = format!("{file}.png");
    let output = vdb(&[&["render", file, "--out", &out][..], options].concat());
    assert!(output.status.success(), "{output:?}");
    let image = Image::open(&out);
    std::fs::remove_file(out).unwrap();
    image
}

/// A parallel view of a ball along -z.
fn draw_ball(file: &str, options: &[&str]) -> Image {
    let middle = (VOXEL * MIDDLE).to_array().map(|c| c.to_string()).join(",");
    let eye = (VOXEL * MIDDLE + 50.0 * DVec3::Z).to_array().map(|c| c.to_string()).join(",");
    let view = ["--camera", "ortho", "--frame", "30", "--size", "120x120", "--samples", "1"];
    let at = ["--translate", &eye, "--lookat", &middle];
    draw(file, &[&view[..], &at, options].concat())
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vdb-render-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn grid(name: &str, tree: Vdb543<f32>, class: GridClass) -> Grid {
    let mut grid = Grid::new(name, AnyTree::Float(tree.into()));
    grid.class = class;
    grid.transform = Transform::uniform(VOXEL, DVec3::ZERO).unwrap();
    grid
}

fn saved(folder: &Path, name: &str, grids: Vec<Grid>) -> String {
    let path = folder.join(name).to_str().unwrap().to_owned();
    VdbFile::new(grids).save(&path, &WriteOptions::default()).unwrap();
    path
}

fn solid_ball() -> Grid {
    grid("ball", level_set::sphere(MIDDLE, RADIUS), GridClass::LevelSet)
}

fn fog_ball() -> Grid {
    grid("density", fog::sphere(MIDDLE, RADIUS, SOFT), GridClass::FogVolume)
}

fn model(name: &str) -> String {
    format!("{}/../../assets/models/{name}", env!("CARGO_MANIFEST_DIR"))
}

/// Every pixel with its position relative to the middle of the ball, in world units, y up.
fn pixels() -> impl Iterator<Item = (usize, usize, DVec2)> {
    let at = |i: usize| (i as f64 + 0.5) / PIXELS as f64 * FRAME - 0.5 * FRAME;
    let all = (0..PIXELS).flat_map(|y| (0..PIXELS).map(move |x| (x, y)));
    all.map(move |(x, y)| (x, y, DVec2::new(at(x), -at(y))))
}

fn decode(byte: u8) -> f64 {
    let encoded = f64::from(byte) / 255.0;
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// The normal of the ball that a pixel sees, and how far the pixel is inside the silhouette.
fn normal(at: DVec2) -> (DVec3, f64) {
    let radius = VOXEL * RADIUS;
    let at_unit = at / radius;
    let z = (1.0 - at_unit.length_squared()).max(0.0).sqrt();
    (at_unit.extend(z), radius - at.length())
}

/// The samples of a level set are exact distances, and their trilinear interpolant is off by at most
/// 3 · 1/8 of the largest second derivative, 1/r: 0.019 voxels. A pixel has a width of half a voxel.
const EDGE: f64 = 0.02;

#[test]
fn a_ball_has_its_silhouette_normals_and_positions() {
    let folder = folder("ball");
    let file = saved(&folder, "ball.vdb", vec![solid_ball()]);
    let plain = ["--background", "#ff00ff"];
    let normals = draw_ball(&file, &[&plain[..], &["--shader", "normal"]].concat());
    let positions = draw_ball(&file, &[&plain[..], &["--shader", "position"]].concat());
    let radius = VOXEL * RADIUS;
    for (x, y, at) in pixels() {
        let (normal, inside) = normal(at);
        for image in [&normals, &positions] {
            let hit = image.at(x, y) != [255, 0, 255];
            assert!(hit == (inside > 0.0) || inside.abs() < EDGE, "{at}: {hit}");
        }
        // Near the silhouette, where z is steep, a pixel tells little of the normal.
        if inside < 0.05 * radius {
            continue;
        }
        let position = (0.5 * normal + 0.5).to_array();
        for axis in 0..3 {
            // Half a step of eight bits. The normal is a difference over one voxel: a relative error
            // of the order of 1/24 r², and its samples have one of 1/8r in the curvature.
            let is = f64::from(normals.at(x, y)[axis]) / 255.0;
            assert!((is - position[axis]).abs() < 0.008, "{at}: {is}, not {position:?}");
            // The box ends with cells, one voxel beyond the ball at most.
            let is = f64::from(positions.at(x, y)[axis]) / 255.0;
            assert!((is - position[axis]).abs() < 1.5 / (2.0 * RADIUS), "{at}: {is} as position");
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_ball_is_as_bright_as_its_angle_to_the_light() {
    let folder = folder("shading");
    let file = saved(&folder, "ball.vdb", vec![solid_ball()]);
    let options = ["--light", "3,0,4,0.9,0.6,0.3", "--ambient", "0.02,0.02,0.02"];
    for shadows in [&[][..], &["--no-shadows"]] {
        let image = draw_ball(&file, &[&options[..], shadows].concat());
        let mut compared = 0;
        for (x, y, at) in pixels() {
            let (normal, inside) = normal(at);
            let facing = normal.dot(DVec3::new(0.6, 0.0, 0.8));
            if inside < 0.5 || facing.abs() < 0.03 {
                continue;
            }
            for (axis, light) in [0.9, 0.6, 0.3].into_iter().enumerate() {
                // The tone curve begins above this. The albedo is 0.8.
                let expected = 0.8 * (light * facing.max(0.0) + 0.02);
                let is = decode(image.at(x, y)[axis]);
                assert!((is - expected).abs() < 0.012, "{at}: {is}, not {expected}");
            }
            compared += 1;
        }
        assert!(compared > 4_000, "{compared}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_turned_camera_sees_what_one_that_looks_at_a_point_sees() {
    let folder = folder("camera");
    let file = saved(&folder, "ball.vdb", vec![solid_ball()]);
    let view = ["--shader", "normal", "--size", "65x49", "--samples", "1", "--fov", "60"];
    let at = |options: &[&str]| draw(&file, &[&view[..], options].concat()).bytes;
    // Half a turn about y looks along z.
    let turned = at(&["--translate", "1,2,-20", "--rotate", "0,180,0"]);
    assert_eq!(turned, at(&["--translate", "1,2,-20", "--lookat", "1,2,5"]));
    // About x, down; then about z, to the side.
    let turned = at(&["--translate", "-30,-1,2.75", "--rotate", "-90,0,90"]);
    let looking = ["--translate", "-30,-1,2.75", "--lookat", "0,-1,2.75", "--up", "0,0,-1"];
    assert_eq!(turned, at(&looking));
    let turned = at(&["--translate", "1,30,2", "--rotate", "-90,0,0"]);
    assert_eq!(turned, at(&["--translate", "1,30,2", "--lookat", "1,0,2", "--up", "0,0,-1"]));
    // A focal length and an aperture are a field of view: 2 atan (41.2136 / 2 / 50).
    let own = |options: &[&str]| draw(&file, &[&view[..6], options].concat()).bytes;
    assert_eq!(own(&[]), own(&["--focal", "25", "--aperture", "20.6068"]));
    // What is nearer than the near plane, or farther than the far one, is not seen.
    let eye = ["--translate", "1.625,-1,52.75", "--lookat", "1.625,-1,2.75"];
    let middle = |options: &[&str]| {
        let image = draw(&file, &[&view[..], &eye, &["--background", "black"], options].concat());
        image.at(32, 24).to_vec()
    };
    // The normal along z, whose 0.5 is between two bytes.
    let is_seen = |options: &[&str]| match middle(options)[..] {
        [0, 0, 0] => false,
        [127 | 128, 127 | 128, 255] => true,
        ref other => panic!("{other:?}"),
    };
    assert!(is_seen(&[]));
    assert!(!is_seen(&["--far", "39.9"]) && is_seen(&["--far", "40.1"]));
    // Through the front, to the back of the ball seen from inside.
    assert!(is_seen(&["--near", "40.1"]) && is_seen(&["--near", "59.9"]));
    assert!(!is_seen(&["--near", "60.1"]));
    std::fs::remove_dir_all(&folder).unwrap();
}

/// The shares of a picture with a transparent background that are covered, and of its outermost pixels.
fn coverage(image: &Image, height: usize) -> [f64; 2] {
    let (mut inside, mut edge) = (0, 0);
    for (y, x) in (0..height).flat_map(|y| (0..image.width).map(move |x| (y, x))) {
        let covered = usize::from(image.at(x, y)[3] > 2);
        inside += covered;
        if x == 0 || y == 0 || x + 1 == image.width || y + 1 == height {
            edge += covered;
        }
    }
    [inside, edge].map(|count| count as f64 / (image.width * height) as f64)
}

#[test]
fn everything_is_in_the_picture_by_default() {
    let folder = folder("framing");
    for name in ["teapot.vdb", "cloud.vdb", "fire/fire_0016.vdb"] {
        for (size, height) in [("160x90", 90), ("60x120", 120)] {
            for camera in ["perspective", "ortho"] {
                let file = folder.join("model.vdb").to_str().unwrap().to_owned();
                std::fs::copy(model(name), &file).unwrap();
                let view = ["--size", size, "--camera", camera, "--samples", "1"];
                let image = draw(&file, &[&view[..], &["--background", "transparent"]].concat());
                let [inside, edge] = coverage(&image, height);
                assert!(edge == 0.0, "{name}, {size}, {camera}: cut off");
                assert!(inside > 0.08, "{name}, {size}, {camera}: {inside} of the picture");
            }
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_grids_are_those_of_the_viewer() {
    let folder = folder("roles");
    let named =
        |name: &str, grid: Grid| Grid { name: name.into(), unique_name: name.into(), ..grid };
    let report = |file: &str, options: &[&str]| -> serde_json::Value {
        let out = folder.join("x.png").to_str().unwrap().to_owned();
        let own = ["render", file, "--out", &out, "--size", "8x8", "--json"];
        let output = vdb(&[&own[..], options].concat());
        assert!(output.status.success(), "{output:?}");
        serde_json::from_slice(&output.stdout).unwrap()
    };
    // Houdini's cloud: the distance would hide it. Blender's smoke: the obstacle helps the simulation.
    let cloud = vec![named("distance", solid_ball()), fog_ball()];
    let smoke = vec![
        named("phi_obstacle", solid_ball()),
        named("heat", fog_ball()),
        fog_ball(),
        named("flame", fog_ball()),
    ];
    let both = vec![solid_ball(), fog_ball()];
    for (name, grids, surfaces, fire) in [
        ("cloud.vdb", cloud, vec![], None),
        ("smoke.vdb", smoke, vec![], Some("flame")),
        ("both.vdb", both, vec!["ball"], None),
    ] {
        let report = report(&saved(&folder, name, grids), &[]);
        assert_eq!(report["fog"], "density", "{name}");
        assert_eq!(report["surfaces"], serde_json::json!(surfaces), "{name}");
        assert_eq!(report["fire"], serde_json::json!(fire), "{name}");
        assert_eq!(report["size"], serde_json::json!([8, 8]));
    }
    let file = folder.join("cloud.vdb").to_str().unwrap().to_owned();
    let chosen = report(&file, &["--grid", "distance"]);
    assert_eq!(
        (&chosen["fog"], &chosen["surfaces"][0]),
        (&serde_json::Value::Null, &"distance".into())
    );
    let solid = report(&file, &["--grid", "density", "--iso", "0.5"]);
    assert_eq!(
        (&solid["fog"], &solid["surfaces"][0]),
        (&serde_json::Value::Null, &"density".into())
    );
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn mistakes_are_one_line_and_leave_nothing() {
    let folder = folder("mistakes");
    let numbers = vdb_core::tree::map_values(&fog::sphere(MIDDLE, 4.0, 2.0), |v: f32| [v; 3]);
    let mut vectors = solid_ball();
    (vectors.name, vectors.unique_name) = ("vel".into(), "vel".into());
    vectors.tree = AnyTree::Vec3s(numbers.into());
    let file = saved(&folder, "fog.vdb", vec![fog_ball(), vectors]);
    let hollow = grid("empty", Vdb543::new(0.0), GridClass::FogVolume);
    let hollow = saved(&folder, "empty.vdb", vec![hollow]);
    let out = folder.join("out.png").to_str().unwrap().to_owned();
    let text = folder.join("out.txt").to_str().unwrap().to_owned();
    let fails = |file: &str, out: &str, options: &[&str], code: i32, expected: &str| {
        let output = vdb(&[&["render", file, "--out", out][..], options].concat());
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{options:?}: {said}");
        assert!(said.contains(expected), "{options:?}: {said}");
        assert!(code == 2 || said.lines().count() == 1, "{said}");
        assert!(output.stdout.is_empty());
        let left = std::fs::read_dir(&folder).unwrap().count();
        assert_eq!(left, 2, "{options:?} leaves a file");
    };
    fails(&file, &out, &["--grid", "dust"], 1, "no grid is called \"dust\"");
    fails(&file, &out, &["--grid", "vel"], 1, "grid \"vel\" has values of type vec3s, not floats");
    fails(&file, &out, &["--shader", "normal"], 1, "fog has no normals and positions");
    fails(&file, &out, &["--iso", "7"], 1, "no grid shows anything");
    fails(&hollow, &out, &[], 1, "no grid shows anything");
    fails(&text, &out, &[], 1, "out.txt");
    fails(&file, &text, &[], 2, "the name of the picture must end in .png");
    let no_folder = folder.join("no/out.png");
    fails(&file, no_folder.to_str().unwrap(), &["--size", "8x8"], 1, "no/out.png");
    let large = "a size is two whole numbers from 1 to 16384";
    for size in ["100000x100000", "0x5", "12", "-1x5", "5x4294967297", "axb"] {
        fails(&file, &out, &[&format!("--size={size}")], 2, large);
    }
    for (option, expected) in [
        ("--samples=0", "1..=1024"),
        ("--samples=1000000", "1..=1024"),
        ("--fov=180", "--fov is 180; it must be between 0 and 180 degrees"),
        ("--focal=0", "--focal is 0; it must be more than 0"),
        ("--aperture=NaN", "--aperture is NaN; it must be more than 0"),
        ("--frame=5", "--frame is for --camera ortho"),
        ("--up=0,0,0", "--up has no length"),
        ("--near=-1", "--near is -1 and --far is inf"),
        ("--far=0", "--near is 0 and --far is 0"),
        ("--translate=1,2", "three numbers with commas"),
        ("--lookat=1,2,inf", "three numbers with commas"),
        ("--light=0,0,0", "the direction of the light has no length"),
        ("--light=1,2,3,4", "a light is a direction"),
        ("--light=0,1,0,-1,0,0", "a light is a direction"),
        ("--scatter=1,-1,0", "red, green and blue from 0 to 1e6"),
        ("--background=#12345", "a background is `transparent`"),
        ("--iso=NaN", "--iso must be a finite number"),
        ("--shader=matte", "invalid value"),
    ] {
        fails(&file, &out, &[option], 2, expected);
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
