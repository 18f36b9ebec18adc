//! Automatic adjustment of a camera's quality to a frame budget or an error bound.

mod controller;

use bevy::camera::primitives::Aabb;
use bevy::diagnostic::DiagnosticsStore;
use bevy::platform::time::Instant;
use bevy::prelude::*;

use crate::quality::diagnostics::gpu_time;
use crate::{VdbDiagnostics, VdbGrid, VdbMeasureFeatures, VdbQuality, VdbVolume};
use controller::{Controller, MARKS};

/// Adjusts the [`VdbQuality`] of a camera automatically. Sets the fog steps, `fog_light_error`,
/// `fog_slabs` and `resolution` along the measured time–error front, and leaves other settings alone.
///
/// In every frame, the dial overrides these settings, whatever else sets them, such as a preset. To
/// return to a preset, remove the dial:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// fn best(mut commands: Commands, camera: Single<Entity, With<Camera3d>>) {
///     commands.entity(*camera).remove::<VdbDial>().insert(VdbQuality::HIGH);
/// }
/// ```
#[derive(Clone, Component, Copy, Debug, PartialEq, Reflect)]
#[reflect(Component, Clone, Debug, PartialEq)]
#[require(VdbDialState)]
#[non_exhaustive]
pub enum VdbDial {
    /// The best quality whose volume passes, for all cameras together, take no more than this GPU
    /// time. Settles within 30 frames after a cut.
    ///
    /// GPU times come from Bevy's `RenderDiagnosticsPlugin`. Without it, or on an adapter without
    /// timestamps, the time between frames is used, with a warning. Much of that may be beyond the
    /// dial's control, such as the app's own systems or vertical sync. If the budget cannot be met,
    /// the dial uses the best quality, [`VdbQuality::HIGH`] at most, that takes no more than 1.35
    /// times as long as the fastest, and tries again at growing intervals.
    Budget {
        /// Milliseconds. More than 0.
        frame_ms: f32,
    },
    /// The fastest settings whose errors stay within this many pixels: rays are `1 + pixels` pixels
    /// apart, at most 4, and no fog step spans more than `pixels` at the near side of the nearest
    /// volume, unless it is as short as in [`VdbQuality::EXACT`]. Fog lit by the light cache keeps
    /// the error of [`VdbQuality::HIGH`].
    MaxError {
        /// 0 or more.
        pixels: f32,
    },
}

/// The state of a dial.
#[derive(Clone, Component, Debug, Default)]
pub(crate) struct VdbDialState {
    controller: Controller,
    last: Option<Instant>,
    warned: bool,
    frames: u32,
}

/// The marks of the dial, from the most accurate to the fastest. The later ones also trace fewer rays,
/// which is the only saving for surfaces.
const DIAL: [VdbQuality; MARKS] = [
    VdbQuality::EXACT,
    VdbQuality::HIGH,
    VdbQuality { fog_step: 0.5, fog_shadow_step: 2.0, ..VdbQuality::HIGH },
    VdbQuality::BALANCED,
    VdbQuality { resolution: 0.7, ..VdbQuality::BALANCED },
    VdbQuality::FAST,
    VdbQuality { fog_step: 4.0, resolution: 0.35, ..VdbQuality::FAST },
    VdbQuality {
        fog_step: 4.0,
        fog_light_step: 16.0,
        fog_slabs: 4,
        resolution: 0.25,
        ..VdbQuality::FAST
    },
];

/// The number of frames without a GPU time after which none is expected.
const PATIENCE: u32 = 30;

/// Adjusts all cameras with a dial.
pub(crate) fn turn_dials(
    mut cameras: Query<
        (
            Entity,
            &VdbDial,
            &mut VdbDialState,
            &mut VdbQuality,
            &Camera,
            &Projection,
            &GlobalTransform,
        ),
        Without<VdbMeasureFeatures>,
    >,
    volumes: Query<(&VdbVolume, &GlobalTransform, &Aabb, &ViewVisibility)>,
    grids: Res<Assets<VdbGrid>>,
    diagnostics: Res<VdbDiagnostics>,
    store: Option<Res<DiagnosticsStore>>,
    time: Option<Res<Time<Real>>>,
) {
    for (entity, dial, mut state, mut quality, camera, projection, view) in &mut cameras {
        let marked = match *dial {
            VdbDial::Budget { frame_ms } => {
                let state = &mut *state;
                let measured = store.as_deref().and_then(gpu_time);
                let ms = match measured {
                    Some((at, ms)) => (state.last.replace(at) != Some(at)).then_some(ms),
                    None if state.frames < PATIENCE => {
                        state.frames += 1;
                        None
                    }
                    None => {
                        if !std::mem::replace(&mut state.warned, true) {
                            warn!(
                                "the dial of camera {entity} uses the time between frames: the \
                                 adapter has no timestamps, or RenderDiagnosticsPlugin is missing"
                            );
                        }
                        time.as_deref().map(|time| 1e3 * time.delta_secs())
                    }
                };
                if diagnostics.camera(entity).is_some_and(|report| report.is_compiling) {
                    state.controller.wait();
                } else if let Some(ms) = ms {
                    state.controller.next(ms, frame_ms);
                }
                DIAL[state.controller.mark()]
            }
            VdbDial::MaxError { pixels } => {
                let height = camera.physical_viewport_size().map_or(1, |size| size.y).max(1);
                let seen = volumes.iter().filter(|(.., visible)| visible.get());
                let finest = seen
                    .filter_map(|(volume, at, aabb, _)| {
                        let grid = grids.get(&volume.0)?;
                        let pixel = pixel_size(projection, height, distance(view, at, aabb));
                        let world = at.affine().matrix3.determinant().abs().cbrt();
                        let voxel =
                            grid.world_from_index().matrix3.determinant().abs().cbrt() as f32;
                        Some(pixel / (world * voxel))
                    })
                    .filter(|voxels| voxels.is_finite())
                    .fold(f32::INFINITY, f32::min);
                within(pixels, if finest.is_finite() { finest } else { 0.0 })
            }
        };
        let turned = VdbQuality {
            fog_step: marked.fog_step,
            fog_light_step: marked.fog_light_step,
            fog_shadow_step: marked.fog_shadow_step,
            fog_light_error: marked.fog_light_error,
            fog_slabs: marked.fog_slabs,
            resolution: marked.resolution,
            ..*quality
        };
        quality.set_if_neq(turned);
    }
}

/// The distance from the eye to a volume's box, in world units.
pub(crate) fn distance(view: &GlobalTransform, volume: &GlobalTransform, aabb: &Aabb) -> f32 {
    let eye = volume.affine().inverse().transform_point3(view.translation());
    let (min, max) = (Vec3::from(aabb.min()), Vec3::from(aabb.max()));
    volume.transform_point(eye.clamp(min, max)).distance(view.translation())
}

/// The size of a pixel at a distance, in world units.
pub(crate) fn pixel_size(projection: &Projection, height: u32, distance: f32) -> f32 {
    let whole = match projection {
        Projection::Perspective(lens) => 2.0 * (0.5 * lens.fov).tan() * distance,
        Projection::Orthographic(lens) => lens.area.height(),
        Projection::Custom(_) => 0.0,
    };
    whole / height as f32
}

/// The fastest settings accurate to this many pixels, where a pixel covers this many voxels.
fn within(pixels: f32, voxels_per_pixel: f32) -> VdbQuality {
    let pixels = if pixels > 0.0 { pixels.min(8.0) } else { 0.0 };
    let voxels = pixels * voxels_per_pixel;
    let exact = VdbQuality::EXACT;
    let step = |least: f32| voxels.clamp(least, 16.0);
    VdbQuality {
        // Shorter steps would take longer than exact integration.
        fog_step: if voxels < 0.5 { 0.0 } else { step(0.5) },
        fog_light_step: step(exact.fog_light_step),
        fog_shadow_step: step(exact.fog_shadow_step),
        fog_light_error: if pixels > 0.0 { VdbQuality::HIGH.fog_light_error } else { 0.0 },
        fog_slabs: if pixels > 0.0 { VdbQuality::HIGH.fog_slabs } else { exact.fog_slabs },
        // Rays are 1 + `pixels` pixels apart.
        resolution: (1.0 / (1.0 + pixels)).max(0.25),
        ..exact
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_marks_can_be_honoured_and_are_ever_coarser() {
        for mark in DIAL {
            assert_eq!(mark.sound(), (mark, None));
        }
        for pair in DIAL.windows(2) {
            let [a, b] = [pair[0], pair[1]];
            assert!(a.fog_light_step <= b.fog_light_step && a.fog_shadow_step <= b.fog_shadow_step);
            assert!(a.fog_step <= b.fog_step && a.fog_slabs >= b.fog_slabs);
            assert!(a.fog_light_error <= b.fog_light_error);
            assert!(a.resolution >= b.resolution && a != b);
        }
    }

    #[test]
    fn an_error_in_pixels_is_kept() {
        for pixels in [0.0, -1.0, f32::NAN] {
            assert_eq!(within(pixels, 100.0), VdbQuality::EXACT);
        }
        for pixels in [0.1, 0.5, 1.0, 2.0, f32::INFINITY] {
            for voxels in [0.0, 0.01, 0.3, 1.0, 10.0, f32::MAX] {
                let found = within(pixels, voxels);
                assert_eq!(found.sound(), (found, None), "{pixels} {voxels}");
                assert!(1.0 / found.resolution - 1.0 <= pixels + 1e-5);
                // Errors beyond 8 pixels are treated as 8.
                assert!(found.fog_step <= pixels.min(8.0) * voxels);
            }
        }
        assert!(
            within(1.0, 8.0).fog_step > within(1.0, 2.0).fog_step,
            "far away, steps are longer"
        );
    }

    #[test]
    fn pixels_are_as_large_as_what_they_show() {
        let lens = PerspectiveProjection { fov: std::f32::consts::FRAC_PI_2, ..default() };
        let size = pixel_size(&Projection::Perspective(lens), 100, 50.0);
        assert!((size - 1.0).abs() < 1e-5, "{size}");
        let view = GlobalTransform::from_xyz(0.0, 0.0, 10.0);
        let aabb = Aabb::from_min_max(Vec3::splat(-1.0), Vec3::splat(1.0));
        let away = distance(&view, &GlobalTransform::from_scale(Vec3::splat(2.0)), &aabb);
        assert!((away - 8.0).abs() < 1e-4, "{away}");
    }
}
