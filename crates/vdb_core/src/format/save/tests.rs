//! Saving with each file-system call failing in turn.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use super::*;

/// The file system with one failing call: the `fails_at`th, counted from 0.
struct Failing {
    calls: Rc<Cell<usize>>,
    fails_at: usize,
    /// The name of each call, and the mode of the temporary file after it.
    seen: RefCell<Vec<(&'static str, u32)>>,
    temporary: RefCell<PathBuf>,
}

struct FailingFile {
    file: File,
    calls: Rc<Cell<usize>>,
    fails_at: usize,
}

/// The most bytes that one call writes, so that there are many calls.
const PIECE: usize = 100;

fn count(calls: &Cell<usize>, fails_at: usize) -> io::Result<()> {
    let call = calls.replace(calls.get() + 1);
    if call == fails_at { Err(io::Error::other("injected")) } else { Ok(()) }
}

impl Write for FailingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let piece = &bytes[..bytes.len().min(PIECE)];
        // A full disk writes only a part.
        if let Err(error) = count(&self.calls, self.fails_at) {
            self.file.write_all(&piece[..piece.len() / 2])?;
            return Err(error);
        }
        self.file.write_all(piece).map(|()| piece.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        count(&self.calls, self.fails_at)
    }
}

impl Failing {
    fn at(fails_at: usize) -> Self {
        let (calls, seen) = (Rc::default(), RefCell::default());
        Self { calls, fails_at, seen, temporary: RefCell::default() }
    }

    fn note(&self, what: &'static str) {
        let mode = fs::metadata(&*self.temporary.borrow()).map_or(0, |metadata| mode(&metadata));
        self.seen.borrow_mut().push((what, mode));
    }

    fn call<T>(&self, what: &'static str, call: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
        count(&self.calls, self.fails_at)?;
        let result = call();
        self.note(what);
        result
    }
}

impl System for Failing {
    type File = FailingFile;

    fn create(&self, path: &Path, replaces: bool) -> io::Result<FailingFile> {
        *self.temporary.borrow_mut() = path.to_owned();
        let (calls, fails_at) = (self.calls.clone(), self.fails_at);
        self.call("create", || Disk.create(path, replaces)).map(|file| FailingFile {
            file,
            calls,
            fails_at,
        })
    }

    fn take_over(&self, file: &FailingFile, old: &Metadata) -> io::Result<()> {
        self.call("take over", || Disk.take_over(&file.file, old))
    }

    fn sync(&self, file: &FailingFile) -> io::Result<()> {
        self.call("sync", || Disk.sync(&file.file))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.call("rename", || Disk.rename(from, to))
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        Disk.remove(path)
    }
}

fn mode(metadata: &Metadata) -> u32 {
    #[cfg(unix)]
    return std::os::unix::fs::PermissionsExt::mode(&metadata.permissions()) & 0o7777;
    #[cfg(not(unix))]
    return u32::from(metadata.permissions().readonly());
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("vdb_core_{name}_{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn whatever_fails_the_old_file_is_whole() {
    let folder = folder("save_fails");
    let path = folder.join("grid.vdb");
    let (old, new) = (vec![b'o'; 5_000], vec![b'n'; 10 * PIECE + 1]);
    for there in [true, false] {
        let mut fails_at = 0;
        loop {
            if there {
                fs::write(&path, &old).unwrap();
            } else {
                let _ = fs::remove_file(&path);
            }
            let metadata = check_target(&path).unwrap();
            let system = Failing::at(fails_at);
            let result = replace(&system, &path, metadata.as_ref(), &new);
            let found = fs::read(&path).ok();
            let left = fs::read_dir(&folder).unwrap().count();
            if result.is_ok() {
                assert_eq!(found.as_ref(), Some(&new));
                assert_eq!(left, 1, "a temporary file is left");
                break;
            }
            let error = result.unwrap_err().to_string();
            assert!(error.ends_with(": injected"), "{error}");
            assert_eq!(found, there.then(|| old.clone()), "call {fails_at}: {error}");
            assert_eq!(left, usize::from(there), "call {fails_at}: a temporary file is left");
            fails_at += 1;
        }
        // create, eleven writes, flush, sync, rename
        assert_eq!(fails_at, 15 + usize::from(there), "calls that were made to fail");
    }
    fs::remove_dir_all(folder).unwrap();
}

#[cfg(unix)]
#[test]
fn the_temporary_file_is_never_open_to_more_than_the_old_one() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder("save_modes");
    let path = folder.join("secret.vdb");
    for own in [0o600, 0o640, 0o664, 0o666, 0o777, 0o200] {
        fs::write(&path, b"old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(own)).unwrap();
        let system = Failing::at(usize::MAX);
        replace(&system, &path, check_target(&path).unwrap().as_ref(), b"new").unwrap();
        assert_eq!(mode(&fs::metadata(&path).unwrap()), own);
        let seen = system.seen.into_inner();
        let calls: Vec<&str> = seen.iter().map(|(call, _)| *call).collect();
        assert_eq!(calls, ["create", "take over", "sync", "rename"]);
        // The last call is the rename, after which the temporary name is gone.
        for (call, mode) in &seen[..3] {
            assert_eq!(mode & !(own | 0o600), 0, "after {call}: {mode:o}, not {own:o}");
        }
        assert_eq!((seen[0].1, seen[1].1), (0o600, own));
    }
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_temporary_file_of_another_run_is_in_nobodys_way() {
    let folder = folder("save_leftover");
    let path = folder.join("grid.vdb");
    // The next numbers, however many other tests have used.
    for number in 0..200 {
        let name = format!(".{}-{number}.vdb.tmp", std::process::id());
        fs::write(folder.join(name), b"left").unwrap();
    }
    replace(&Disk, &path, None, b"new").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"new");
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 201);
    fs::remove_dir_all(folder).unwrap();
}
