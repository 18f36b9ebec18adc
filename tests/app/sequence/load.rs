//! Sequences from `.vdbseq` files, patterns and folders.

use std::path::Path;

use bevy::asset::{AssetPath, LoadState};
use bevy::prelude::*;
use bevy_vdb::prelude::*;

use super::stage::{Stage, file, fog};

/// The numbers of a sequence's frames, or the reason why it could not be loaded.
fn frames(stage: &mut Stage, sequence: &Handle<VdbSequence>) -> Result<Vec<u64>, String> {
    let mut outcome = Err("it is loading".to_owned());
    stage.until("the sequence", |stage| {
        outcome = match stage.server().load_state(sequence) {
            LoadState::Loaded => {
                let sequences = stage.app.world().resource::<Assets<VdbSequence>>();
                let sequence = sequences.get(sequence).unwrap();
                Ok(sequence.frames().iter().map(|frame| frame.number).collect())
            }
            LoadState::Failed(error) => Err(error.to_string()),
            _ => return false,
        };
        true
    });
    outcome
}

#[test]
fn patterns_and_folders_are_sequences() {
    let mut stage = Stage::new("patterns");
    std::fs::create_dir_all(stage.folder.join("cache")).unwrap();
    for (number, name) in [
        (3, "cache/fire_0003.vdb"),
        (1, "cache/fire_0001.vdb"),
        (10, "cache/fire_0010.vdb"),
        (1, "cache/smoke_v2.1.vdb"),
        (2, "cache/smoke_v2.2.vdb"),
        (0, "cache/notes_0004.txt"),
        (0, "cache/still.vdb"),
        (7, "top_7.vdb"),
    ] {
        stage.write_file(name, &file(vec![fog("density", number)]));
    }
    let absolute = stage.folder.join("cache/fire_####.vdb").display().to_string();
    for (path, expected) in [
        ("cache/fire_####.vdb", &[1, 3, 10][..]),
        ("cache/fire_%04d.vdb", &[1, 3, 10]),
        ("cache/fire_$F4.vdb", &[1, 3, 10]),
        ("cache/smoke_v2.#.vdb", &[1, 2]),
        ("cache", &[1, 3, 10]),
        ("cache/", &[1, 3, 10]),
        ("top_#.vdb", &[7]),
        ("gate://cache/fire_####.vdb", &[1, 3, 10]),
        ("gate://cache", &[1, 3, 10]),
        (&absolute, &[1, 3, 10]),
    ] {
        let sequence = stage.server().load_vdb_sequence(path);
        assert_eq!(frames(&mut stage, &sequence).as_deref(), Ok(expected), "{path}");
    }
    for (path, said) in [
        ("cache/fire_0001.vdb", "'fire_0001.vdb' has no placeholder for the frame number"),
        ("cache/fire_##_##.vdb", "more than one placeholder"),
        ("####/fire.vdb", "must be in the file name"),
        ("cache/rain_####.vdb", "the folder 'cache' has no frame of the sequence 'rain_####.vdb'"),
        ("no_such/fire_####.vdb", "the folder 'no_such' of the sequence cannot be listed"),
        ("no_such", "the folder 'no_such' of the sequence cannot be listed"),
        ("top_7", "cannot be listed"),
        ("nowhere://fire", "leads to no folder"),
        ("", "top_#.vdb"),
    ] {
        let sequence = stage.server().load_vdb_sequence(path);
        let outcome = frames(&mut stage, &sequence);
        println!("{outcome:?}");
        match outcome {
            // The folder of all assets.
            Ok(numbers) => assert_eq!((path, &numbers[..]), ("", &[7][..])),
            Err(problem) => assert!(problem.contains(said), "{path}: {problem}"),
        }
    }
    // What was found can be played.
    let sequence = stage.server().load_vdb_sequence("cache/fire_####.vdb");
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.player(player).seek(10);
    stage.until("the frame", |stage| stage.shown(player) == Some(10));
}

#[test]
fn a_description_is_a_sequence() {
    let mut stage = Stage::new("vdbseq");
    std::fs::create_dir_all(stage.folder.join("fire/cache")).unwrap();
    for number in 5..=8 {
        let grids = vec![fog("density", number), fog("fuel", number)];
        stage.write_file(&format!("fire/cache/fire.{number}.vdb"), &file(grids));
    }
    let text = "(\n    frames: \"cache/fire.$F.vdb\",\n    rate: 30.0,\n    repeat: Once,\n    \
                settings: (grids: [\"density\"]),\n)\n";
    stage.write_file("fire/listed.vdbseq", text.as_bytes());
    let range = "(frames: \"cache/fire.#.vdb\", first: 6, last: 7)";
    stage.write_file("fire/range.vdbseq", range.as_bytes());
    let listed: Handle<VdbSequence> = stage.server().load("fire/listed.vdbseq");
    assert_eq!(frames(&mut stage, &listed), Ok(vec![5, 6, 7, 8]));
    let range: Handle<VdbSequence> = stage.server().load("fire/range.vdbseq");
    assert_eq!(frames(&mut stage, &range), Ok(vec![6, 7]));
    let player = stage.spawn(VdbPlayer::new(listed.clone()).paused());
    stage.until_loaded(player, 4);
    let world = stage.app.world();
    let sequence = world.resource::<Assets<VdbSequence>>().get(&listed).unwrap();
    assert_eq!((sequence.rate, sequence.repeat), (30.0, VdbRepeat::Once));
    // Its settings hold for its frames.
    let files = world.resource::<Assets<VdbFile>>();
    assert!(files.iter().all(|(_, file)| file.grids.len() == 1));

    for (text, said) in [
        ("(\n  frames: \"fire_####.vdb\",\n  frist: 1,\n)", "line 3, column"),
        ("(\n  frames: \"fire_0001.vdb\",\n)", "line 2: 'fire_0001.vdb' has no place"),
        (
            "(\n  frames: \"a_#.vdb\", first: 9,\n  last: 1,\n)",
            "line 3: the first frame, 9, is after",
        ),
        ("(frames: \"none/a_#.vdb\")", "the folder 'wrong/none' of the sequence cannot be listed"),
    ] {
        std::fs::create_dir_all(stage.folder.join("wrong")).unwrap();
        let name = format!("wrong/{}.vdbseq", text.len());
        stage.write_file(&name, text.as_bytes());
        let wrong: Handle<VdbSequence> = stage.server().load(name.clone());
        let problem = frames(&mut stage, &wrong).unwrap_err();
        println!("{problem}");
        assert!(problem.contains(said) && problem.contains(&name), "{problem}");
    }
    for (bytes, said) in
        [(vec![b' '; 70_000], "at most 65536 bytes"), (vec![0xff, 0xfe], "text in UTF-8")]
    {
        let name = format!("{}.vdbseq", bytes.len());
        stage.write_file(&name, &bytes);
        let wrong: Handle<VdbSequence> = stage.server().load(name);
        let problem = frames(&mut stage, &wrong).unwrap_err();
        assert!(problem.contains(said), "{problem}");
    }
}

/// The `.vdbseq` file of the guide, as it stands there.
#[test]
fn the_guides_description_is_a_sequence() {
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide/sequences.md");
    let guide = std::fs::read_to_string(guide).unwrap();
    let (_, rest) = guide.split_once("```ron\n").expect("a .vdbseq file in the guide");
    let (text, _) = rest.split_once("```").unwrap();
    let mut stage = Stage::new("guide");
    stage.write_file("fire.vdbseq", text.as_bytes());
    let sequence: Handle<VdbSequence> = stage.server().load("fire.vdbseq");
    assert_eq!(frames(&mut stage, &sequence), Ok((1..=240).collect()));
    let sequences = stage.app.world().resource::<Assets<VdbSequence>>();
    let sequence = sequences.get(&sequence).unwrap();
    assert_eq!(sequence.frames()[6].path, AssetPath::parse("cache/fire_0007.vdb"));
    assert_eq!(sequence.settings.as_ref().unwrap().values, VdbValues::Half);
}

#[test]
fn a_reloaded_description_changes_the_sequence_that_is_played() {
    let mut stage = Stage::watching("reload");
    stage.write(1..=9);
    let write = |stage: &Stage, first: u64, last: u64| {
        let text = format!("(frames: \"fire_####.vdb\", first: {first}, last: {last})");
        stage.write_file("fire.vdbseq", text.as_bytes());
    };
    write(&stage, 4, 6);
    let sequence = stage.server().load("fire.vdbseq");
    let player = stage.spawn(VdbPlayer::new(sequence).paused());
    stage.player(player).seek(5);
    stage.until("the frame", |stage| stage.shown(player) == Some(5));
    write(&stage, 1, 9);
    stage.until("the reloaded sequence", |stage| stage.status(player).range() == Some((1, 9)));
    assert_eq!((stage.shown(player), stage.status(player).wanted()), (Some(5), Some(5)));
    stage.until_loaded(player, 9);
    // Without the frame that is shown, the one before it is wanted.
    write(&stage, 1, 3);
    stage.until("the shorter sequence", |stage| stage.status(player).range() == Some((1, 3)));
    stage.until("its last frame", |stage| stage.shown(player) == Some(3));
}
