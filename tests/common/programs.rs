//! The examples as people run them.

use std::path::Path;
use std::process::{Command, Output};

/// `cargo test` builds examples beside tests: `target/debug/{deps/programs-…,examples/NAME}`.
pub fn example(name: &str) -> Command {
    let test = std::env::current_exe().expect("the path of this test");
    let folder = test.parent().and_then(Path::parent).expect("tests are in target/…/deps");
    let path = folder.join(format!("examples/{name}{}", std::env::consts::EXE_SUFFIX));
    assert!(
        path.exists(),
        "{}: run `cargo build --example {name} --features picking,record` first",
        path.display()
    );
    let mut command = Command::new(path);
    // As `cargo run` has it: Bevy finds the assets by it.
    command.env("CARGO_MANIFEST_DIR", env!("CARGO_MANIFEST_DIR"));
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("RUST_LOG");
    command
}

/// What a program has written for people.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
