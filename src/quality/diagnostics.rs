//! Diagnostics: the passes and buffers of each camera, and the reason for each.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use bevy::diagnostic::{DiagnosticMeasurement, DiagnosticPath, DiagnosticsStore};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;

/// The passes that volumes add to a view, in order.
pub(crate) const PASSES: [&str; 6] = [
    "vdb_light_cache",
    "vdb_lamp_light",
    "vdb_trace",
    "vdb_upscale",
    "vdb_accumulate",
    "vdb_composite",
];

/// The latest GPU time of a pass.
pub(crate) fn newest<'a>(
    store: &'a DiagnosticsStore,
    pass: &str,
) -> Option<&'a DiagnosticMeasurement> {
    store.get(&DiagnosticPath::new(format!("render/{pass}/elapsed_gpu")))?.measurement()
}

/// The passes, features and buffers of each camera for volumes, and the reason for each: a resource
/// of the main world, as of the last prepared frame.
///
/// Pass times are Bevy's diagnostics `render/vdb_trace/elapsed_gpu` and so on, by
/// [`VdbPassReport::name`], which `RenderDiagnosticsPlugin` measures for all cameras together.
#[derive(Clone, Debug, Default, Resource)]
pub struct VdbDiagnostics(Arc<Mutex<HashMap<Entity, VdbCameraReport>>>);

impl VdbDiagnostics {
    /// The report of a camera; `None` if the camera sees no volume, in which case it has nothing on
    /// the GPU.
    pub fn camera(&self, camera: Entity) -> Option<VdbCameraReport> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&camera).cloned()
    }

    /// The reports of all cameras that see a volume.
    pub fn cameras(&self) -> Vec<(Entity, VdbCameraReport)> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all: Vec<_> =
            all.iter().map(|(camera, report)| (*camera, report.clone())).collect();
        all.sort_unstable_by_key(|(camera, _)| *camera);
        all
    }

    /// The GPU time of a pass in the last measured frame, in milliseconds. `None` without
    /// `RenderDiagnosticsPlugin` or on an adapter without timestamps.
    pub fn pass_ms(store: &DiagnosticsStore, pass: &str) -> Option<f64> {
        newest(store, pass).map(|measured| measured.value)
    }

    pub(crate) fn set(&self, reports: HashMap<Entity, VdbCameraReport>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = reports;
    }
}

/// The passes, features and buffers of a camera for volumes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VdbCameraReport {
    /// The number of visible volumes and emission grids.
    pub volumes: u32,
    /// The number of volumes out of view that appear in shadows or reflections.
    pub volumes_beside: u32,
    /// Rays along the width and height of the image.
    pub rays: UVec2,
    /// The number of frames whose mean is displayed, with
    /// [`VdbQuality::accumulate`](crate::VdbQuality::accumulate); 0 if only the current frame is.
    pub frames: u32,
    /// Whether a pipeline is being compiled while an earlier one draws.
    pub is_compiling: bool,
    /// The features compiled into the shaders.
    pub features: Vec<VdbFeatureReport>,
    /// The passes that run.
    pub passes: Vec<VdbPassReport>,
    /// Buffers and textures of this camera alone. For grids, see
    /// [`VdbGpuUsage`](crate::VdbGpuUsage).
    pub buffers: Vec<VdbBufferReport>,
}

impl VdbCameraReport {
    /// Bytes of all buffers and textures.
    pub fn bytes(&self) -> u64 {
        self.buffers.iter().map(|buffer| buffer.bytes).sum()
    }

    /// Whether a feature is compiled in.
    pub fn has(&self, feature: &str) -> bool {
        self.features.iter().any(|own| own.name == feature)
    }
}

/// A feature of a camera's shaders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VdbFeatureReport {
    /// The name, such as `fog`.
    pub name: &'static str,
    /// The setting or component that requires it.
    pub why: &'static str,
}

/// A pass of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VdbPassReport {
    /// The name, as in the paths of Bevy's diagnostics.
    pub name: &'static str,
    /// The setting or component that requires it.
    pub why: &'static str,
}

/// A buffer or texture of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VdbBufferReport {
    /// The label on the GPU.
    pub name: &'static str,
    /// The size in bytes.
    pub bytes: u64,
    /// The setting or component that requires it.
    pub why: &'static str,
}

/// The latest GPU time of all passes of a frame, in milliseconds, and when it arrived.
pub(crate) fn gpu_time(store: &DiagnosticsStore) -> Option<(Instant, f32)> {
    let trace = newest(store, "vdb_trace")?;
    let all = PASSES.iter().filter_map(|pass| newest(store, pass));
    let ms: f64 = all.filter(|pass| pass.time == trace.time).map(|pass| pass.value).sum();
    Some((trace.time, ms as f32))
}
