//! What the panel shows.

use bevy::prelude::*;

/// The state of the panel: a resource.
#[derive(Clone, Debug, Resource)]
pub struct VdbInspector {
    /// Whether it is open, as at the start.
    pub open: bool,
    /// The key that opens and closes it. F2 by default.
    pub key: Option<KeyCode>,
    /// The [`VdbVolume`](crate::VdbVolume) whose figures and material are shown; by itself one of those there are.
    pub volume: Option<Entity>,
    /// The camera whose settings are shown; by itself the one that has the panel.
    pub camera: Option<Entity>,
    /// The `DirectionalLight` that is shown; by itself one of those there are.
    pub sun: Option<Entity>,
}

impl Default for VdbInspector {
    fn default() -> Self {
        Self { open: true, key: Some(KeyCode::F2), volume: None, camera: None, sun: None }
    }
}
