//! The panel without a window and without a GPU, through what it tells screen readers: what is not
//! found there cannot be used by keyboard either.

#[path = "../../../../tests/common/files.rs"]
mod files;
#[path = "../../../../tests/common/headless.rs"]
mod headless;
mod models;
mod panel;
mod ramp;
#[path = "../../../../tests/common/sequence_files.rs"]
mod sequence_files;
#[path = "../../../../tests/common/smoke_file.rs"]
mod smoke_file;
mod timeline;

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_egui::egui::accesskit::{Action, Role};
use bevy_vdb::prelude::*;
use bevy_vdb::{VdbGpuMemory, VdbGpuUsage};
use bevy_vdb_inspector::VdbInspector;

use panel::Panel;

#[test]
fn the_panel_opens_and_closes() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    panel.click(Role::Button, "Grid");
    panel.look();
    for section in [
        "Performance",
        "Memory",
        "Volumes",
        "Grids of the file",
        "Grid",
        "Material",
        "Ramp",
        "Camera",
        "Quality",
        "Sun",
        "Tools",
    ] {
        assert!(panel.find(Role::Button, section).is_some(), "{section}");
    }
    let shown = panel.nodes.iter().filter_map(|(_, node)| node.value()).collect::<Vec<_>>();
    // What the grid of this test has.
    for text in ["\"blob\", level set", "2", "1.000 1.000 1.000"] {
        assert!(shown.contains(&text), "{text} in {shown:?}");
    }
    panel.click(Role::Button, "Close window");
    assert!(!panel.world().resource::<VdbInspector>().open);
    panel.look();
    assert!(panel.find(Role::Button, "Volumes").is_none());
    panel.world().resource_mut::<ButtonInput<KeyCode>>().press(KeyCode::F2);
    panel.app.world_mut().run_schedule(Update);
    panel.look();
    assert!(panel.find(Role::Button, "Volumes").is_some(), "F2 opens it again");
}

#[test]
fn controls_of_a_camera_change_that() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    let camera = panel.camera;
    for &mode in VdbRenderMode::ALL.iter().rev() {
        panel.choose("mode", mode.name());
        assert_eq!(panel.get::<VdbCamera>(camera).mode, mode);
    }
    panel.choose("mode", "maximum");
    panel.slide("value shown in white", 2.0);
    panel.choose("mode", "steps");
    panel.slide("steps shown in red", 50.0);
    panel.click(Role::CheckBox, "leaves");
    panel.click(Role::CheckBox, "4,096³");
    panel.click(Role::CheckBox, "shadows on meshes");
    panel.click(Role::CheckBox, "multiple scattering");
    panel.click(Role::CheckBox, "shows volumes");
    panel.click(Role::Button, "Quality");
    panel.click(Role::Button, "exact");
    panel.click(Role::Button, "balanced");
    panel.click(Role::CheckBox, "shadows");
    panel.slide("reflections", 3.0);
    panel.click(Role::CheckBox, "exact fog, cell by cell");
    panel.click(Role::CheckBox, "exact fog, cell by cell");
    panel.slide("voxels per sample", 4.0);
    panel.slide("error of light in fog", 0.05);
    panel.slide("detail, pixels per voxel", 1.5);
    panel.slide("resolution", 0.5);
    panel.choose("further rays on edges", "8");
    panel.slide("accumulated frames", 16.0);
    panel.click(Role::Button, "measure features");
    assert!(panel.app.world().get::<VdbMeasureFeatures>(camera).is_some());
    panel.choose("rays", "HDDA");
    let expected = VdbCamera {
        enabled: false,
        mode: VdbRenderMode::Steps,
        mesh_shadows: false,
        overlays: VdbOverlays { leaves: true, lower: false, upper: true },
        multiple_scattering: false,
        steps_scale: 50.0,
        maximum_scale: 2.0,
    };
    assert_eq!(panel.get::<VdbCamera>(camera), &expected);
    let expected = VdbQuality {
        traversal: VdbTraversal::Hdda,
        shadows: false,
        reflections: 3,
        fog_step: 4.0,
        fog_light_error: 0.05,
        detail: 1.5,
        resolution: 0.5,
        edge_samples: 8,
        accumulate: 16,
        ..VdbQuality::BALANCED
    };
    assert_eq!(panel.get::<VdbQuality>(camera), &expected);
}

/// From rays, which is 0, over the least error of the light cache to the greatest.
#[test]
fn the_error_of_light_in_fog_is_set_by_keyboard() {
    let mut panel = Panel::new(PackKind::Fog);
    let camera = panel.camera;
    let error = |panel: &Panel| panel.get::<VdbQuality>(camera).fog_light_error;
    panel.click(Role::Button, "Quality");
    panel.slide("error of light in fog", 0.0);
    assert_eq!(error(&panel), 0.0);
    panel.ask(Role::Slider, "error of light in fog", Action::Focus, None);
    let mut last = 0.0;
    for _ in 0..4 {
        panel.press(egui::Key::ArrowRight);
        // The slider is a hundred points long and more, for two powers of ten.
        assert!((0.002..0.0025).contains(&error(&panel)), "{}", error(&panel));
        assert!(error(&panel) > last, "{last} stays");
        last = error(&panel);
    }
    panel.slide("error of light in fog", 0.7);
    assert_eq!(error(&panel), 0.2);
}

#[test]
fn controls_of_a_surface_change_its_material() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    panel.slide("roughness", 0.25);
    panel.slide("metallic", 0.75);
    panel.slide("reflectance", 1.0);
    panel.slide("emissive", 10.0);
    let volume = panel.volume;
    let expected = VdbMaterial {
        perceptual_roughness: 0.25,
        metallic: 0.75,
        reflectance: 1.0,
        emissive: LinearRgba::rgb(10.0, 10.0, 10.0),
        ..default()
    };
    assert_eq!(panel.get::<VdbMaterial>(volume), &expected);
    assert!(panel.find(Role::Slider, "density scale").is_none(), "that is for fog");
    panel.click(Role::CheckBox, "show blob");
    assert_eq!(panel.get::<Visibility>(volume), Visibility::Hidden);
    panel.click(Role::CheckBox, "show blob");
    assert_eq!(panel.get::<Visibility>(volume), Visibility::Inherited);
}

#[test]
fn controls_of_fog_change_its_material() {
    let mut panel = Panel::new(PackKind::Fog);
    panel.slide("density scale", 40.0);
    panel.slide("anisotropy", -0.5);
    let expected = VdbMaterial { density_scale: 40.0, anisotropy: -0.5, ..default() };
    assert_eq!(panel.get::<VdbMaterial>(panel.volume), &expected);
}

#[test]
fn controls_of_the_sun_change_that() {
    let mut panel = Panel::new(PackKind::Fog);
    panel.click(Role::CheckBox, "casts shadows");
    panel.slide("illuminance", 20_000.0);
    panel.slide("× on volumes", 2.5);
    let light = panel.get::<DirectionalLight>(panel.sun);
    assert_eq!((light.shadow_maps_enabled, light.illuminance), (true, 20_000.0));
    assert_eq!(panel.get::<VdbSun>(panel.sun), &VdbSun { intensity: 2.5, ..default() });
}

#[test]
fn the_ball_turns_the_sun() {
    let mut panel = Panel::new(PackKind::Fog);
    // The camera looks to the side: right of it is -z.
    let side = Transform::default().looking_to(Vec3::X, Vec3::Y);
    panel.app.world_mut().entity_mut(panel.camera).insert(side);
    let to_sun = |panel: &Panel| *panel.get::<Transform>(panel.sun).back();
    let toward = |panel: &mut Panel, to: Vec3| {
        let turned = Transform::default().looking_to(-to, Vec3::Y);
        panel.app.world_mut().entity_mut(panel.sun).insert(turned);
        panel.look();
    };
    toward(&mut panel, Vec3::new(-1.0, 0.0, 1.0));
    panel.ask(Role::Unknown, "direction of the sun", Action::Focus, None);
    panel.look();
    let ball = panel.find(Role::Unknown, "direction of the sun").expect("the ball").0;
    assert_eq!(panel.focus, ball);
    let before = to_sun(&panel);
    panel.press(egui::Key::ArrowUp);
    let up = to_sun(&panel);
    assert!(up.y > before.y + 0.05, "{before} {up}");
    panel.press(egui::Key::ArrowDown);
    assert!(to_sun(&panel).distance(before) < 1e-4);
    let across = |v: Vec3| v.dot(Vec3::Z);
    panel.press(egui::Key::ArrowRight);
    assert!(across(to_sun(&panel)) > across(before) + 0.05, "{before} {}", to_sun(&panel));
}

#[test]
fn a_grid_is_shown_otherwise() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    let kind = |panel: &mut Panel| {
        let volume = panel.get::<VdbVolume>(panel.volume).0.clone();
        panel.world().resource::<Assets<VdbGrid>>().get(&volume).map(VdbGrid::kind)
    };
    for (name, expected) in [
        ("fog", PackKind::Fog),
        ("voxels", PackKind::Surface { iso: 0.0 }),
        ("smooth surface", PackKind::Smooth { iso: 0.0 }),
    ] {
        panel.choose("shown as", name);
        for _ in 0..200 {
            if kind(&mut panel) == Some(expected) {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
            panel.frames(1);
        }
        assert_eq!(kind(&mut panel), Some(expected));
    }
}

#[test]
fn all_controls_are_reached_by_keyboard() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    panel.look();
    let mut reached = Vec::new();
    for _ in 0..200 {
        panel.press(egui::Key::Tab);
        panel.look();
        if reached.contains(&panel.focus) {
            break;
        }
        reached.push(panel.focus);
    }
    let roles = [Role::Button, Role::CheckBox, Role::ComboBox, Role::Slider, Role::ColorWell];
    let controls: Vec<_> =
        panel.nodes.iter().filter(|(_, node)| roles.contains(&node.role())).collect();
    assert!(controls.len() > 20, "{}", controls.len());
    for (id, node) in controls {
        assert!(reached.contains(id), "{:?} {:?}", node.role(), panel.name(node));
    }
    let ball = panel.find(Role::Unknown, "direction of the sun").expect("the ball");
    assert!(reached.contains(&ball.0), "the ball");
    // And used.
    panel.ask(Role::CheckBox, "shows volumes", Action::Focus, None);
    panel.press(egui::Key::Space);
    assert!(!panel.get::<VdbCamera>(panel.camera).enabled);
}

#[test]
fn what_nobody_changes_stays_as_it_is() {
    let mut panel = Panel::new(PackKind::Fog);
    // Beyond what the sliders have, and no numbers at all.
    let odd = VdbMaterial { density_scale: 5e4, anisotropy: 7.0, ..default() };
    panel.app.world_mut().entity_mut(panel.volume).insert(odd.clone());
    let bright = DirectionalLight { illuminance: 1e9, ..default() };
    panel.app.world_mut().entity_mut(panel.sun).insert(bright);
    panel.frames(2);
    panel.click(Role::Button, "Quality");
    panel.app.init_resource::<Changes>().add_systems(
        Last,
        |materials: Query<(), Changed<VdbMaterial>>,
         cameras: Query<(), Or<(Changed<VdbCamera>, Changed<VdbQuality>)>>,
         suns: Query<(), Or<(Changed<DirectionalLight>, Changed<Transform>)>>,
         volumes: Query<(), Or<(Changed<VdbVolume>, Changed<Visibility>)>>,
         mut changes: ResMut<Changes>| {
            changes.0.push(
                materials.iter().count()
                    + cameras.iter().count()
                    + suns.iter().count()
                    + volumes.iter().count(),
            );
        },
    );
    panel.look();
    let changes = &panel.world().resource::<Changes>().0;
    // In the first frame the system sees everything as new.
    assert!(changes[0] > 0 && changes[1..].iter().all(|count| *count == 0), "{changes:?}");
    assert_eq!(panel.get::<VdbMaterial>(panel.volume), &odd);
    let no_number = VdbMaterial { density_scale: f32::NAN, ..default() };
    panel.app.world_mut().entity_mut(panel.volume).insert(no_number);
    panel.look();
}

#[derive(Default, Resource)]
struct Changes(Vec<usize>);

#[test]
fn memory_on_the_gpu_is_shown_beside_its_limits() {
    let mut panel = Panel::new(PackKind::Fog);
    panel.app.insert_resource(VdbGpuUsage::default());
    panel.app.insert_resource(VdbGpuMemory {
        max_bytes: 512_000_000,
        idle_bytes: 64_000_000,
        upload_bytes_per_frame: 8_000_000,
        ..default()
    });
    panel.click(Role::Button, "Memory");
    panel.look();
    let shown: Vec<&str> = panel.nodes.iter().filter_map(|(_, node)| node.value()).collect();
    let rows = ["0 displayed, 0 idle", "512.0 MB", "0.0 of 64.0 MB", "0.0 of 8.0 MB"];
    for text in rows {
        assert!(shown.contains(&text), "{text} in {shown:?}");
    }
}
