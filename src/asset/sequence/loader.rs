//! The loader of `.vdbseq` files.

use std::sync::{Arc, Weak};

use bevy::asset::io::Reader;
use bevy::asset::{AssetLoader, AssetPath, AssetServer, LoadContext};
use bevy::prelude::*;

use super::super::common::{read_at_most, within};
use super::error::VdbSequenceError;
use super::frames::{VdbFrame, VdbSequence};
use super::list::matching;
use super::text::Description;

/// The largest size of a file in bytes.
const MOST_BYTES: usize = 1 << 16;

/// Loads `.vdbseq` files as [`VdbSequence`]s. Registered by
/// [`VdbRenderPlugin`](crate::VdbRenderPlugin). In `.meta` files it is
/// `"bevy_vdb::VdbSequenceLoader"`.
#[derive(Clone, TypePath)]
#[type_path = "bevy_vdb"]
pub struct VdbSequenceLoader {
    /// The server that lists folders. It holds this loader, so a strong reference would keep both
    /// alive forever.
    server: Weak<AssetServer>,
}

/// The server for [`VdbSequenceLoader`], which lives as long as the app.
#[derive(Resource)]
pub(crate) struct ListingServer(Arc<AssetServer>);

impl ListingServer {
    pub fn new(server: &AssetServer) -> Self {
        Self(Arc::new(server.clone()))
    }

    pub fn loader(&self) -> VdbSequenceLoader {
        VdbSequenceLoader { server: Arc::downgrade(&self.0) }
    }
}

impl AssetLoader for VdbSequenceLoader {
    type Asset = VdbSequence;
    type Settings = ();
    type Error = VdbSequenceError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        _: &(),
        load_context: &mut LoadContext<'_>,
    ) -> Result<VdbSequence, VdbSequenceError> {
        let own = Description::parse(&text(reader).await?)?;
        let path = load_context.path();
        let parent = path.path().parent().unwrap_or(path.path()).join(&own.folder);
        let folder = AssetPath::from_path_buf(parent).with_source(path.source().clone_owned());
        let frames = match (own.range, self.server.upgrade()) {
            (Some((first, last)), _) => {
                let file = |number| within(&folder, &own.pattern.name(number));
                (first..=last).map(|number| VdbFrame::new(number, file(number))).collect()
            }
            (None, Some(server)) => matching(&server, &folder, &own.pattern).await?,
            // The app has ended.
            (None, None) => Vec::new(),
        };
        let mut sequence = VdbSequence::new(frames).with_rate(own.rate).with_repeat(own.repeat);
        sequence.settings = own.settings;
        Ok(sequence)
    }

    fn extensions(&self) -> &[&str] {
        &["vdbseq"]
    }
}

/// The text of a file.
async fn text(reader: &mut dyn Reader) -> Result<String, VdbSequenceError> {
    let bytes = read_at_most(reader, MOST_BYTES as u64).await;
    let bytes = bytes.map_err(|error| VdbSequenceError::Read(error.to_string()))?;
    if bytes.len() > MOST_BYTES {
        return Err(VdbSequenceError::Size(MOST_BYTES));
    }
    String::from_utf8(bytes).map_err(|_| VdbSequenceError::Text)
}
