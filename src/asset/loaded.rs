//! Which files have been loaded: from the loader's threads to the app.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use bevy::asset::AssetPath;
use bevy::prelude::*;

/// The files that have been loaded since it was last looked.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct LoadedFiles(Arc<Mutex<Vec<LoadedFile>>>);

/// What there is of a file, by label.
#[derive(Debug)]
pub(crate) struct LoadedFile {
    pub path: AssetPath<'static>,
    pub grids: HashSet<String>,
    pub vector_grids: HashSet<String>,
}

impl LoadedFiles {
    pub fn push(&self, file: LoadedFile) {
        let mut files = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        files.retain(|known| known.path != file.path);
        files.push(file);
    }

    pub fn take(&self) -> Vec<LoadedFile> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
