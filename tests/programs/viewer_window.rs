//! What the viewer does in its window, without one and without a GPU: the modules of the example in an
//! app that nobody draws.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::input::ButtonState;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy::time::TimeUpdateStrategy;
use bevy::window::FileDragAndDrop;
use bevy_egui::egui::accesskit::{Node, Role};
use bevy_panorbit_camera::PanOrbitCamera;
use bevy_vdb::prelude::*;
use bevy_vdb_inspector::VdbInspector;
use vdb_core::pack::PackKind;

use crate::app::Status;
use crate::args::{Args, Part, Shown};
use crate::files::{model, temporary};
use crate::smoke_file;
use crate::viewer_app::Viewer;
use crate::volumes::Label;
use crate::window::Hovering;

#[test]
#[cfg(unix)]
fn a_command_line_says_what_it_was_made_of() {
    let all = Args {
        files: vec!["/a b/it's.vdb".into(), "/plain.vdb".into(), "/$HOME;`ls`.vdb".into()],
        grids: vec!["density".into(), "v[1] *".into()],
        kinds: vec![
            ("density".into(), Shown::Surface { iso: -0.125 }),
            ("a=b".into(), Shown::Surface { iso: 0.0 }),
            ("it's".into(), Shown::Fog),
        ],
        fire: Part::Named("flame's".into()),
        heat: Some([1_500.5, 0.1]),
        glow: Some(1e-7),
        colors: Part::Nothing,
        frame: Some(12),
        out: Some("a picture.png".into()),
        size: UVec2::new(640, 361),
        eye: Some(DVec3::new(-1.5, 1e-7, 3e9)),
        target: Some(DVec3::new(0.1, 0.2, 0.3)),
        mode: VdbRenderMode::HitVoxel,
        density: 0.3,
        sun: DVec3::new(0.0, -1.0, 0.1),
        shadows: false,
        overlays: VdbOverlays { leaves: true, lower: false, upper: true },
        smooth: false,
        ground: true,
        panel: false,
        cpu: true,
        ..default()
    };
    let few = Args { files: vec!["/plain.vdb".into()], ..default() };
    for args in [all, few] {
        let script = format!("printf '%s\\0' {args}");
        let split = Command::new("sh").arg("-c").arg(&script).output().expect("a shell");
        let words = String::from_utf8(split.stdout).expect("UTF-8");
        let words: Vec<&str> = words.trim_end_matches('\0').split('\0').collect();
        let parsed = Args::parse(lexopt::Parser::from_args(words)).expect(&script);
        assert_eq!(parsed.as_ref(), Some(&args), "{script}");
    }
}

#[test]
fn a_dropped_file_takes_the_place_of_what_is_shown() {
    let mut viewer = Viewer::ready(&Viewer::files(&["teapot.vdb"]));
    assert_eq!(viewer.labels(), ["surface"]);
    assert!(viewer.title().starts_with("teapot.vdb: surface, lit"), "{}", viewer.title());
    let before = viewer.get::<Transform>().translation;

    let (window, path_buf) = (viewer.window, model("cloud.vdb"));
    viewer.app.world_mut().write_message(FileDragAndDrop::HoveredFile { window, path_buf });
    viewer.frames(4);
    assert!(viewer.app.world().resource::<Hovering>().0 && viewer.says("Drop it"));
    viewer.drop_file(&model("cloud.vdb"));
    assert!(!viewer.app.world().resource::<Hovering>().0);
    viewer.wait();
    assert_eq!(viewer.labels(), ["density"]);
    assert!(viewer.title().starts_with("cloud.vdb: density, lit"), "{}", viewer.title());
    // All of it is in view: the camera is another.
    let world = viewer.app.world();
    let view = world.resource::<Status>().view.expect("a view");
    let after = viewer.get::<Transform>().translation;
    assert!(after.distance(before) > 0.1 && after.distance(view.eye.as_vec3()) < 1e-3);
    let bounds = {
        let world = viewer.app.world_mut();
        let volume = world.query::<&VdbVolume>().single(world).expect("one volume").0.clone();
        world.resource::<Assets<VdbGrid>>().get(&volume).and_then(VdbGrid::world_bounds)
    };
    assert_eq!(Some(view.bounds), bounds);
}

#[test]
fn what_is_wrong_with_a_file_stands_in_the_window() {
    let mut viewer = Viewer::ready(&Viewer::files(&["teapot.vdb"]));
    let text = temporary("viewer_window", "text.vdb");
    std::fs::write(&text, "this is a text, not a volume, and long enough to be read")
        .expect("written");
    viewer.drop_file(&text);
    viewer.wait();
    assert!(viewer.says("text.vdb: ") && viewer.says("not a VDB file"));
    viewer.click("Close");
    assert!(!viewer.says("not a VDB file"));
    viewer.drop_file(Path::new("/nowhere/missing.vdb"));
    viewer.wait();
    assert!(viewer.says("missing.vdb: no such file"));
    // It is not the end: what comes next is shown.
    viewer.drop_file(&model("teapot.vdb"));
    viewer.wait();
    assert!(!viewer.says("no such file"));
    assert_eq!(viewer.labels(), ["surface"]);
}

#[test]
fn how_far_a_file_is_stands_in_the_window() {
    let mut viewer = Viewer::ready(&Viewer::files(&["teapot.vdb"]));
    // Whoever would decode the file is kept busy.
    let busy = Arc::new(AtomicBool::new(true));
    let held = busy.clone();
    rayon::spawn_broadcast(move |_| {
        while held.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    viewer.drop_file(&model("cloud.vdb"));
    let has_bar = |viewer: &Viewer| {
        let is_bar = |node: &Node| node.role() == Role::ProgressIndicator;
        viewer.says("cloud.vdb: 0.") && viewer.nodes().iter().any(|(_, node)| is_bar(node))
    };
    let mut seen = false;
    for _ in 0..400 {
        viewer.frames(1);
        seen |= has_bar(&viewer) && viewer.title() == "cloud.vdb (loading) - bevy_vdb";
        std::thread::sleep(Duration::from_millis(5));
        if seen {
            break;
        }
    }
    busy.store(false, Ordering::Relaxed);
    assert!(seen, "{}", viewer.title());
    viewer.wait();
    assert!(!has_bar(&viewer) && !viewer.says("loading"));
}

#[test]
fn the_state_comes_back() {
    let mut viewer = Viewer::ready(&Viewer::files(&["teapot.vdb", "cloud.vdb"]));
    let plain = Viewer::files(&["teapot.vdb", "cloud.vdb"]);
    assert_eq!(viewer.args(), plain, "nobody has changed anything");

    viewer.press(KeyCode::Digit7);
    let world = viewer.app.world_mut();
    let eye = Transform::from_xyz(1.0, 2.0, 8.0).looking_at(Vec3::new(0.5, 1.0, 0.0), Vec3::Y);
    world.entity_mut(viewer.camera).remove::<PanOrbitCamera>().insert(eye);
    world.get_mut::<VdbCamera>(viewer.camera).expect("it").overlays.lower = true;
    let mut volumes = world.query::<(&Label, &mut Visibility, &mut VdbMaterial)>();
    for (label, mut visibility, mut material) in volumes.iter_mut(world) {
        if label.name == "surface" {
            *visibility = Visibility::Hidden;
        }
        material.density_scale = 7.5;
    }
    let mut suns = world.query::<(&mut DirectionalLight, &mut Transform)>();
    for (mut light, mut transform) in suns.iter_mut(world) {
        light.shadow_maps_enabled = false;
        transform.look_to(Vec3::new(1.0, -0.5, 0.2), Vec3::Y);
    }
    world.resource_mut::<VdbInspector>().open = false;
    let args = viewer.args();
    assert_eq!((args.mode, args.density), (VdbRenderMode::Normals, 7.5));
    assert_eq!(args.grids, ["density"]);
    assert!(args.overlays.lower && !args.shadows && !args.panel, "{args}");

    // The grid that is asked for is in one of the files alone.
    let args = Args { files: vec![model("cloud.vdb")], ..args };
    let mut again = Viewer::ready(&args);
    let there = again.get::<Transform>();
    assert!(there.translation.distance(eye.translation) < 1e-3, "{there:?}");
    assert!(there.rotation.angle_between(eye.rotation) < 1e-3, "{there:?}");
    let back = again.args();
    assert_eq!(Args { eye: None, target: None, ..back }, Args { eye: None, target: None, ..args });
}

#[test]
fn grids_play_the_parts_that_their_names_suggest() {
    let path = temporary("viewer_window", "roles.vdb");
    smoke_file::save(&path);
    let plain = Args { files: vec![path.clone()], ..default() };
    let mut viewer = Viewer::ready(&plain);
    let all = ["density", "flame", "fuel", "phi_obstacle", "surface", "temperature"];
    assert_eq!(viewer.labels(), all);
    assert_eq!(viewer.roles(), ["density + temperature", "surface, Cd"]);
    assert_eq!(viewer.args(), plain);
    let Some(VdbEmission::Temperature { scale, offset, strength, .. }) = viewer.fire() else {
        panic!("no fire")
    };
    assert_eq!((scale, offset), (1_000.0, 0.0), "1 stands for 1,000 K");
    assert!(strength.is_finite() && strength > 0.0, "{strength}");

    // All of it comes back as it is changed by hand.
    let change = |viewer: &mut Viewer, change: &dyn Fn(&mut World, &[(String, Entity)])| {
        let world = viewer.app.world_mut();
        let mut volumes = world.query::<(&Label, Entity)>();
        let volumes: Vec<_> =
            volumes.iter(world).map(|(label, entity)| (label.name.clone(), entity)).collect();
        change(world, &volumes);
        viewer.frames(2);
        let args = viewer.args();
        let mut again = Viewer::ready(&args);
        assert_eq!(again.roles(), viewer.roles(), "{args}");
        assert_eq!(again.fire(), viewer.fire().map(|fire| same(fire, &mut again)), "{args}");
        assert_eq!(again.args(), args);
        args
    };
    // The grids of another app are others.
    fn same(mut fire: VdbEmission, again: &mut Viewer) -> VdbEmission {
        if let (
            VdbEmission::Temperature { grid, .. },
            Some(VdbEmission::Temperature { grid: other, .. }),
        ) = (&mut fire, again.fire())
        {
            *grid = other;
        }
        fire
    }
    let of = |volumes: &[(String, Entity)], name: &str| {
        volumes.iter().find(|(own, _)| own == name).expect("the volume").1
    };
    let args = change(&mut viewer, &|world, volumes| {
        let mut smoke = world.entity_mut(of(volumes, "density"));
        let mut fire = smoke.get_mut::<VdbEmission>().expect("fire");
        if let VdbEmission::Temperature { scale, offset, strength, .. } = &mut *fire {
            (*scale, *offset, *strength) = (1_234.5, 0.1, 1e-5);
        }
    });
    assert_eq!(
        (&args.fire, args.heat, args.glow),
        (&Part::ByName, Some([1_234.5, 0.1]), Some(1e-5))
    );
    let args = change(&mut viewer, &|world, volumes| {
        world.entity_mut(of(volumes, "density")).remove::<VdbEmission>();
        world.entity_mut(of(volumes, "surface")).remove::<VdbColorGrid>();
    });
    assert_eq!((&args.fire, &args.colors), (&Part::Nothing, &Part::Nothing));
    assert_eq!(viewer.roles(), ["density", "surface"]);
    let args = change(&mut viewer, &|world, volumes| {
        let fuel = world.get::<VdbVolume>(of(volumes, "fuel")).expect("it").0.clone();
        let grid = world.resource::<Assets<VdbGrid>>().get(&fuel).expect("it");
        let guess = VdbEmission::guess(fuel, grid);
        world.entity_mut(of(volumes, "density")).insert(guess);
        world.entity_mut(of(volumes, "surface")).insert(Visibility::Hidden);
    });
    assert_eq!((&args.fire, args.glow), (&Part::Named("fuel".into()), None));
    assert_eq!(args.grids, ["density"]);
    assert_eq!(viewer.roles(), ["density + fuel"]);
    // As something else than its class says.
    let args = change(&mut viewer, &|world, volumes| {
        let volume = of(volumes, "density");
        let handle = world.get::<VdbVolume>(volume).expect("it").0.clone();
        let mut grids = world.resource_mut::<Assets<VdbGrid>>();
        let kind = PackKind::Smooth { iso: 0.5 };
        let other = grids.get(&handle).expect("it").clone().with_kind(kind).expect("a surface");
        let other = grids.add(other);
        world.entity_mut(volume).insert(VdbVolume(other));
    });
    assert_eq!(args.kinds, [("density".into(), Shown::Surface { iso: 0.5 })]);

    let missing = Args { fire: Part::Named("lava".into()), ..plain };
    let viewer = Viewer::ready(&missing);
    assert!(viewer.says("--fire lava: no file has such a grid"));
}

#[test]
fn the_camera_flies_as_fast_at_any_frame_rate() {
    let flown = |frames: u32| {
        let mut viewer = Viewer::ready(&Viewer::files(&["teapot.vdb"]));
        viewer.press(KeyCode::KeyF);
        let orbits = viewer.app.world().get::<PanOrbitCamera>(viewer.camera).is_some();
        assert!(!orbits, "the mouse does not turn it round as well");
        let before = *viewer.get::<Transform>();
        let step = Duration::from_millis(600) / frames;
        viewer.app.insert_resource(TimeUpdateStrategy::ManualDuration(step));
        viewer.key(KeyCode::KeyW, ButtonState::Pressed);
        viewer.frames(frames as usize);
        let after = *viewer.get::<Transform>();
        viewer.key(KeyCode::KeyW, ButtonState::Released);
        viewer.press(KeyCode::KeyF);
        let orbit = viewer.get::<PanOrbitCamera>();
        let ahead = (orbit.focus - after.translation).normalize();
        assert!(ahead.distance(*after.forward()) < 1e-3, "it turns about what is ahead");
        let way = after.translation - before.translation;
        assert!(way.normalize().distance(*before.forward()) < 1e-3, "{way}");
        way.length()
    };
    let (few, many) = (flown(4), flown(60));
    assert!(few > 0.1 && (few / many - 1.0).abs() < 1e-3, "{few} {many}");
}

#[test]
fn keys_do_what_the_list_says() {
    let mut viewer = Viewer::ready(&Viewer::files(&["teapot.vdb"]));
    assert!(!viewer.says("this list"));
    viewer.press(KeyCode::F1);
    assert!(viewer.says("this list") && viewer.says("fly forwards"));
    let modes: Vec<_> = VdbRenderMode::ALL.iter().map(|mode| mode.name()).collect();
    assert!(viewer.says(&modes.join(", ")), "{modes:?}");
    viewer.press(KeyCode::F1);
    assert!(!viewer.says("this list"));
    viewer.press(KeyCode::Digit9);
    assert_eq!(viewer.get::<VdbCamera>().mode, VdbRenderMode::Steps);
    assert_eq!(*viewer.get::<Tonemapping>(), Tonemapping::None);
    viewer.press(KeyCode::Digit1);
    assert_eq!(*viewer.get::<Tonemapping>(), Tonemapping::KhronosPbrNeutral);
    assert!(viewer.says("Performance"));
    viewer.press(KeyCode::F2);
    assert!(!viewer.says("Performance"));

    let home = viewer.get::<Transform>().translation;
    viewer.press(KeyCode::KeyF);
    viewer.app.world_mut().get_mut::<Transform>(viewer.camera).expect("it").translation += 9.0;
    viewer.press(KeyCode::Home);
    assert!(viewer.get::<Transform>().translation.distance(home) < 1e-3);
    assert!(viewer.app.world().get::<PanOrbitCamera>(viewer.camera).is_some());
}
