//! Which lattices of scattered light a view has: where lamps are far, its rays interpolate the light that a fog
//! scatters towards its eye.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::{DVec3, UVec3};
use bytemuck::{Pod, Zeroable};

use super::atlas::packed;
use super::lamp_table::LampTable;
use super::lattices::{LatticeKey, LightCache, Source};
use super::lights::CachedLights;
use super::packing::Packing;
use crate::quality::features::Features;
use crate::render::view::{CacheLayout, CachedFog, PreparedView};

/// The struct of `trace/lamp_light.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Samples {
    pub origin: [f32; 3],
    pub volume: u32,
    pub axis_x: [f32; 3],
    pub pad_x: u32,
    pub axis_y: [f32; 3],
    pub pad_y: u32,
    pub axis_z: [f32; 3],
    pub pad_z: u32,
    pub count: [u32; 3],
    pub pad: u32,
}

impl Samples {
    /// The samples of the fog with index `i` in a view's list.
    pub fn new(prepared: &PreparedView, i: usize, layout: CacheLayout) -> Self {
        let world_from_local = prepared.entries[i].lattice.world_from_local;
        let array = |v: DVec3| v.as_vec3().to_array();
        let origin = world_from_local.transform_point3(layout.origin.as_dvec3()) - prepared.eye;
        let axes = world_from_local.matrix3;
        Self {
            origin: array(origin),
            volume: i as u32,
            axis_x: array(axes.x_axis),
            axis_y: array(axes.y_axis),
            axis_z: array(axes.z_axis),
            count: layout.samples.to_array(),
            ..Self::default()
        }
    }
}

/// The lattices of scattered light of a view.
#[derive(Default)]
pub(crate) struct LampLight {
    /// The fogs whose samples hold scattered light.
    pub fogs: Vec<Samples>,
    /// The size of the texture.
    pub size: UVec3,
    /// A number that changes whenever the light may change.
    pub fingerprint: u64,
}

impl LampLight {
    /// Plans the lattices of all fogs that lamps reach, in a texture that may not grow beyond that of
    /// `packing`, and tells the shaders where they are.
    pub(super) fn plan(
        prepared: &PreparedView,
        (fogs, lattices): (&[(usize, CachedFog)], &[(usize, LatticeKey)]),
        lights: &CachedLights,
        cache: &LightCache,
        mut packing: Packing,
        table: &mut LampTable,
    ) -> Self {
        let mut own = Self::default();
        if !prepared.key.has(Features::LAMP_LIGHT) {
            return own;
        }
        let kinds = if prepared.key.has(Features::SCATTERED_LIGHT) { 3 } else { 1 };
        let mut hasher = DefaultHasher::new();
        add_eye(&mut hasher, prepared);
        for (i, fog) in fogs {
            let lamps: Vec<_> = lattices
                .iter()
                .filter(|(owner, _)| owner == i)
                .filter_map(|(_, key)| match key.source {
                    Source::Lamp(entity) => Some((key, lights.slot_of(entity)?)),
                    Source::Suns(_) => None,
                })
                .collect();
            if lamps.is_empty() {
                continue;
            }
            let samples = fog.layout.samples;
            let Some(origin) = packing.place_or_grow(samples.with_z(samples.z * kinds)) else {
                continue;
            };
            let spacing = spacing(prepared, *i, fog);
            let anisotropy = prepared.volumes[*i].anisotropy;
            let far_from_eye = far_by_angle(spacing, fog.error, anisotropy);
            let far_from_lamps = far_from_lamps(spacing, fog.error).max(far_from_eye);
            // All rays of an orthographic view have one direction.
            let far_from_eye = if is_orthographic(prepared) { 0.0 } else { far_from_eye };
            let distances = [far_from_lamps, far_from_eye].map(|far| far as f32);
            table.set_scattered(*i, packed(origin), distances);
            (origin, fog.layout, distances.map(f32::to_bits)).hash(&mut hasher);
            let samples = Samples::new(prepared, *i, fog.layout);
            own.fogs.push(samples);
            bytemuck::bytes_of(&samples).hash(&mut hasher);
            anisotropy.to_bits().hash(&mut hasher);
            prepared.volumes[*i].base_color.map(f32::to_bits).hash(&mut hasher);
            for (key, slot) in lamps {
                lights.lamps[slot].appearance.hash(&mut hasher);
                cache
                    .lattices
                    .get(key)
                    .map(|lattice| (lattice.origin, lattice.fill))
                    .hash(&mut hasher);
            }
        }
        own.size = packing.size();
        own.fingerprint = hasher.finish();
        own
    }
}

/// The distance between the samples of a fog, in world units.
fn spacing(prepared: &PreparedView, i: usize, fog: &CachedFog) -> f64 {
    fog.layout.spacing.in_cells() * prepared.entries[i].lattice.cell_edge()
}

/// The distance from a point light at which its light begins to be interpolated in an isotropic fog, in
/// world units.
///
/// Interpolated over a spacing `h`, an inverse square at a distance `d` is up to `0.75 (h / d)²` too large.
/// At this distance, that is about twice the accepted error, of one lamp in one place.
fn far_from_lamps(spacing: f64, error: f32) -> f64 {
    spacing * (0.35 / f64::from(error)).sqrt()
}

/// The distance from a lamp or the eye at which light scattered with an anisotropy `g` begins to be
/// interpolated, in world units.
///
/// From one sample to the next, the angle between lamp and eye changes by `δ = h / d`. Interpolated over `δ`,
/// the peak of the phase function of Henyey and Greenstein, whose second derivative is `-3 |g| / (1 - |g|)²`
/// of its value, is up to `3 |g| δ² / (8 (1 - |g|)²)` too low. At this distance, that is about twice the
/// accepted error.
fn far_by_angle(spacing: f64, error: f32, anisotropy: f32) -> f64 {
    let g = f64::from(anisotropy.abs());
    spacing * (3.0 * g / (16.0 * f64::from(error))).sqrt() / (1.0 - g)
}

fn is_orthographic(prepared: &PreparedView) -> bool {
    prepared.data.eye_x != [0.0; 3]
}

fn add_eye(hasher: &mut DefaultHasher, prepared: &PreparedView) {
    let view = &prepared.data;
    prepared.eye.to_array().map(f64::to_bits).hash(hasher);
    view.exposure.to_bits().hash(hasher);
    // All rays of an orthographic view have one direction; those of others turn with it, and light does not.
    if is_orthographic(prepared) {
        view.dir.map(f32::to_bits).hash(hasher);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The phase function of Henyey and Greenstein, up to a factor.
    fn phase(g: f64, angle: f64) -> f64 {
        (1.0 + g * g - 2.0 * g * angle.cos()).powf(-1.5)
    }

    #[test]
    fn light_is_interpolated_where_the_error_is_small() {
        let (spacing, error) = (0.3, 0.01);
        let far = far_from_lamps(spacing, error);
        let inverse_square = |d: f64| 1.0 / (d * d);
        // Samples on either side of a point at this distance.
        let [low, high] = [far - spacing / 2.0, far + spacing / 2.0].map(inverse_square);
        let off = (low + high) / 2.0 / inverse_square(far) - 1.0;
        assert!((0.5..2.5).contains(&(off / f64::from(error))), "{off}");
        for g in [0.3, 0.6, 0.8, 0.95] {
            let angle = spacing / far_by_angle(spacing, error, g as f32);
            let off = 1.0 - phase(g, angle / 2.0) / phase(g, 0.0);
            assert!((1.0..2.5).contains(&(off / f64::from(error))), "{g}: {off}");
        }
        assert_eq!(far_by_angle(spacing, error, 0.0), 0.0);
    }
}
