//! OpenVDB's own programs, where they are installed.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Whether a program runs; if not, says so.
pub fn is_there(program: &str, arguments: &[&str]) -> bool {
    let there = Command::new(program).args(arguments).output().is_ok_and(|o| o.status.success());
    if !there {
        eprintln!(
            "SKIPPED: {program} {arguments:?} does not run; install python3-openvdb and \
             libopenvdb-tools"
        );
    }
    there
}

/// A folder for one test alone, emptied.
pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Lets OpenVDB's Python module compare grids of pairs of files, by name; skipped where the module
/// is not installed.
#[allow(dead_code, reason = "not every suite compares by it")]
pub fn compare(grids: &[(PathBuf, PathBuf, String)]) {
    let python = "/usr/bin/python3";
    if !is_there(python, &["-c", "import pyopenvdb"]) {
        return;
    }
    let mut child = Command::new(python)
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/openvdb/compare.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = child.stdin.take().unwrap();
    for (one, other, name) in grids {
        writeln!(input, "{}\t{}\t{name}", one.display(), other.display()).unwrap();
    }
    drop(input);
    let output = child.wait_with_output().unwrap();
    let out = String::from_utf8_lossy(&output.stdout);
    println!("{out}");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let count = grids.len();
    assert!(out.starts_with(&format!("{count} grids, ")) && count > 0, "{out}");
}
