//! Sequences from patterns and folders.

use std::path::Path;
#[cfg(not(target_arch = "wasm32"))]
use std::sync::Arc;

use bevy::asset::io::AssetSourceId;
use bevy::asset::{AssetPath, AssetServer};
#[cfg(not(target_arch = "wasm32"))]
use bevy::asset::{AssetServerMode, io::AssetReaderError};
use bevy::prelude::*;
#[cfg(not(target_arch = "wasm32"))]
use bevy::tasks::futures_lite::StreamExt;
use vdb_core::display::escaped;

use super::super::common::within;
use super::error::VdbSequenceError;
use super::frames::{MOST_FRAMES, VdbFrame, VdbSequence};
use super::pattern::{EXTENSIONS, Pattern, Series, has_place, is_frame, series};

/// Loads sequences: an extension trait for [`AssetServer`].
pub trait VdbAssetServerExt {
    /// Loads the sequence of all files that match a pattern, `"fire/fire_####.vdb"`, or that are in a
    /// folder, `"fire"`.
    ///
    /// The placeholder for the frame number is `####`, `%04d` or Houdini's `$F4`, in the file name. In
    /// a folder, the last digits of a name are the frame number; if the folder has several series of
    /// files, the longest is loaded, and a message says so.
    ///
    /// This takes a string and not an asset path, in which `#` would begin a label. The folder is
    /// listed in the background, by the reader of its asset source; `"remote://fire"` names another
    /// source. A source that cannot list folders, such as one on the web, needs a `.vdbseq` file with
    /// the numbers of the first and the last frame.
    ///
    /// ```no_run
    /// # use bevy::prelude::*;
    /// # use bevy_vdb::prelude::*;
    /// fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    ///     let fire = assets.load_vdb_sequence("fire/fire_####.vdb");
    ///     commands.spawn(VdbPlayer::new(fire));
    /// }
    /// ```
    #[must_use = "dropping the handle releases the sequence"]
    fn load_vdb_sequence(&self, path: impl AsRef<str>) -> Handle<VdbSequence>;
}

impl VdbAssetServerExt for AssetServer {
    fn load_vdb_sequence(&self, path: impl AsRef<str>) -> Handle<VdbSequence> {
        let (server, path) = (self.clone(), path.as_ref().to_owned());
        self.add_async(async move { found(&server, &path).await })
    }
}

/// The sequence that matches a pattern or is in a folder.
async fn found(server: &AssetServer, path: &str) -> Result<VdbSequence, VdbSequenceError> {
    let shown = || escaped(path).to_string();
    let (source, path) = match path.split_once("://") {
        Some((source, path)) => (AssetSourceId::from(source.to_owned()), path),
        None => (AssetSourceId::Default, path),
    };
    let in_source =
        |path: &Path| AssetPath::from_path_buf(path.to_owned()).with_source(source.clone_owned());
    let path = Path::new(path);
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let parent = path.parent().unwrap_or(Path::new(""));
    if parent.to_str().is_some_and(has_place) {
        return Err(VdbSequenceError::Place(shown()));
    }
    if has_place(name) || is_frame(name) {
        let frames = matching(server, &in_source(parent), &Pattern::parse(name)?).await?;
        return Ok(VdbSequence::new(frames));
    }
    let folder = in_source(path);
    let all = series(names(server, &folder, is_frame).await?);
    let Some(longest) = all.first() else { return Err(no_frames(&folder, "#")) };
    if all.len() > 1 {
        tell_of_several(&folder, &all);
    }
    let frame = |(number, name): &(u64, String)| VdbFrame::new(*number, within(&folder, name));
    Ok(VdbSequence::new(longest.frames.iter().map(frame)))
}

/// The frames in a folder whose names match a pattern.
pub(super) async fn matching(
    server: &AssetServer,
    folder: &AssetPath<'static>,
    pattern: &Pattern,
) -> Result<Vec<VdbFrame>, VdbSequenceError> {
    let names = names(server, folder, |name| pattern.number(name).is_some()).await?;
    let frame = |name: &String| Some(VdbFrame::new(pattern.number(name)?, within(folder, name)));
    let frames: Vec<_> = names.iter().filter_map(frame).collect();
    if frames.is_empty() { Err(no_frames(folder, pattern.shown())) } else { Ok(frames) }
}

fn no_frames(folder: &AssetPath, pattern: impl AsRef<str>) -> VdbSequenceError {
    let extensions = EXTENSIONS.iter().map(|own| format!(".{own}")).collect::<Vec<_>>().join(", ");
    let shown = |text: &str| escaped(text).to_string();
    VdbSequenceError::NoFrames(shown(&folder.to_string()), shown(pattern.as_ref()), extensions)
}

fn tell_of_several(folder: &AssetPath, all: &[Series]) {
    let named = |series: &Series| format!("'{}'", escaped(&series.shown));
    let Some((longest, others)) = all.split_first() else { return };
    let rest = others.len().saturating_sub(3);
    let mut others = others.iter().take(3).map(named).collect::<Vec<_>>().join(", ");
    if rest > 0 {
        others += &format!(" and {rest} more");
    }
    warn!(
        "{}: the folder has several series of files; the longest, {} with {} frames, is played, \
         and {others} can be loaded by their patterns",
        escaped(&folder.to_string()),
        named(longest),
        longest.frames.len()
    );
}

/// A folder, as messages show it.
fn shown(folder: &AssetPath) -> String {
    escaped(&folder.to_string()).to_string()
}

/// The names of the wanted files in a folder.
async fn names(
    server: &AssetServer,
    folder: &AssetPath<'static>,
    wanted: impl Fn(&str) -> bool,
) -> Result<Vec<String>, VdbSequenceError> {
    let mut names = Vec::new();
    let take = |path: &Path| {
        if let Some(name) =
            path.file_name().and_then(|name| name.to_str()).filter(|name| wanted(name))
        {
            names.push(name.to_owned());
        }
        let count = names.len() as u64;
        if count > MOST_FRAMES {
            Err(VdbSequenceError::TooMany(shown(folder), count))
        } else {
            Ok(())
        }
    };
    visit(server, folder, take).await?;
    Ok(names)
}

/// Calls `take` with the path of each entry of a folder, and stops at its first error.
#[cfg(not(target_arch = "wasm32"))]
async fn visit(
    server: &AssetServer,
    folder: &AssetPath<'static>,
    mut take: impl FnMut(&Path) -> Result<(), VdbSequenceError>,
) -> Result<(), VdbSequenceError> {
    let failed =
        |error: AssetReaderError| VdbSequenceError::Folder(shown(folder), error.to_string());
    // Bevy's reader of files panics where a folder is not below its own.
    if folder.path().is_absolute() && *folder.source() == AssetSourceId::Default {
        let io = |error: std::io::Error| failed(AssetReaderError::Io(Arc::new(error)));
        for entry in std::fs::read_dir(folder.path()).map_err(io)? {
            take(Path::new(&entry.map_err(io)?.file_name()))?;
        }
        return Ok(());
    }
    let missing = |error: String| VdbSequenceError::Path(shown(folder), error);
    let source = server.get_source(folder.source()).map_err(|error| missing(error.to_string()))?;
    let reader = match server.mode() {
        AssetServerMode::Unprocessed => source.reader(),
        AssetServerMode::Processed => {
            source.processed_reader().map_err(|error| missing(error.to_string()))?
        }
    };
    let mut entries = reader.read_directory(folder.path()).await.map_err(failed)?;
    while let Some(path) = entries.next().await {
        take(&path)?;
    }
    Ok(())
}

/// Fails: browsers have no folders, and futures of their readers cannot be handed to other threads, as
/// [`AssetServer::add_async`] requires.
#[cfg(target_arch = "wasm32")]
async fn visit(
    _: &AssetServer,
    folder: &AssetPath<'static>,
    _: impl FnMut(&Path) -> Result<(), VdbSequenceError>,
) -> Result<(), VdbSequenceError> {
    let why = "browsers have no folders; give `first` and `last` in a .vdbseq file";
    Err(VdbSequenceError::Folder(shown(folder), why.into()))
}
