//! The rays to a sun from which a lattice is filled: see `light_cache/columns.wgsl`.

use bevy::math::{DAffine3, UVec2, UVec3};
use bevy::prelude::*;
use bytemuck::{Pod, Zeroable};

use super::pipeline::Place;
use crate::render::gpu::MAX_GROUPS;
use crate::render::view::CacheLayout;

/// The planes whose segments one invocation adds up.
const RUN: u32 = 8;
/// The workgroups of the shaders.
const GROUP_SIZE: UVec2 = UVec2::new(16, 4);
/// The most bytes of depths: WebGPU's default limit of a binding.
const MAX_BYTES: u64 = 128 << 20;

/// The struct of `light_cache/columns.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Job {
    pub origin: [f32; 3],
    pub volume: u32,
    pub axis_x: [f32; 3],
    pub step: f32,
    pub axis_y: [f32; 3],
    pub segment: f32,
    pub axis_z: [f32; 3],
    pub planes: u32,
    pub light: [f32; 3],
    pub major: u32,
    pub slopes: [f32; 2],
    pub low_shift: [i32; 2],
    pub high_shift: [i32; 2],
    pub columns: [u32; 2],
    pub is_reversed: u32,
    pub pads: [u32; 3],
    pub place: Place,
}

/// The rays to a sun through the lattice of a fog.
#[derive(Clone, Copy, Debug)]
pub(super) struct SunRays {
    /// Without what does not depend on the sun.
    pub job: Job,
    /// Workgroups for each run of each ray.
    pub groups: UVec3,
    /// Bytes of the depths.
    pub bytes: u64,
}

impl SunRays {
    /// The rays in a direction (world space, unit length); `None` if they would take too much memory, as
    /// those along a thin lattice do.
    pub fn new(layout: CacheLayout, world_from_local: DAffine3, to_sun: Vec3) -> Option<Self> {
        let inverse = world_from_local.matrix3.inverse();
        let to_sun_in_cells = inverse * to_sun.as_dvec3();
        if !(to_sun_in_cells.is_finite() && to_sun_in_cells.length_squared() > 0.0) {
            return None;
        }
        let major = to_sun_in_cells.abs().max_position();
        let [first, second] = [1, 2].map(|next| (major + next) % 3);
        let steepness = to_sun_in_cells[major].abs();
        let slopes =
            [to_sun_in_cells[first], to_sun_in_cells[second]].map(|v| (v / steepness) as f32);
        let samples = layout.samples;
        let planes = samples[major];
        let farthest = slopes.map(|slope| slope * (planes - 1) as f32);
        let low_shift = farthest.map(|shift| shift.min(0.0).floor() as i32);
        let high_shift = farthest.map(|shift| shift.max(0.0).floor() as i32);
        // One more column before the samples, and two after them.
        let columns = [samples[first], samples[second]].map(|n| n + 3);
        let rays = [0, 1].map(|i| columns[i] + high_shift[i].abs_diff(low_shift[i]));
        let runs = planes.div_ceil(RUN);
        let product = |edges: [u32; 3]| {
            edges.into_iter().try_fold(1_u64, |all, edge| all.checked_mul(u64::from(edge)))
        };
        let depths = product([planes, columns[0], columns[1]])?;
        let ends = product([runs, rays[0], rays[1]])?;
        let bytes = depths.checked_add(ends)?.checked_mul(4)?;
        let groups = (UVec2::from(rays) + GROUP_SIZE - 1) / GROUP_SIZE;
        let groups = groups.extend(runs);
        let fits = bytes <= MAX_BYTES && groups.max_element() <= MAX_GROUPS;
        let job = Job {
            segment: (layout.spacing.in_cells() / steepness) as f32,
            light: to_sun.to_array(),
            major: major as u32,
            is_reversed: u32::from(to_sun_in_cells[major] > 0.0),
            slopes,
            low_shift,
            high_shift,
            columns,
            planes,
            ..Job::default()
        };
        fits.then_some(Self { job, groups, bytes })
    }
}

#[cfg(test)]
mod tests {
    use bevy::math::{DMat3, DQuat, DVec3};

    use super::*;

    /// The position of a column in spacings, as the shader computes it.
    fn position(job: &Job, column: [u32; 2], plane: u32) -> DVec3 {
        let major = job.major as usize;
        let mut at = DVec3::ZERO;
        let along = if job.is_reversed == 1 { job.planes - 1 - plane } else { plane };
        at[major] = f64::from(along);
        for i in 0..2 {
            let shift = f64::from(job.slopes[i]) * f64::from(plane);
            at[(major + 1 + i) % 3] = f64::from(column[i]) - 1.0 - (shift - shift.floor());
        }
        at
    }

    #[test]
    fn rays_lead_to_the_sun_from_column_to_column() {
        for to_sun in [(1.0, 2.0, 1.0), (-3.0, 0.5, 1.0), (0.1, -0.7, -2.0), (0.0, 0.0, 1.0)] {
            let to_sun = Vec3::from(to_sun).normalize();
            let turned = DMat3::from_quat(DQuat::from_rotation_x(0.7));
            let world_from_local = DAffine3 {
                matrix3: turned * DMat3::from_diagonal(DVec3::new(0.5, 0.25, 0.3)),
                translation: DVec3::new(3.0, 4.0, 5.0),
            };
            let layout = CacheLayout::of_samples(UVec3::new(25, 33, 41));
            let SunRays { job, groups, bytes } =
                SunRays::new(layout, world_from_local, to_sun).unwrap();
            for plane in 1..job.planes {
                // The column of the same ray in the plane before.
                let shift = |plane: u32| job.slopes.map(|slope| (slope * plane as f32).floor());
                let column = [20, 20];
                let before = [0, 1]
                    .map(|i| (column[i] as f32 + shift(plane)[i] - shift(plane - 1)[i]) as u32);
                let way = position(&job, before, plane - 1) - position(&job, column, plane);
                let way = world_from_local.matrix3 * (way * layout.spacing.in_cells());
                let expected = to_sun.as_dvec3() * f64::from(job.segment);
                assert!(way.distance(expected) < 1e-4 * way.length(), "{way} {expected}");
            }
            // All rays are in the workgroups, and all shifts within the bounds.
            for i in 0..2 {
                let last = job.slopes[i] * (job.planes - 1) as f32;
                assert!((job.low_shift[i]..=job.high_shift[i]).contains(&(last.floor() as i32)));
                let rays = job.columns[i] + (job.high_shift[i] - job.low_shift[i]) as u32;
                assert!(groups[i] * GROUP_SIZE[i] >= rays);
            }
            assert!(groups.z * RUN >= job.planes);
            assert!(bytes >= 4 * u64::from(job.planes * job.columns[0] * job.columns[1]));
        }
    }

    #[test]
    fn rays_that_take_too_much_memory_are_refused() {
        let of = |samples, to_sun: Vec3| {
            let layout = CacheLayout::of_samples(samples);
            SunRays::new(layout, DAffine3::IDENTITY, to_sun.normalize()).is_some()
        };
        assert!(of(UVec3::splat(257), Vec3::new(1.0, 2.0, 1.0)));
        assert!(of(UVec3::new(9, 9, 160_001), Vec3::Y), "across");
        assert!(!of(UVec3::new(9, 9, 160_001), Vec3::new(1.0, 1.0, 1.5)), "along");
        assert!(!of(UVec3::splat(9), Vec3::splat(f32::NAN)));
        assert!(!of(UVec3::splat(u32::MAX / 2), Vec3::Y));
    }
}
