//! Models, and the grids of their files.

use bevy::prelude::*;
use bevy_egui::egui::accesskit::Role;
use bevy_vdb::prelude::*;
use bevy_vdb_inspector::{VdbInspectorPlugin, VdbModelPicked};
use vdb_core::tree::Vdb543;

use crate::panel::Panel;
use crate::{files, smoke_file};

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
    let light = |panel: &Panel| panel.app.world().get::<VdbEmissionLight>(volume).cloned();
    assert_eq!(light(&panel), None);
    panel.click(Role::CheckBox, "lights its surroundings");
    panel.slide("lights", 3.0);
    panel.slide("light on others", 0.5);
    panel.click(Role::CheckBox, "its lights cast shadows");
    let expected = VdbEmissionLight { max_lights: 3, intensity: 0.5, shadows: true, ..default() };
    assert_eq!(light(&panel), Some(expected));
    panel.click(Role::CheckBox, "lights its surroundings");
    assert_eq!(light(&panel), None);
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
