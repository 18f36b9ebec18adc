//! Files that have been loaded, passed from loader threads to the app.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use bevy::asset::AssetPath;
use bevy::prelude::*;

/// The files loaded since the last check.
#[derive(Clone, Debug, Default, Resource)]
pub(crate) struct LoadedFiles(Arc<Mutex<Vec<LoadedFile>>>);

/// The contents of a file, by label.
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
