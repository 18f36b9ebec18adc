//! The trade-off between accuracy and time: settings of cameras and volumes, their automatic
//! adjustment, and their costs.

mod cost;
pub(crate) mod diagnostics;
mod dial;
pub(crate) mod features;
mod levels;
mod memory;
mod settings;

use bevy::asset::AssetEventSystems;
use bevy::prelude::*;

pub(crate) use cost::LeftOut;
pub use cost::{VdbFeatureCost, VdbFeatureCosts, VdbMeasureFeatures};
pub use diagnostics::{
    VdbBufferReport, VdbCameraReport, VdbDiagnostics, VdbFeatureReport, VdbPassReport,
};
pub use dial::VdbDial;
pub(crate) use dial::pixel_size;
pub use memory::VdbGpuMemory;
pub use settings::{VdbQuality, VdbVolumeQuality};

/// Adjusts dials, measures costs, and generates the levels of detail that cameras need.
pub(crate) struct QualityPlugin;

impl Plugin for QualityPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<VdbQuality>()
            .register_type::<VdbVolumeQuality>()
            .register_type::<VdbDial>()
            .register_type::<VdbMeasureFeatures>()
            .register_type::<VdbGpuMemory>()
            .init_resource::<VdbGpuMemory>()
            .init_resource::<VdbDiagnostics>()
            .init_resource::<levels::PendingLevels>()
            .add_systems(PostUpdate, levels::make_levels.before(AssetEventSystems))
            .add_systems(Last, (cost::measure_features, dial::turn_dials).chain());
        // Bevy refuses this once a camera has been spawned; cameras without the component are
        // treated as if they had the default.
        app.try_register_required_components::<Camera3d, VdbQuality>().ok();
    }
}
