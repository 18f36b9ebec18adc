//! What browsers do not have is not in the way of the plugin.

use std::fs;
use std::path::Path;

use crate::imports::{code_of, rust_files};

/// What panics or fails in a browser, and what stands in for it.
const FORBIDDEN: [(&str, &str); 6] = [
    ("time::Instant", "bevy::platform::time::Instant"),
    ("SystemTime", "a time that the app passes in"),
    ("thread::spawn", "bevy::tasks"),
    ("thread::sleep", "another frame"),
    ("thread::scope", "bevy::tasks"),
    ("fs::", "bevy::asset::io"),
];

/// Files that read the local file system, and handle its absence.
const EXCEPTIONS: [&str; 2] = ["src/asset/sequence/list.rs", "src/render/gpu/shaders.rs"];

#[test]
fn the_plugin_uses_nothing_that_browsers_lack() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut lines, mut wrong) = (0, Vec::new());
    for file in rust_files(&root.join("src")) {
        let name = file.strip_prefix(root).expect("a file of the repository");
        if EXCEPTIONS.iter().any(|own| Path::new(own) == name) {
            continue;
        }
        let text = fs::read_to_string(&file).expect("a file");
        for line in code_of(&text).lines() {
            lines += 1;
            let line = line.replace("bevy::platform::time::Instant", "");
            // Also within braces: `std::time::{Duration, Instant}`.
            let line = if line.contains("std::time::{") && line.contains("Instant") {
                line.replace("Instant", "time::Instant")
            } else {
                line
            };
            for (what, instead) in FORBIDDEN {
                if line.contains(what) {
                    wrong.push(format!("{}: {what}; use {instead}: {line}", name.display()));
                }
            }
        }
    }
    assert!(lines > 10_000, "{lines} lines of code");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
