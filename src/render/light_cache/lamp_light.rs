//! Which lattices of scattered light a view has: where lamps are far, its rays interpolate the light that a fog
//! scatters towards its eye.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::{DVec3, UVec3};
use bytemuck::{Pod, Zeroable};

use super::atlas::ROW_BRICKS;
use super::lamp_table::LampTable;
use super::lattices::{LatticeKey, LightCache, Source};
use super::lights::CachedLights;
use crate::quality::features::Features;
use crate::render::view::{CacheLayout, CachedFog, PreparedView, cell_edge};

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
            ..Self::default()
        }
    }
}

/// A fog whose samples hold scattered light.
pub(crate) struct LitFog {
    pub samples: Samples,
    pub bricks: UVec3,
}

/// The lattices of scattered light of a view.
#[derive(Default)]
pub(crate) struct LampLight {
    pub fogs: Vec<LitFog>,
    /// Rows of bricks.
    pub rows: u32,
    /// A number that changes whenever the light may change.
    pub fingerprint: u64,
}

impl LampLight {
    /// Plans the lattices of all fogs that lamps reach, up to `max_rows` rows, and tells the shaders where
    /// they are.
    pub(super) fn plan(
        prepared: &PreparedView,
        (fogs, lattices): (&[(usize, CachedFog)], &[(usize, LatticeKey)]),
        lights: &CachedLights,
        cache: &LightCache,
        max_rows: u32,
        table: &mut LampTable,
    ) -> Self {
        let mut own = Self::default();
        if !prepared.key.has(Features::LAMP_LIGHT) {
            return own;
        }
        let octaves = if prepared.key.has(Features::MULTIPLE_SCATTERING) { 3 } else { 1 };
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
            let Some((key, _)) = lamps.first() else { continue };
            let rows = octaves * key.rows_per_light();
            if own.rows.saturating_add(rows) > max_rows {
                continue;
            }
            let edge = cell_edge(&prepared.entries[*i].lattice);
            table.set_scattered(*i, own.rows * ROW_BRICKS, far_from_lamps(fog, edge));
            own.rows += rows;
            let samples = Samples::new(prepared, *i, fog.layout);
            own.fogs.push(LitFog { samples, bricks: fog.layout.bricks });
            bytemuck::bytes_of(&samples).hash(&mut hasher);
            prepared.volumes[*i].anisotropy.to_bits().hash(&mut hasher);
            for (key, slot) in lamps {
                lights.lamps[slot].appearance.hash(&mut hasher);
                cache
                    .lattices
                    .get(key)
                    .map(|lattice| (lattice.rows.start, lattice.fills))
                    .hash(&mut hasher);
            }
        }
        own.fingerprint = hasher.finish();
        own
    }
}

/// The distance from a point light at which its light begins to be interpolated in a fog, in world units.
///
/// Interpolated over a spacing `h`, an inverse square at a distance `d` is up to `0.75 (h / d)²` too large.
/// At this distance, that is about twice the accepted error, of one lamp in one place.
fn far_from_lamps(fog: &CachedFog, cell_edge: f64) -> f32 {
    let spacing = f64::from(1_u32 << fog.layout.log) * cell_edge;
    (spacing * (0.35 / f64::from(fog.error)).sqrt()) as f32
}

fn add_eye(hasher: &mut DefaultHasher, prepared: &PreparedView) {
    let view = &prepared.data;
    prepared.eye.to_array().map(f64::to_bits).hash(hasher);
    view.exposure.to_bits().hash(hasher);
    // All rays of an orthographic view have one direction; those of others turn with it, and light does not.
    if view.eye_x != [0.0; 3] {
        view.dir.map(f32::to_bits).hash(hasher);
    }
}
