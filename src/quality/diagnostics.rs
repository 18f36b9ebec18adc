//! What volumes cost, for whoever wants to show it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use bevy::diagnostic::{DiagnosticMeasurement, DiagnosticPath, DiagnosticsStore};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;

/// The passes that volumes add to a view, in their order.
pub(crate) const PASSES: [&str; 4] =
    ["vdb_trace", "vdb_upscale", "vdb_accumulate", "vdb_composite"];

/// The last time of a pass on the GPU.
pub(crate) fn newest<'a>(
    store: &'a DiagnosticsStore,
    pass: &str,
) -> Option<&'a DiagnosticMeasurement> {
    store.get(&DiagnosticPath::new(format!("render/{pass}/elapsed_gpu")))?.measurement()
}

/// What each camera has for volumes on the GPU, what it takes, and why it is there: a resource of the
/// app's world, as of the last frame that was prepared.
///
/// Times are Bevy's diagnostics `render/vdb_trace/elapsed_gpu`, and so on by
/// [`VdbPassReport::name`], which `RenderDiagnosticsPlugin` keeps: of all cameras together.
#[derive(Clone, Debug, Default, Resource)]
pub struct VdbDiagnostics(Arc<Mutex<HashMap<Entity, VdbCameraReport>>>);

impl VdbDiagnostics {
    /// Of a camera that sees a volume; `None` of one that sees none, for which there is nothing on the GPU.
    pub fn camera(&self, camera: Entity) -> Option<VdbCameraReport> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&camera).cloned()
    }

    /// All cameras that see a volume.
    pub fn cameras(&self) -> Vec<(Entity, VdbCameraReport)> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all: Vec<_> =
            all.iter().map(|(camera, report)| (*camera, report.clone())).collect();
        all.sort_unstable_by_key(|(camera, _)| *camera);
        all
    }

    /// Milliseconds that a pass took on the GPU in the last frame that was measured, by its name. `None`
    /// without `RenderDiagnosticsPlugin`, or where the adapter has no timestamps.
    pub fn pass_ms(store: &DiagnosticsStore, pass: &str) -> Option<f64> {
        newest(store, pass).map(|measured| measured.value)
    }

    pub(crate) fn set(&self, reports: HashMap<Entity, VdbCameraReport>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = reports;
    }
}

/// What a camera has for volumes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VdbCameraReport {
    /// Volumes in the picture, and grids that shine in them.
    pub volumes: u32,
    /// Those out of it, which shadows and reflections look at.
    pub volumes_beside: u32,
    /// Rays along the width and the height of the picture.
    pub rays: UVec2,
    /// Frames whose mean is shown, with [`VdbQuality::accumulate`](crate::VdbQuality::accumulate), however
    /// many of them still count; 0, where what is shown is this frame alone.
    pub frames: u32,
    /// Whether a pipeline is being compiled, and what was there before is drawn meanwhile.
    pub is_compiling: bool,
    /// What is compiled in.
    pub features: Vec<VdbFeatureReport>,
    /// What is run.
    pub passes: Vec<VdbPassReport>,
    /// What is kept for this camera alone; grids are in [`VdbGpuUsage`](crate::VdbGpuUsage).
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

/// A feature that a camera's shaders have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VdbFeatureReport {
    /// Such as `fog`.
    pub name: &'static str,
    /// What asks for it.
    pub why: &'static str,
}

/// A pass of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VdbPassReport {
    /// As in the paths of Bevy's diagnostics.
    pub name: &'static str,
    /// What asks for it.
    pub why: &'static str,
}

/// A buffer or texture of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VdbBufferReport {
    /// Its label on the GPU.
    pub name: &'static str,
    /// How large it is.
    pub bytes: u64,
    /// What asks for it.
    pub why: &'static str,
}

/// The GPU's newest time for all passes of a frame, in milliseconds, and when it came.
pub(crate) fn gpu_time(store: &DiagnosticsStore) -> Option<(Instant, f32)> {
    let [first, ..] = PASSES;
    let trace = newest(store, first)?;
    let all = PASSES.iter().filter_map(|pass| newest(store, pass));
    let ms: f64 = all.filter(|pass| pass.time == trace.time).map(|pass| pass.value).sum();
    Some((trace.time, ms as f32))
}
