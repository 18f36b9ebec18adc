//! Materials that are added, changed and mended while the app runs.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::*;
use crate::common::Picture;
use crate::log::{listen, said};

/// Volumes are in every frame, with and without a material that has just been added.
#[gpu_test]
fn no_frame_is_blank_while_a_material_is_compiled() {
    let mut stage = Stage::compiling_beside_with(add_materials);
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    let volume = stage.world().spawn((VdbVolume(grid), glow(GREEN))).id();
    assert!(is_green(stage.picture(&target).center()));
    let red = Painted { emissive: Vec3::X, ..default() };
    stage.world().entity_mut(volume).insert(red);
    let (frames, waited) = stage.frames_until_settled(&target);
    assert!(waited > 0, "nothing was compiled");
    let center = |frame: &Picture| frame.center();
    assert!(frames.iter().map(center).all(|pixel| is_green(pixel) || is_red(pixel)));
    assert!(is_red(frames.last().unwrap().center()));
}

/// When a function changes, frames with the one before leave the mean.
#[gpu_test]
fn a_new_function_leaves_nothing_of_the_old_in_the_mean() {
    let mut stage = Stage::compiling_beside_with(add_materials);
    let target = stage.target(SIZE);
    let camera = stage.camera(&target, looking(Vec3::Z * 6.0));
    stage.world().entity_mut(camera).insert(VdbQuality { accumulate: 64, ..default() });
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    stage.world().spawn((VdbVolume(grid), glow(GREEN), Unchanged {}));
    let before = stage.picture(&target);
    assert!(is_green(before.center()));
    stage.update(8);
    let red = "#import bevy_vdb::material::{VdbHit, VdbSurface}
        fn surface(hit: VdbHit, built_in: VdbSurface) -> VdbSurface {
            var changed = built_in;
            changed.emissive = vec3(1.0, 0.0, 0.0);
            return changed;
        }";
    let mut shaders = stage.world().resource_mut::<Assets<Shader>>();
    shaders.insert(UNCHANGED.id(), Shader::from_wgsl(red, "unchanged.wgsl")).unwrap();
    let (frames, _) = stage.frames_until_settled(&target);
    assert!(is_green(frames[0].center()), "the change came before it was waited for");
    let last = frames.last().unwrap().center();
    assert!(last.y == 0.0 && is_red(last), "{last} has green of the frames before");
}

/// A material whose shader is in a file.
#[derive(Clone, Component, Reflect)]
struct Watched {
    color: LinearRgba,
}

impl VdbMaterialExtension for Watched {
    fn shader() -> ShaderRef {
        "watched_material.wgsl".into()
    }
}

/// The body of the function, on line 4 of the file.
fn watched(body: &str) -> String {
    format!(
        "#import bevy_vdb::material::{{VdbHit, VdbSurface, Watched}}\n\nfn surface(hit: VdbHit, built_in: \
         VdbSurface, own: Watched) -> VdbSurface {{\n    {body}\n}}\n"
    )
}

/// Whatever is wrong with a shader is said once, with its file and line, and the picture stays; when the file is
/// mended, the picture is of the new function.
#[gpu_test]
#[ignore = "slow: each error compiles a function"]
fn errors_name_the_line_and_leave_the_picture() {
    listen();
    let name = "watched_material.wgsl";
    let folder = std::env::temp_dir().join(format!("bevy_vdb_material_{}", std::process::id()));
    fs::remove_dir_all(&folder).ok();
    fs::create_dir_all(&folder).unwrap();
    let path: PathBuf = folder.join(name);
    // It is broken from the beginning.
    fs::write(&path, watched("return built_in + nothing;")).unwrap();
    let mut stage = Stage::watching(&folder, |app| {
        app.add_plugins(VdbMaterialPlugin::<Watched>::default());
    });
    let target = stage.target(SIZE);
    stage.camera(&target, looking(Vec3::Z * 6.0));
    let grid = stage.grid(level_set::sphere(DVec3::ZERO, 40.0), SMOOTH, 0.05);
    let material = Watched { color: LinearRgba::rgb(1.0, 0.0, 0.0) };
    stage.world().spawn((VdbVolume(grid), glow(GREEN), material));
    let mut heard = 0;
    // What is said within longer than the watcher takes or, if something has to be, after that.
    let mut news = |stage: &mut Stage, is_due: bool| {
        let begin = Instant::now();
        let mut end = begin + Duration::from_secs(2);
        while Instant::now() < end {
            stage.update(1);
            std::thread::sleep(Duration::from_millis(5));
            let is_late = begin.elapsed() > Duration::from_secs(60);
            if is_due && said(name).len() == heard && !is_late {
                end = Instant::now() + Duration::from_secs(1);
            }
        }
        let all = said(name);
        let news = all[heard..].to_vec();
        heard = all.len();
        news
    };
    // The middle of the picture, once it holds or has had time enough.
    let until = |stage: &mut Stage, target: &Handle<Image>, holds: fn(Vec4) -> bool| {
        let end = Instant::now() + Duration::from_secs(60);
        loop {
            let picture = stage.picture(target);
            if holds(picture.center()) || Instant::now() > end {
                return picture;
            }
        }
    };
    let line = |said: &[String], line: u32| {
        assert_eq!(said.len(), 1, "{said:#?}");
        assert!(said[0].contains(&format!("{name}:{line}:")), "{said:#?}");
    };
    line(&news(&mut stage, true), 4);
    assert!(is_green(stage.picture(&target).center()), "a broken shader took the volume away");

    let sound =
        "var own_surface = built_in; own_surface.emissive = own.color.rgb; return own_surface;";
    fs::write(&path, watched(sound)).unwrap();
    let red = until(&mut stage, &target, is_red);
    assert_eq!(news(&mut stage, false), Vec::<String>::new());
    assert!(is_red(red.center()), "the function is not called: {}", red.center());

    for (broken, expected) in [
        (watched("return nothing;"), ":4:"),
        (watched("let a: u32 = 1.5; return built_in;"), ":4:"),
        (watched("return built_in").replace("}\n", ""), name),
        ("fn elsewhere() {}\n".to_owned(), "no function surface"),
        ("fn surface() -> f32 { return 1.0; }\n".to_owned(), "its functions are not surface"),
        (
            "@group(0) @binding(7) var<uniform> extra: vec4<f32>;\n".to_owned()
                + &watched("var s = built_in; s.emissive = extra.rgb; return s;"),
            "cannot have bindings of their own",
        ),
    ] {
        fs::write(&path, &broken).unwrap();
        let said = news(&mut stage, true);
        assert!(said.len() == 1 && said[0].contains(expected), "{broken}: {said:#?}");
        assert!(stage.picture(&target) == red, "{broken}: the picture is another");
    }
    fs::write(&path, watched(&sound.replace("own.color.rgb", "own.color.brg"))).unwrap();
    let green = until(&mut stage, &target, is_green).center();
    assert_eq!(news(&mut stage, false), Vec::<String>::new());
    assert!(is_green(green), "the mended function is not called: {green}");
    fs::remove_dir_all(folder).unwrap();
}
