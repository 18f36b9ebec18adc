//! Paths that lead to anything: what is no file of ours ends in one message, soon and without memory; what is
//! replaced keeps what was its own.

mod times;

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use vdb_core::tree::{IVec3, Vdb543};
use vdb_core::{AnyTree, Error, FileBuffer, Grid, Limits, ReadOptions, VdbFile, WriteOptions};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");

/// A folder of its own, gone when the test is done.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("vdb_files_{name}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// What is in it, by name.
    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn one_voxel() -> VdbFile {
    let mut tree = Vdb543::new(0.0_f32);
    tree.set(IVec3::new(1, 2, 3), 0.5);
    VdbFile::new(vec![Grid::new("density", AnyTree::Float(tree.into()))])
}

/// What comes of something, if it comes within seconds.
fn soon<T: Send + 'static>(what: &str, act: impl FnOnce() -> T + Send + 'static) -> T {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || sender.send(act()));
    receiver.recv_timeout(Duration::from_secs(10)).unwrap_or_else(|_| panic!("{what} does not end"))
}

/// What opening a path says, which must be one line with the path.
fn refusal(path: &Path) -> String {
    let owned = path.to_owned();
    let message = soon(&path.display().to_string(), move || VdbFile::open(owned)).unwrap_err();
    let message = message.to_string();
    assert!(message.starts_with(&path.display().to_string()), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

/// A file that says to be so long and has no blocks on the disk.
fn sparse(path: &Path, start: &[u8], length: u64) {
    let mut file = File::create(path).unwrap();
    file.write_all(start).unwrap();
    file.set_len(length).unwrap();
}

#[cfg(unix)]
fn make_pipe(path: &Path) {
    assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
}

#[test]
fn what_is_no_file_of_ours_is_refused_at_once() {
    let folder = Folder::new("refused");
    let huge = folder.path("huge.vdb");
    sparse(&huge, b"", 3 << 30);
    assert!(refusal(&huge).contains("this is not a VDB file"));
    let whole = fs::read(Path::new(DATA).join("kinds.vdb")).unwrap();
    sparse(&huge, &whole, 3 << 30);
    let message = refusal(&huge);
    assert!(message.contains("3221225472 bytes of file exceed the limit"), "{message}");
    assert!(message.contains("Limits::file_bytes"), "{message}");
    assert!(refusal(&folder.0).contains("this is a folder"));
    assert!(refusal(&folder.path("none.vdb")).contains("os error 2"));
    #[cfg(unix)]
    {
        let pipe = folder.path("pipe.vdb");
        make_pipe(&pipe);
        assert!(refusal(&pipe).contains("this is a pipe, not a regular file"));
        assert!(refusal(Path::new("/dev/zero")).contains("this is a device"));
        let link = folder.path("link.vdb");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        assert!(refusal(&link).contains("this is a device"));
        std::os::unix::fs::symlink("loop.vdb", folder.path("loop.vdb")).unwrap();
        refusal(&folder.path("loop.vdb"));
    }
}

/// Counts what is read of a source of bytes that never ends: a start, then zeros.
struct Endless<'a> {
    start: &'a [u8],
    read: usize,
}

impl Read for Endless<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        for byte in out.iter_mut() {
            *byte = self.start.get(self.read).copied().unwrap_or(0);
            self.read += 1;
        }
        Ok(out.len())
    }
}

/// What is read of a source, and what came of it.
fn intake(
    source: &mut impl Read,
    limits: &Limits,
    length: Option<u64>,
) -> (usize, Result<VdbFile, Error>) {
    let mut buffer = FileBuffer::new(limits.clone(), length);
    loop {
        match buffer.room() {
            Ok(Some(room)) => {
                let count = source.read(room).unwrap();
                buffer.filled(count);
            }
            Ok(None) => break,
            Err(error) => return (buffer.len(), Err(error)),
        }
    }
    let (length, bytes) = (buffer.len(), buffer.into_bytes());
    assert_eq!(length, bytes.len());
    (length, VdbFile::read(&bytes, &ReadOptions { limits: limits.clone(), ..Default::default() }))
}

#[test]
fn no_more_is_read_than_is_needed() {
    let chunk = 64 << 10;
    let limits = Limits::default();
    let whole = fs::read(Path::new(DATA).join("kinds.vdb")).unwrap();
    // Nothing of ours: the first bytes.
    let (read, result) = intake(&mut Endless { start: b"", read: 0 }, &limits, None);
    assert!(read <= chunk && result.unwrap_err().to_string().contains("this is not a VDB file"));
    // A file, and behind it zeros without end: the file.
    let (read, result) = intake(&mut Endless { start: &whole, read: 0 }, &limits, None);
    assert!(read <= whole.len() + chunk, "{read}");
    assert_eq!(
        result.unwrap().grids.len(),
        VdbFile::read(&whole, &Default::default()).unwrap().grids.len()
    );
    // A stream without an end: as much as the limit allows.
    let options = WriteOptions { stream: true, ..WriteOptions::default() };
    let stream = one_voxel().write(&options).unwrap();
    let mut small = limits.clone();
    small.file_bytes = 1 << 20;
    let (read, result) = intake(&mut Endless { start: &stream, read: 0 }, &small, None);
    let message = result.unwrap_err().to_string();
    assert!(read == (1 << 20) + 1 || read <= (1 << 20) + chunk, "{read}");
    assert!(message.contains("Limits::file_bytes"), "{message}");
    // More metadata, or more grids, than may be: what says so.
    for at in [57, 61] {
        let mut many = one_voxel().write(&WriteOptions::default()).unwrap();
        many[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        let (read, result) = intake(&mut Endless { start: &many, read: 0 }, &limits, Some(1 << 30));
        let message = result.unwrap_err().to_string();
        assert!(read <= chunk && message.contains("4294967295"), "{read}: {message}");
    }
    // A grid that says to end far behind the file, or behind the limit.
    let mut far = one_voxel().write(&WriteOptions::default()).unwrap();
    let end = far.len() as u64;
    let at = far.windows(8).rposition(|bytes| bytes == end.to_le_bytes()).unwrap();
    far[at..at + 8].copy_from_slice(&(end + (1 << 40)).to_le_bytes());
    let (read, result) = intake(&mut Endless { start: &far, read: 0 }, &limits, Some(end));
    let message = result.unwrap_err().to_string();
    assert!(read <= chunk && message.contains("the file is cut short: the grid ends"), "{message}");
    let (read, result) = intake(&mut Endless { start: &far, read: 0 }, &limits, None);
    let message = result.unwrap_err().to_string();
    assert!(read <= chunk && message.contains("Limits::file_bytes"), "{message}");
}

/// However a file comes in, it is the same file, and however it is cut short, the same error.
#[test]
fn in_pieces_it_is_the_same_file() {
    for name in ["kinds.vdb", "special_floats.vdb", "empty_and_one.vdb"] {
        let whole = fs::read(Path::new(DATA).join(name)).unwrap();
        let shown = |result: Result<VdbFile, Error>| match result {
            Ok(file) => format!(
                "{:?}",
                file.grids
                    .iter()
                    .map(|grid| (&grid.unique_name, grid.tree.stats()))
                    .collect::<Vec<_>>()
            ),
            Err(error) => error.to_string(),
        };
        let step = (whole.len() / 60).max(1);
        for cut in (0..whole.len()).step_by(step).chain(0..80).chain([whole.len()]) {
            let bytes = &whole[..cut];
            let expected = shown(VdbFile::read(bytes, &ReadOptions::default()));
            for piece in [1, 7, 1000] {
                let mut buffer = FileBuffer::new(Limits::default(), None);
                let mut rest = bytes;
                while let Some(room) = buffer.room().unwrap() {
                    let count = room.len().min(piece).min(rest.len());
                    let (now, later) = rest.split_at(count);
                    room[..count].copy_from_slice(now);
                    rest = later;
                    buffer.filled(count);
                }
                let bytes = buffer.into_bytes();
                assert_eq!(
                    shown(VdbFile::read(&bytes, &ReadOptions::default())),
                    expected,
                    "{name}, {cut}"
                );
            }
        }
    }
}

#[test]
fn metadata_is_counted_as_a_whole() {
    let mut file = one_voxel();
    for number in 0..40 {
        let text = vdb_core::MetaValue::String("x".repeat(1000));
        file.grids[0].metadata.insert(format!("text {number}"), text);
    }
    let bytes = file.write(&WriteOptions::default()).unwrap();
    let mut options = ReadOptions::default();
    options.limits.metadata_bytes = 30_000;
    let message = VdbFile::read(&bytes, &options).unwrap_err().to_string();
    assert!(message.contains("Limits::metadata_bytes"), "{message}");
    let mut options = ReadOptions::default();
    options.limits.metadata_entries = 45;
    VdbFile::read(&bytes, &ReadOptions::default()).unwrap();
    let message = VdbFile::read(&bytes, &options).map(|_| ()).unwrap_err().to_string();
    assert!(message.contains("Limits::metadata_entries"), "{message}");
}

#[test]
fn a_save_replaces_files_alone() {
    let folder = Folder::new("save");
    let file = one_voxel();
    let save = |path: PathBuf| {
        let file = file.clone();
        let name = path.display().to_string();
        soon(&name, move || file.save(path, &WriteOptions::default()))
    };
    let refused = |path: &Path, why: &str| {
        let message = save(path.to_owned()).unwrap_err().to_string();
        assert!(message.starts_with(&path.display().to_string()), "{message}");
        assert!(message.contains(why) && message.lines().count() == 1, "{message}");
    };
    let old = folder.path("old.vdb");
    save(old.clone()).unwrap();
    let path = folder.path("taken");
    fs::create_dir(&path).unwrap();
    refused(&path, "this is a folder");
    refused(&folder.path("no/such/folder.vdb"), "no file can be created in this folder");
    let mut there = vec!["old.vdb", "taken"];
    #[cfg(unix)]
    {
        use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, symlink};
        let pipe = folder.path("pipe.vdb");
        make_pipe(&pipe);
        refused(&pipe, "this is a pipe");
        assert!(fs::symlink_metadata(&pipe).unwrap().file_type().is_fifo());
        // Never found out on the machine's own: only its name is looked at.
        refused(Path::new("/dev/null"), "this is a device");
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
        let socket = folder.path("socket");
        let _listening = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        refused(&socket, "this is a socket");
        // What a link leads to is replaced, and what it leads to and is not there is made.
        symlink("old.vdb", folder.path("link.vdb")).unwrap();
        symlink("new.vdb", folder.path("to_new.vdb")).unwrap();
        symlink("round.vdb", folder.path("round.vdb")).unwrap();
        fs::write(&old, b"old").unwrap();
        save(folder.path("link.vdb")).unwrap();
        save(folder.path("to_new.vdb")).unwrap();
        for name in ["link.vdb", "to_new.vdb"] {
            assert!(fs::symlink_metadata(folder.path(name)).unwrap().is_symlink(), "{name}");
        }
        for name in ["old.vdb", "new.vdb"] {
            assert!(fs::symlink_metadata(folder.path(name)).unwrap().is_file(), "{name}");
            VdbFile::open(folder.path(name)).unwrap();
        }
        refused(&folder.path("round.vdb"), "more links than can be followed");
        // Mode and owner stay; what may not be written to stays as it is.
        for mode in [0o600, 0o640, 0o666, 0o755] {
            fs::set_permissions(&old, fs::Permissions::from_mode(mode)).unwrap();
            // Only root may give files away; where the test is not, they are its own before and after.
            let _ = std::os::unix::fs::chown(&old, Some(12345), Some(54321));
            let before = fs::metadata(&old).unwrap();
            save(old.clone()).unwrap();
            let after = fs::metadata(&old).unwrap();
            assert_eq!(
                (after.mode(), after.uid(), after.gid()),
                (before.mode(), before.uid(), before.gid())
            );
            assert_ne!(after.ino(), before.ino());
        }
        fs::write(&old, b"mine").unwrap();
        fs::set_permissions(&old, fs::Permissions::from_mode(0o444)).unwrap();
        refused(&old, "this file is read-only");
        assert_eq!(fs::read(&old).unwrap(), b"mine");
        // A name as long as names can be has room for no other.
        let long = "x".repeat(251) + ".vdb";
        save(folder.path(&long)).unwrap();
        fs::remove_file(folder.path(&long)).unwrap();
        there.extend(["link.vdb", "new.vdb", "pipe.vdb", "round.vdb", "socket", "to_new.vdb"]);
    }
    there.sort_unstable();
    assert_eq!(folder.names(), there, "something was left lying about");
}

#[test]
fn a_file_that_grows_is_read_as_it_was() {
    let folder = Folder::new("grows");
    let path = folder.path("log.vdb");
    one_voxel().save(&path, &WriteOptions::default()).unwrap();
    let mut file = fs::OpenOptions::new().append(true).open(&path).unwrap();
    file.seek(SeekFrom::End(0)).unwrap();
    file.write_all(&[7; 100_000]).unwrap();
    assert_eq!(VdbFile::open(&path).unwrap().grids.len(), 1);
}
