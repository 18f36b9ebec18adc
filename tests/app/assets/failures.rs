//! Files that cannot be loaded, and limits.

use super::*;

#[test]
fn a_file_that_takes_too_much_memory_is_one_message() {
    // Tiles of the root far apart, each with its own nodes over it and around it.
    let mut tree = Vdb543::new(0.0);
    for i in 0..50_000 {
        tree.insert_tile(IVec3::new(i % 37, i / 37 % 37, i / 1369) * 65_536, 1.0, true);
    }
    let grid = Grid::new("strewn", AnyTree::Float(Arc::new(tree)));
    let bytes = vdb_core::VdbFile::new(vec![grid]).write(&WriteOptions::default()).unwrap();
    let path = std::env::temp_dir().join(format!("bevy_vdb_strewn_{}.vdb", std::process::id()));
    std::fs::write(&path, bytes).unwrap();
    let mut app = app();
    let file: Handle<VdbFile> = load(&app, &path);
    let message = failure(&mut app, &file);
    std::fs::remove_file(&path).unwrap();
    assert!(
        message.contains("'strewn'") && message.contains("`Limits::packed_growth`"),
        "{message}"
    );
}

#[test]
fn each_failure_is_one_clear_message() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_errors_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let whole = std::fs::read(data("kinds.vdb")).unwrap();
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.join(name), bytes).unwrap();
        folder.join(name)
    };
    let cases = [
        (folder.join("missing.vdb"), "missing.vdb"),
        (write("truncated.vdb", &whole[..whole.len() / 2]), "truncated.vdb"),
        (write("text.vdb", b"This is not a volume."), "text.vdb"),
        (write("empty.vdb", b""), "empty.vdb"),
    ];
    let mut app = app();
    for (path, name) in cases {
        let file: Handle<VdbFile> = load(&app, path);
        let message = failure(&mut app, &file);
        println!("{message}");
        assert!(message.contains(name), "{message}");
        // With RUST_BACKTRACE set, Bevy puts a backtrace under the error.
        let said = message.split("\n   0: ").next().unwrap_or_default();
        assert_eq!(said.lines().count(), 1, "{message}");
    }
    let label = format!("{}#smoke", data("kinds.vdb").display());
    let wrong: Handle<VdbGrid> = app.world().resource::<AssetServer>().load(label);
    let message = failure(&mut app, &wrong);
    assert!(message.contains("smoke") && message.contains("density"), "{message}");
    // The app goes on.
    let file: Handle<VdbFile> = load(&app, data("empty_and_one.vdb"));
    loaded(&mut app, &file);
    std::fs::remove_dir_all(folder).unwrap();
}

/// A file that says to be so long and has no blocks on the disk.
fn sparse(path: &Path, start: &[u8], length: u64) {
    std::fs::write(path, start).unwrap();
    std::fs::OpenOptions::new().write(true).open(path).unwrap().set_len(length).unwrap();
}

#[test]
fn what_is_no_file_of_ours_is_refused_at_once() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_refused_{}", std::process::id()));
    std::fs::create_dir_all(folder.join("folder.vdb")).unwrap();
    let whole = std::fs::read(data("kinds.vdb")).unwrap();
    sparse(&folder.join("zeros.vdb"), b"", 3 << 30);
    sparse(&folder.join("long.vdb"), &whole, 3 << 30);
    let mut cases = vec![
        ("zeros.vdb", "this is not a VDB file"),
        (
            "long.vdb",
            "3221225472 bytes of file exceed the limit of 2147483648 (`Limits::file_bytes`)",
        ),
        ("folder.vdb", "folder.vdb"),
    ];
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("/dev/zero", folder.join("device.vdb")).unwrap();
        cases.push(("device.vdb", "this is not a VDB file"));
    }
    for (name, said) in cases {
        let mut app = app();
        let start = Instant::now();
        let file: Handle<VdbFile> = load(&app, folder.join(name));
        let message = failure(&mut app, &file);
        assert!(message.contains(said) && message.contains(name), "{name}: {message}");
        assert!(start.elapsed() < Duration::from_secs(5), "{name} took {:?}", start.elapsed());
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn limits_are_settings() {
    let folder = std::env::temp_dir().join(format!("bevy_vdb_limits_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let whole = std::fs::read(data("kinds.vdb")).unwrap();
    // By code.
    let mut app = app();
    let few = |settings: &mut VdbLoaderSettings| settings.limits.nodes = 10;
    let server = app.world().resource::<AssetServer>();
    let file: Handle<VdbFile> = server.load_builder().with_settings(few).load(data("kinds.vdb"));
    let message = failure(&mut app, &file);
    assert!(message.contains("exceed the limit of 10 (`Limits::nodes`)"), "{message}");
    // By a file of settings, in which all others keep their defaults.
    let meta = |limits: &str| {
        format!(
            "(meta_format_version: \"1.0\", asset: Load(loader: \"bevy_vdb::VdbLoader\", \
             settings: (limits: ({limits}))))"
        )
    };
    sparse(&folder.join("long.vdb"), &whole, 3 << 30);
    for (name, limits, said) in [
        ("small.vdb", "file_bytes: 1_000", Some("exceed the limit of 1000 (`Limits::file_bytes`)")),
        ("long.vdb", "file_bytes: 4_000_000_000", None),
    ] {
        let path = folder.join(name);
        if !path.exists() {
            std::fs::write(&path, &whole).unwrap();
        }
        std::fs::write(folder.join(format!("{name}.meta")), meta(limits)).unwrap();
        let mut app = self::app();
        let file: Handle<VdbFile> = load(&app, path);
        match said {
            Some(said) => {
                let message = failure(&mut app, &file);
                assert!(message.contains(said), "{message}");
            }
            None => assert_eq!(loaded(&mut app, &file).grids.len(), 3),
        }
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// A loading screen would wait for it in vain.
#[test]
fn a_volume_whose_path_is_refused_has_failed() {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, AssetPlugin::default(), VdbRenderPlugin));
    // Absolute paths have to be allowed.
    let refused: Handle<VdbGrid> = load(&app, data("kinds.vdb"));
    let volume = app.world_mut().spawn(VdbVolume(refused)).id();
    app.update();
    let state = app.world().get::<VdbVolumeState>(volume).unwrap();
    assert!(matches!(state, VdbVolumeState::Failed(_)) && state.is_settled(), "{state:?}");
    assert!(state.reason().is_some_and(|why| why.contains("path that it refuses")), "{state:?}");
}
