//! The panel without a window and without a GPU, through what it tells screen readers: what is not
//! found there cannot be used by keyboard either.

#[path = "../../../tests/common/files.rs"]
mod files;
#[path = "../../../tests/common/headless.rs"]
mod headless;
#[path = "../../../tests/common/smoke_file.rs"]
mod smoke_file;

use bevy::asset::{AssetPlugin, UnapprovedPathMode};
use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy_egui::egui::accesskit::{Action, ActionData, ActionRequest, Node, NodeId, Role, TreeId};
use bevy_egui::{EguiContext, EguiInput, EguiOutput, EguiPreUpdateSet, egui};
use bevy_vdb::prelude::*;
use bevy_vdb_inspector::{VdbInspector, VdbInspectorPlugin, VdbModelPicked};
use vdb_core::pack::PackKind;
use vdb_core::tree::Vdb543;

const WINDOW: egui::Vec2 = egui::vec2(1280.0, 720.0);

/// An app with the panel, and what the panel showed in the last frame.
struct Panel {
    app: App,
    camera: Entity,
    sun: Entity,
    volume: Entity,
    nodes: Vec<(NodeId, Node)>,
    focus: NodeId,
}

impl Panel {
    fn new(kind: PackKind) -> Self {
        Self::with(kind, VdbInspectorPlugin::default())
    }

    fn with(kind: PackKind, plugin: VdbInspectorPlugin) -> Self {
        let mut app = App::new();
        let file_path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets").into();
        let unapproved_path_mode = UnapprovedPathMode::Allow;
        let assets = AssetPlugin { file_path, unapproved_path_mode, ..default() };
        app.add_plugins((headless::plugins(None, assets), VdbRenderPlugin, plugin));
        // A window would have the keyboard.
        app.add_systems(
            PreUpdate,
            (|mut inputs: Query<&mut EguiInput>| {
                inputs.iter_mut().for_each(|mut input| input.focused = true);
            })
            .after(EguiPreUpdateSet::ProcessInput),
        );
        app.finish();
        app.cleanup();
        let mut tree = Vdb543::new(1.0);
        tree.set(IVec3::new(3, 4, 5), -1.0);
        tree.set(IVec3::new(3, 4, 200), 0.5);
        let grid = VdbGrid::new("blob", tree, DAffine3::IDENTITY, kind).unwrap();
        let grid = app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid);
        let volume = app.world_mut().spawn(VdbVolume(grid)).id();
        let sun = app.world_mut().spawn(DirectionalLight::default()).id();
        let camera = app.world_mut().spawn(Camera3d::default()).id();
        let mut panel = Self { app, camera, sun, volume, nodes: Vec::new(), focus: NodeId(0) };
        panel.frames(2);
        let mut context = panel.world().get_mut::<EguiContext>(camera).expect("a context");
        context.get_mut().enable_accesskit();
        context.get_mut().all_styles_mut(|style| style.animation_time = 0.0);
        panel.frames(3);
        panel
    }

    fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }

    fn get<C: Component>(&self, entity: Entity) -> &C {
        self.app.world().get(entity).expect("the component is there")
    }

    fn frames(&mut self, frames: usize) {
        for _ in 0..frames {
            self.frame([]);
        }
    }

    fn frame<const N: usize>(&mut self, events: [egui::Event; N]) {
        let camera = self.camera;
        if let Some(mut input) = self.world().get_mut::<EguiInput>(camera) {
            input.screen_rect = Some(egui::Rect::from_min_size(egui::Pos2::ZERO, WINDOW));
            input.events.extend(events);
        }
        self.app.update();
    }

    /// Runs frames until nothing moves any more, and notes what is shown.
    fn look(&mut self) {
        self.frames(4);
        let output = self.app.world().get::<EguiOutput>(self.camera).expect("there is a context");
        let update = output.platform_output.accesskit_update.clone();
        let update = update.expect("screen readers are told");
        (self.nodes, self.focus) = (update.nodes, update.focus);
    }

    /// What a control is called: by itself, or by a label beside it.
    fn name(&self, node: &Node) -> Option<String> {
        let of = |id: &NodeId| self.nodes.iter().find(|(other, _)| other == id);
        let beside = || of(node.labelled_by().first()?)?.1.value();
        node.label().or_else(beside).map(str::to_owned)
    }

    fn find(&self, role: Role, name: &str) -> Option<&(NodeId, Node)> {
        let is_it = |node: &Node| node.role() == role && self.name(node).as_deref() == Some(name);
        self.nodes.iter().find(|(_, node)| is_it(node))
    }

    fn ask(&mut self, role: Role, name: &str, action: Action, data: Option<ActionData>) {
        self.look();
        let Some((target_node, _)) = self.find(role, name) else {
            panic!("there is no {role:?} {name:?}");
        };
        let (target_tree, target_node) = (TreeId::ROOT, *target_node);
        let request = ActionRequest { action, target_tree, target_node, data };
        self.frame([egui::Event::AccessKitActionRequest(request)]);
        self.frames(3);
    }

    fn click(&mut self, role: Role, name: &str) {
        self.ask(role, name, Action::Click, None);
    }

    fn slide(&mut self, name: &str, to: f64) {
        self.ask(Role::Slider, name, Action::SetValue, Some(ActionData::NumericValue(to)));
    }

    fn choose(&mut self, name: &str, what: &str) {
        self.click(Role::ComboBox, name);
        self.click(Role::Button, what);
    }

    fn press(&mut self, key: egui::Key) {
        let (physical_key, modifiers) = (None, egui::Modifiers::NONE);
        let event =
            |pressed| egui::Event::Key { key, physical_key, pressed, repeat: false, modifiers };
        self.frame([event(true), event(false)]);
        self.frames(2);
    }
}

#[test]
fn the_panel_opens_and_closes() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    panel.click(Role::Button, "Grid");
    panel.look();
    for section in [
        "Performance",
        "Volumes",
        "Grids of the file",
        "Grid",
        "Material",
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

/// Names and metadata of a file that hide, turn round or forge what stands there.
#[test]
fn text_of_files_is_escaped() {
    let name = "\u{1b}[2J\u{202e}x\nblob, level set";
    let folder = std::env::temp_dir().join(format!("bevy_vdb_panel_text_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("text.vdb");
    let mut tree = Vdb543::new(0.0_f32);
    tree.set(IVec3::ONE, 1.0);
    let mut grids = ["", "2"].map(|end| {
        vdb_core::Grid::new(format!("{name}{end}"), vdb_core::AnyTree::Float(tree.clone().into()))
    });
    grids[0].metadata.insert(name, vdb_core::MetaValue::String(name.into()));
    let file = vdb_core::VdbFile::new(grids.into());
    file.save(&path, &vdb_core::WriteOptions::default()).unwrap();
    let mut panel = Panel::new(PackKind::Fog);
    let handle: Handle<VdbFile> = panel.world().resource::<AssetServer>().load(path);
    let start = std::time::Instant::now();
    let file = loop {
        panel.frame([]);
        if let Some(file) = panel.world().resource::<Assets<VdbFile>>().get(&handle) {
            break file.clone();
        }
        assert!(start.elapsed() < std::time::Duration::from_secs(60), "the file did not come");
    };
    let volume = panel.volume;
    panel.world().entity_mut(volume).insert(VdbVolume(file.grids[0].clone()));
    panel.click(Role::Button, "Grid");
    panel.look();
    let metadata = panel.nodes.iter().filter_map(|(_, node)| node.label());
    let metadata = metadata.filter(|label| label.starts_with("Metadata")).map(str::to_owned).next();
    panel.click(Role::Button, &metadata.expect("the grid has metadata"));
    panel.look();
    let shown = panel.nodes.iter().flat_map(|(_, node)| [node.label(), node.value()]).flatten();
    let shown: Vec<&str> = shown.collect();
    let escaped = shown.iter().filter(|text| text.contains(r"\u{1b}[2J\u{202e}x\nblob")).count();
    // The volume, its grid among those of the file, the name of the grid, and what its metadata say.
    assert!(escaped >= 5, "{shown:?}");
    for text in shown {
        // The panel's own breaks of lines are between numbers.
        let raw = text.contains(['\u{1b}', '\u{202e}']) || text.contains("\nblob");
        assert!(!raw, "{text:?}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn controls_of_a_camera_change_that() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    let camera = panel.camera;
    for &mode in VdbRenderMode::ALL.iter().rev() {
        panel.choose("mode", mode.name());
        assert_eq!(panel.get::<VdbCamera>(camera).mode, mode);
    }
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
fn models_of_the_assets_are_listed_and_shown() {
    let picked = |panel: &mut Panel| {
        for _ in 0..200 {
            panel.frames(1);
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        panel.choose("model", "models/cloud.vdb");
    };
    let path = |panel: &Panel| {
        panel.get::<VdbVolume>(panel.volume).0.path().map(|path| path.path().to_owned())
    };
    let mut panel = Panel::new(PackKind::Fog);
    picked(&mut panel);
    for _ in 0..2_000 {
        if path(&panel).is_some() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
        panel.frames(1);
    }
    assert_eq!(path(&panel).as_deref(), Some("models/cloud.vdb".as_ref()));

    // Where the app has it in hand, it is told, and nothing else happens.
    let mut panel = Panel::with(PackKind::Fog, VdbInspectorPlugin { replaces_models: false });
    panel.app.init_resource::<Told>().add_systems(
        Update,
        |mut picked: MessageReader<VdbModelPicked>, mut told: ResMut<Told>| {
            told.0.extend(picked.read().map(|model| model.path.to_string()));
        },
    );
    picked(&mut panel);
    panel.frames(200);
    assert_eq!(panel.world().resource::<Told>().0, ["models/cloud.vdb"]);
    assert_eq!(path(&panel), None);
}

#[derive(Default, Resource)]
struct Told(Vec<String>);

#[test]
fn the_grids_of_a_file_are_picked_for_their_parts() {
    let mut panel = Panel::new(PackKind::Fog);
    panel.look();
    assert!(panel.find(Role::ComboBox, "fire").is_none(), "a grid made in memory has no others");
    let path = files::temporary("inspector", "roles.vdb");
    smoke_file::save(&path);
    let volume = panel.volume;
    let message = VdbModelPicked { path: path.into(), volume: Some(volume) };
    panel.world().write_message(message);
    fn label<A: Asset>(handle: &Handle<A>) -> String {
        handle.path().and_then(|path| path.label()).unwrap_or_default().to_owned()
    }
    let shown = |panel: &Panel| label(&panel.get::<VdbVolume>(volume).0);
    let fire = |panel: &Panel| match panel.app.world().get::<VdbEmission>(volume) {
        Some(VdbEmission::Temperature { grid, .. }) => label(grid),
        Some(VdbEmission::Color { grid, .. }) => label(grid),
        _ => String::new(),
    };
    let colors = |panel: &Panel| {
        panel.app.world().get::<VdbColorGrid>(volume).map(|colors| label(&colors.0))
    };
    for _ in 0..2_000 {
        if shown(&panel) == "surface" {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
        panel.frames(1);
    }
    // What it is by its names: here, a surface and its colours.
    assert_eq!((shown(&panel).as_str(), colors(&panel).as_deref()), ("surface", Some("Cd")));
    panel.choose("colours", "none");
    assert_eq!(colors(&panel), None);
    panel.choose("grid", "density");
    assert_eq!(shown(&panel), "density");
    for (pick, source) in [("temperature", "temperature"), ("Cd", "Cd"), ("fuel", "fuel")] {
        panel.choose("fire", pick);
        assert_eq!(fire(&panel), source);
    }
    panel.slide("kelvin per unit", 2_000.0);
    panel.slide("kelvin at 0", 100.0);
    panel.slide("strength", 0.5);
    let Some(VdbEmission::Temperature { scale, offset, strength, .. }) =
        panel.app.world().get::<VdbEmission>(volume)
    else {
        panic!("no fire")
    };
    assert_eq!((*scale, *offset, *strength), (2_000.0, 100.0, 0.5));
    // Shown otherwise, it is still that grid of the file.
    panel.choose("shown as", "smooth surface");
    for _ in 0..200 {
        if shown(&panel).is_empty() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
        panel.frames(1);
    }
    assert_eq!(shown(&panel), "");
    panel.look();
    let grid = panel.find(Role::ComboBox, "grid").expect("the other grids of the file");
    assert_eq!(grid.1.value(), Some("density"));
    panel.choose("colours", "Cd");
    assert_eq!(colors(&panel).as_deref(), Some("Cd"));
    panel.choose("fire", "none");
    assert_eq!(fire(&panel), "");
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
