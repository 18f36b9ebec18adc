//! The state of the panel.

use bevy::prelude::*;

/// The state of the panel: a resource.
#[derive(Clone, Debug, Resource)]
pub struct VdbInspector {
    /// Whether the panel is open, which it is initially.
    pub open: bool,
    /// Whether a timeline is shown at the bottom of the window while the panel is open: that of the
    /// selected volume's [`VdbPlayer`](bevy_vdb::VdbPlayer), or of any player. On by default.
    pub timeline: bool,
    /// The key that toggles the panel. F2 by default.
    pub key: Option<KeyCode>,
    /// The selected [`VdbVolume`](bevy_vdb::VdbVolume); any of the existing ones by default.
    pub volume: Option<Entity>,
    /// The selected camera; the one with the panel by default.
    pub camera: Option<Entity>,
    /// The selected `DirectionalLight`; any of the existing ones by default.
    pub sun: Option<Entity>,
}

impl Default for VdbInspector {
    fn default() -> Self {
        Self {
            open: true,
            timeline: true,
            key: Some(KeyCode::F2),
            volume: None,
            camera: None,
            sun: None,
        }
    }
}
