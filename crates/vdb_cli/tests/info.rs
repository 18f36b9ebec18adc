//! The command `vdb info`.

#[path = "../../vdb_core/tests/corpus_files/mod.rs"]
mod corpus_files;

use std::path::PathBuf;
use std::process::{Command, Output};

use corpus_files::{corpus, files};

/// The files that the crate of the format keeps for its tests.
const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../vdb_core/tests/data");

fn vdb() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vdb"));
    command.arg("info");
    command
}

fn info(arguments: &[&str]) -> Output {
    vdb().args(arguments).output().unwrap()
}

fn data(name: &str) -> String {
    format!("{DATA}/{name}")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The JSON files of the crate and, where it is there, of the corpus.
fn figures() -> Vec<PathBuf> {
    let mut folders = vec![PathBuf::from(DATA)];
    if let Some(corpus) = corpus() {
        folders.extend(["openvdb-written", "real"].map(|folder| corpus.join(folder)));
    }
    folders.iter().flat_map(|folder| files(folder, "json")).collect()
}

#[test]
fn json_is_that_of_openvdb_letter_by_letter() {
    let mut same = 0;
    for path in figures() {
        let theirs = std::fs::read_to_string(&path).unwrap();
        let output = info(&["--json", path.with_extension("vdb").to_str().unwrap()]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        for (ours, theirs) in text(&output.stdout).lines().zip(theirs.lines()) {
            // OpenVDB's figures have only the number of points, not their attributes.
            if theirs.contains("\"points\":") {
                let head = theirs.trim_end_matches(',').strip_suffix('}').unwrap();
                let ours = ours.strip_prefix(head).unwrap_or_else(|| panic!("{ours}"));
                assert!(ours.starts_with(",\"attributes\":[{\"name\":\"P\""), "{ours}");
            } else {
                assert_eq!(ours, theirs, "{}", path.display());
            }
        }
        assert_eq!(text(&output.stdout).lines().count(), theirs.lines().count());
        same += 1;
    }
    println!("{same} files");
    assert!(same >= 2);
}

#[test]
fn people_can_read_it() {
    let file = data("kinds.vdb");
    let output = info(&[&file, "--sizes"]);
    assert!(output.status.success() && output.stderr.is_empty());
    let out = text(&output.stdout);
    for line in [
        "\"density\": Tree_float_5_4_3, fog volume, saved as half",
        "  active from [15, 15, 15] to [25, 25, 25]: 11 x 11 x 11",
        "  515 active voxels, 515 of them in leaves; 0 active tiles",
        "            7 leaves of 8^3, 515 active voxels",
        "  title (string): \"small grids of several kinds\"",
        "    answer (int32): 42",
    ] {
        assert!(out.lines().any(|other| other == line), "{line:?} is missing in {out}");
    }
    assert!(out.contains("a file of its own with zip + active values: "), "{out}");
}

/// A file whose names, types, metadata and unique tag have escapes that a terminal obeys.
#[test]
fn text_of_the_file_is_escaped() {
    let file = data("hostile/ansi.vdb");
    for options in [&[file.as_str()][..], &[&file, "--json"], &[&file, "--sizes"]] {
        let output = info(options);
        assert!(output.status.success(), "{output:?}");
        for bytes in [&output.stdout, &output.stderr] {
            let raw = bytes.iter().find(|byte| byte.is_ascii_control() && **byte != b'\n');
            assert_eq!(raw, None, "{}", text(bytes).escape_debug());
            assert!(!text(bytes).lines().any(|line| line.starts_with("FAKE")), "{}", text(bytes));
        }
    }
    // The text is still displayed, escaped.
    assert!(text(&info(&[&file]).stdout).contains(r"\u{1b}[31mRED"));
}

#[cfg(unix)]
#[test]
fn what_ends_the_output_is_no_panic() {
    use std::process::Stdio;
    let good = data("kinds.vdb");
    // More than a pipe holds, and nobody who reads it.
    let mut child = vdb()
        .args([good.as_str(); 2000])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    if let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") {
        let output = vdb().arg(&good).stdout(full.try_clone().unwrap()).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert_eq!(text(&output.stderr).lines().count(), 1, "{output:?}");
        // And nobody to tell, either.
        let status = vdb().arg("no/such.vdb").stderr(full).status().unwrap();
        assert_eq!(status.code(), Some(1));
    }
}

/// Within as little memory as the program itself needs.
#[cfg(unix)]
#[test]
fn what_is_no_file_costs_no_memory() {
    use std::path::Path;
    let folder = std::env::temp_dir().join(format!("vdb_cli_info_{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let [huge, long, pipe, odd] =
        ["huge.vdb", "long.vdb", "pipe.vdb", "\u{1b}[31m.vdb"].map(|name| folder.join(name));
    let kinds = data("kinds.vdb");
    std::fs::File::create(&huge).unwrap().set_len(3 << 30).unwrap();
    std::fs::copy(kinds, &long).unwrap();
    std::fs::OpenOptions::new().write(true).open(&long).unwrap().set_len(3 << 29).unwrap();
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let within = |arguments: &[&std::ffi::OsStr]| {
        Command::new("sh")
            .args(["-c", "ulimit -v 600000; exec timeout 20 \"$0\" \"$@\""])
            .args([env!("CARGO_BIN_EXE_vdb"), "info"])
            .args(arguments)
            .output()
            .unwrap()
    };
    for path in [huge.as_path(), &pipe, &odd, &folder, Path::new("/dev/zero")] {
        let output = within(&[path.as_os_str()]);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let said = text(&output.stderr);
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(!said.contains('\u{1b}'), "{said:?}");
    }
    // Three grids of a few kilobytes, and behind them 1.5 GiB of nothing.
    let output = within(&[long.as_os_str()]);
    assert!(output.status.success(), "{output:?}");
    assert!(text(&output.stdout).contains("\"density\""));
    // Those who trust a file say so.
    let output = within(&[huge.as_os_str(), "--no-limits".as_ref()]);
    assert!(text(&output.stderr).contains("this is not a VDB file"), "{output:?}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_cannot_be_read_is_said_and_the_rest_is_shown() {
    let good = data("empty_and_one.vdb");
    let output = info(&["no/such.vdb", &good]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).starts_with("no/such.vdb: "), "{output:?}");
    assert!(text(&output.stdout).contains("\"one_voxel\""));
    assert_eq!(info(&[]).status.code(), Some(2));
    assert_eq!(info(&["--what", &good]).status.code(), Some(2));
}

/// The names that OpenVDB's figures have, and every value, are read by a reader of JSON.
#[test]
fn json_is_json() {
    let output = info(&["--json", &data("kinds.vdb")]);
    let file: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(file["file"], "kinds.vdb");
    let grids = file["grids"].as_array().unwrap();
    let density = grids.iter().find(|grid| grid["name"] == "density").unwrap();
    assert_eq!(density["active_voxels"], "515");
    assert_eq!(density["active_bbox"], serde_json::json!([[15, 15, 15], [25, 25, 25]]));
}

/// Help and version are no errors; a wrong command line is, and a terminal obeys none of it.
#[test]
fn command_line() {
    let vdb = |arguments: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_vdb")).args(arguments).output().unwrap()
    };
    for arguments in [&["--help"][..], &["help", "info"], &["info", "--help"], &["--version"]] {
        let output = vdb(arguments);
        assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
        assert!(!output.stdout.is_empty());
    }
    for arguments in [&[][..], &["info"], &["draw"], &["info", "--\u{1b}[31m", "a.vdb"]] {
        let output = vdb(arguments);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(output.stdout.is_empty() && text(&output.stderr).contains("Usage"), "{output:?}");
        assert!(!text(&output.stderr).contains('\u{1b}'), "{output:?}");
    }
}

/// A progress bar is for terminals: nothing of it is in a pipe, and all of it is gone from a terminal
/// when the file has been read.
#[cfg(target_os = "linux")]
#[test]
fn progress_is_shown_on_a_terminal_alone() {
    let command = format!("{} info {}", env!("CARGO_BIN_EXE_vdb"), data("kinds.vdb"));
    let script = Command::new("script").args(["-qec", &command, "/dev/null"]).output();
    let Ok(terminal) = script else {
        eprintln!("SKIPPED: there is no program `script` to run another in a terminal");
        return;
    };
    // As in a chroot without /dev/pts.
    if text(&terminal.stderr).contains("failed to create pseudo-terminal") {
        eprintln!("SKIPPED: {}", text(&terminal.stderr));
        return;
    }
    assert!(terminal.status.success(), "{terminal:?}");
    let shown = text(&terminal.stdout);
    assert!(shown.contains("kinds.vdb ["), "{shown:?}");
    let [bar, file] = ["kinds.vdb [", "\"density\""].map(|part| shown.find(part));
    assert!(bar < file, "{shown:?}");
    assert!(shown.contains("\r\u{1b}[2K"), "the bar stays: {shown:?}");
    assert!(info(&[&data("kinds.vdb")]).stderr.is_empty());
}
