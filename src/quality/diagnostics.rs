//! Diagnostics: the passes and buffers of each camera, and the reason for each.

use std::sync::{Arc, Mutex, PoisonError};

use bevy::diagnostic::{DiagnosticPath, DiagnosticsStore};
use bevy::platform::collections::HashMap;
use bevy::platform::time::Instant;
use bevy::prelude::*;

/// The passes that volumes add to a view, in order.
pub(crate) const PASSES: [&str; 13] = [
    "vdb_opacity",
    "vdb_cast",
    "vdb_fog_shadows",
    "vdb_light_cache",
    "vdb_scattered_light",
    "vdb_lamp_light",
    "vdb_trace",
    "vdb_edges",
    "vdb_refine",
    "vdb_denoise",
    "vdb_upscale",
    "vdb_accumulate",
    "vdb_composite",
];

/// The path of the GPU time of a pass in Bevy's diagnostics.
fn path(pass: &str) -> DiagnosticPath {
    DiagnosticPath::new(format!("render/{pass}/elapsed_gpu"))
}

/// The latest GPU time of a pass for all cameras together, in milliseconds, and when it arrived.
fn newest(store: &DiagnosticsStore, pass: &str) -> Option<(Instant, f64)> {
    let diagnostic = store.get(&path(pass))?;
    let time = diagnostic.measurement()?.time;
    // A frame has one measurement for each camera, all added at the same time.
    let frame = diagnostic.measurements().filter(|measured| measured.time == time);
    Some((time, frame.map(|measured| measured.value).sum()))
}

/// The passes, features and buffers of each camera for volumes, and the reason for each: a resource
/// of the main world, as of the last prepared frame.
///
/// Pass times are Bevy's diagnostics `render/vdb_trace/elapsed_gpu` and so on, named by
/// [`VdbPassReport::name`]; `RenderDiagnosticsPlugin` adds one measurement per camera and frame.
#[derive(Clone, Debug, Default, Resource)]
pub struct VdbDiagnostics(Arc<Mutex<HashMap<Entity, VdbCameraReport>>>);

impl VdbDiagnostics {
    /// The report of a camera; `None` if the camera sees no volume and therefore has nothing on the
    /// GPU.
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

    /// The GPU time of a pass in the last measured frame, for all cameras together, in
    /// milliseconds. `None` without `RenderDiagnosticsPlugin` or on an adapter without timestamps.
    pub fn pass_ms(store: &DiagnosticsStore, pass: &str) -> Option<f64> {
        newest(store, pass).map(|(_, ms)| ms)
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
    let (time, _) = newest(store, "vdb_trace")?;
    let all = PASSES.iter().filter_map(|pass| newest(store, pass));
    let ms: f64 = all.filter(|(own, _)| *own == time).map(|(_, ms)| ms).sum();
    Some((time, ms as f32))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bevy::diagnostic::{Diagnostic, DiagnosticMeasurement};

    use super::*;

    #[test]
    fn a_frame_takes_the_time_of_all_passes_of_all_cameras() {
        let before = Instant::now();
        let now = before + Duration::from_millis(16);
        let mut store = DiagnosticsStore::default();
        let mut add = |pass: &str, times: &[(Instant, f64)]| {
            let mut diagnostic = Diagnostic::new(path(pass));
            for &(time, value) in times {
                diagnostic.add_measurement(DiagnosticMeasurement { time, value });
            }
            store.add(diagnostic);
        };
        // Two cameras see volumes, and one draws shadows on meshes.
        add("vdb_trace", &[(before, 64.0), (now, 1.0), (now, 2.0)]);
        add("vdb_cast", &[(now, 4.0)]);
        add("vdb_upscale", &[(before, 32.0)]);
        add("main_opaque_pass_3d", &[(now, 16.0)]);
        assert_eq!(VdbDiagnostics::pass_ms(&store, "vdb_trace"), Some(3.0));
        assert_eq!(gpu_time(&store), Some((now, 7.0)));
    }
}
