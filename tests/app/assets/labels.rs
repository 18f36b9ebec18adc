//! Grids by their labels, and the grid that a file is about.

use super::*;

/// Names with escapes that a terminal obeys, and such as Bevy's paths have no place for.
#[test]
fn labels_can_be_shown_and_loaded() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_labels_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("names.vdb");
    let names =
        ["\u{1b}[2J\u{202e}", "a#b", "http://x", "density", "fire/core", "Dichte für Rauch"];
    let grid = |name: &str| Grid::new(name, AnyTree::Float(Vdb543::new(0.0_f32).into()));
    let grids = names.map(grid).into();
    vdb_core::VdbFile::new(grids).save(&path, &WriteOptions::default()).unwrap();
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, &path);
    let file = loaded(&mut app, &file);
    let labels = [
        r"\u{1b}[2J\u{202e}",
        r"a\u{23}b",
        r"http:/\u{2f}x",
        "density",
        "fire/core",
        "Dichte für Rauch",
    ];
    for (label, name) in labels.into_iter().zip(names) {
        let grid = loaded(&mut app, &file.named_grids[label]);
        assert_eq!(grid.name(), name);
        let asked = format!("{}#{label}", path.display());
        let found: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(asked);
        assert_eq!(found, file.named_grids[label]);
    }
    // Bevy lists them where one is asked for that is not there.
    let asked = format!("{}#smoke", path.display());
    let wrong: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(asked);
    let message = failure(&mut app, &wrong);
    assert!(message.contains(r"\u{1b}") && message.contains("density"), "{message}");
    assert!(!message.contains(['\u{1b}', '\u{202e}']), "{message:?}");
    // And what the loader itself says of such a file.
    let hostile: Handle<VdbFile> = load(&app, data("hostile/ansi.vdb"));
    let hostile = until(&mut app, "the file or an error", |world| {
        match world.resource::<AssetServer>().load_state(&hostile) {
            LoadState::Failed(error) => Some(error.to_string()),
            LoadState::Loaded => Some(String::new()),
            _ => None,
        }
    });
    assert!(!hostile.contains('\u{1b}'), "{hostile:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// The likeliest beginner's mistake is none: a file without a label is the grid that it is about.
#[test]
fn a_grid_without_a_label_is_the_one_that_the_file_is_about() {
    let (set, fog) = (GridClass::LevelSet, GridClass::FogVolume);
    let mut app = app();
    for (test, grids, name) in [
        ("one", &[("ls_teapot", set)][..], "ls_teapot"),
        ("smoke", &[("temperature", fog), ("density", fog), ("flame", fog)], "density"),
        ("unnamed", &[("", fog)], ""),
    ] {
        let (folder, path) = file_of(test, grids);
        let grid: Handle<VdbGrid> = load(&app, &path);
        let grid = loaded(&mut app, &grid);
        assert_eq!(
            (grid.name(), grid.class()),
            (name, grids.iter().find(|of| of.0 == name).unwrap().1)
        );
        // As a file, by type or by none, it is still all of it.
        let file: Handle<VdbFile> = load(&app, &path);
        assert_eq!(loaded(&mut app, &file).grids.len(), grids.len());
        let untyped =
            app.world().resource::<AssetServer>().load_builder().load_untyped(path.clone());
        let untyped = until(&mut app, "the asset", |world| {
            Some(world.resource::<Assets<LoadedUntypedAsset>>().get(&untyped)?.handle.clone())
        });
        assert!(untyped.try_typed::<VdbFile>().is_ok(), "what has no type is a file");
        std::fs::remove_dir_all(folder).unwrap();
    }
    // Settings go for it as well.
    let (folder, path) = file_of("settings", &[("left", set), ("right", set)]);
    let server = app.world().resource::<AssetServer>();
    let right = server
        .load_builder()
        .with_settings(|settings: &mut VdbLoaderSettings| {
            settings.grids = Some(vec!["right".into()]);
            settings.smooth = false;
        })
        .load(path);
    let right: VdbGrid = loaded(&mut app, &right);
    assert_eq!((right.name(), right.kind()), ("right", PackKind::Surface { iso: 0.0 }));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn where_a_grid_could_be_several_the_message_has_their_labels() {
    let (set, fog) = (GridClass::LevelSet, GridClass::FogVolume);
    let mut app = app();
    for (test, grids) in
        [("two", [("left", set), ("right", set)]), ("both", [("surface", set), ("density", fog)])]
    {
        let (folder, path) = file_of(test, &grids);
        let grid: Handle<VdbGrid> = load(&app, &path);
        let message = failure(&mut app, &grid);
        println!("{message}");
        let labels = grids.map(|(name, _)| format!("`#{name}`"));
        assert!(message.contains("append the label of one to the path"), "{message}");
        assert!(labels.iter().all(|label| message.contains(label)), "{message}");
        // A volume says that nothing will come, and why, in the words of the message.
        let volume = app.world_mut().spawn(VdbVolume(grid)).id();
        app.update();
        let state = app.world().get::<VdbVolumeState>(volume).unwrap();
        let VdbVolumeState::Failed(why) = state else { panic!("{state:?}") };
        assert!(why.starts_with("the file has several grids"), "{why}");
        assert!(message.contains(why) && state.is_settled(), "{why}");
        std::fs::remove_dir_all(folder).unwrap();
    }
    let (folder, path) = file_of("none", &[("density", fog)]);
    let vectors: Handle<VdbVectorGrid> = load(&app, &path);
    let message = failure(&mut app, &vectors);
    println!("{message}");
    assert!(message.contains("no grid of vectors") && message.contains("density"), "{message}");
    std::fs::remove_dir_all(folder).unwrap();
}
