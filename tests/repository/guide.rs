//! `docs/guide/troubleshooting.md` has every message of the plugin, the reader and the recorder, with its
//! cause and its remedy.

use std::path::Path;

use bevy_vdb::VdbRenderMode;
use vdb_core::view::CannotShow;

const GUIDE: &str = "docs/guide/troubleshooting.md";

/// What a line of code says to a person, after one of these.
const SPEAKERS: [&str; 5] = ["#[error(", " warn!(", " error!(", " warn_once!(", " error_once!("];

/// The letters of the first string after a place, without its breaks of lines.
fn first_string(after: &str) -> Option<String> {
    let mut rest = after.trim_start().strip_prefix('"')?.chars();
    let mut text = String::new();
    loop {
        match rest.next()? {
            '"' => return Some(text),
            '\\' => match rest.next()? {
                '\n' => rest = rest.as_str().trim_start().chars(),
                escaped => text.push(escaped),
            },
            letter => text.push(letter),
        }
    }
}

/// The first piece of a message that is the same every time and long enough to look for.
fn fixed_part(message: &str) -> Option<String> {
    let pieces = message.split('{').flat_map(|piece| {
        let after = piece.split_once('}').map_or(piece, |(_, after)| after);
        after.split('`')
    });
    let bare = |piece: &'_ str| piece.trim_matches(|c: char| !c.is_alphanumeric()).to_owned();
    let long = pieces.map(bare).find(|piece| piece.chars().count() >= 12)?;
    Some(long.chars().take(24).collect())
}

/// What follows each speaker in the sources of a folder, with the path of its file.
fn spoken(folder: &Path, found: &mut Vec<(String, String)>) {
    for entry in std::fs::read_dir(folder).expect("sources can be read") {
        let path = entry.expect("sources can be read").path();
        if path.is_dir() {
            spoken(&path, found);
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("sources can be read");
        let at = |speaker: &&'static str| text.match_indices(*speaker).collect::<Vec<_>>();
        for (place, speaker) in SPEAKERS.iter().flat_map(at) {
            found.push((path.display().to_string(), text[place + speaker.len()..].to_owned()));
        }
    }
}

fn messages(folder: &Path, found: &mut Vec<(String, String)>) {
    let mut all = Vec::new();
    spoken(folder, &mut all);
    let message = |(path, after): (String, String)| Some((path, first_string(&after)?));
    found.extend(all.into_iter().filter_map(message));
}

#[test]
fn every_message_is_in_the_guide() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let guide = std::fs::read_to_string(root.join(GUIDE)).expect("the guide");
    let mut found = Vec::new();
    // It has none so far.
    messages(&root.join("crates/bevy_vdb_inspector/src"), &mut found);
    for folder in ["src", "crates/vdb_core/src", "crates/bevy_vdb_record/src"] {
        let before = found.len();
        messages(&root.join(folder), &mut found);
        assert!(found.len() > before, "no message is found in {folder}");
    }
    for why in CannotShow::ALL {
        found.push(("crates/vdb_core/src/view.rs".into(), why.to_string()));
    }
    assert!(found.len() > 25, "{} messages are found", found.len());
    let missing: Vec<_> = found
        .iter()
        .filter(|(_, message)| fixed_part(message).is_some_and(|part| !guide.contains(&part)))
        .collect();
    assert!(missing.is_empty(), "give {GUIDE} a row for each of {missing:#?}");
}

/// The name of a grid comes from a file, and may have escapes that a terminal obeys: messages show
/// it by `shown_name`.
#[test]
fn messages_show_names_escaped() {
    let mut found = Vec::new();
    spoken(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut found);
    // Up to the end of the macro or of the attribute.
    let end = |after: &String| [");", ")]"].iter().filter_map(|end| after.find(end)).min();
    let calls: Vec<_> = found
        .iter()
        .filter_map(|(path, after)| Some((path.as_str(), &after[..end(after)?])))
        .collect();
    assert!(calls.iter().any(|(_, call)| call.contains("shown_name()")), "none shows a name");
    let raw: Vec<_> = calls
        .iter()
        .filter(|(_, call)| call.replace("shown_name()", "").contains("name()"))
        .collect();
    assert!(raw.is_empty(), "these show a name as it is in the file: {raw:#?}");
}

/// What people copy is what is built and drawn.
#[test]
fn the_readme_has_the_least_example() {
    let read = |path: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    let example = read("examples/minimal.rs");
    let (comment, code) = example.split_once("\n\n").expect("a comment and a program");
    assert!(comment.lines().all(|line| line.starts_with("//!")), "{comment}");
    // Open to the test that draws it.
    let code = code.replace("pub(crate) fn", "fn");
    assert!(read("README.md").contains(&format!("```rust,no_run\n{code}```")), "{code}");
}

/// A name in code, alone in the first column of a table.
#[test]
fn the_guide_has_a_row_for_each_render_mode() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/guide/components.md");
    let guide = std::fs::read_to_string(path).expect("the guide can be read");
    for mode in VdbRenderMode::ALL {
        let row = format!("| `{mode:?}` |");
        assert!(guide.contains(&row), "no row {row} in docs/guide/components.md");
    }
}
