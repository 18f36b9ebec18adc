//! What a lattice of optical depths is made from, in one number.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::DAffine3;

use crate::quality::features::Features;
use crate::render::gpu::types;
use crate::render::view::{Entry, Lattice, PreparedView};

/// Numbers that change whenever the optical depths in a view may change.
pub(crate) struct Fingerprints {
    /// Of all that is common to the view's fogs and lights, in any order of the list.
    common: u64,
    applied: Applied,
}

/// What the pipelines apply: others may fill the cache while those of a view are being compiled.
#[derive(Clone, Copy)]
struct Applied {
    clips: bool,
    ramps: bool,
    /// Kinds of custom materials, a bit each.
    materials: u32,
}

impl Fingerprints {
    pub fn new(prepared: &PreparedView) -> Self {
        let mut common = DefaultHasher::new();
        let has = |feature| prepared.key.has(feature);
        let applied = Applied {
            clips: has(Features::CLIPPED),
            ramps: has(Features::RAMPS),
            materials: if has(Features::FOG_MATERIALS) { prepared.key.materials } else { 0 },
        };
        prepared.data.shadow_range.to_bits().hash(&mut common);
        // With multiple scattering, rays go on to larger depths.
        has(Features::MULTIPLE_SCATTERING).hash(&mut common);
        let mut common = common.finish();
        for (volume, entry) in prepared.volumes.iter().zip(&prepared.entries) {
            if volume.kind == types::KIND_FOG && volume.flags & types::NO_CASTER == 0 {
                let mut caster = DefaultHasher::new();
                volume.density_scale.to_bits().hash(&mut caster);
                volume.shadow_step.to_bits().hash(&mut caster);
                applied.add_entry(&mut caster, entry);
                // The order of the list differs from view to view, and changes as cameras turn.
                common = common.wrapping_add(caster.finish());
            }
        }
        Self { common, applied }
    }

    /// A number that changes with the fog of an entry, with any fog that casts shadows, and with a
    /// light: the direction to a sun, or the position and range of a lamp.
    pub fn of(&self, entry: &Entry, light: &[f64]) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.common.hash(&mut hasher);
        light.iter().for_each(|v| v.to_bits().hash(&mut hasher));
        self.applied.add_entry(&mut hasher, entry);
        hasher.finish()
    }
}

impl Applied {
    fn add_entry(self, hasher: &mut DefaultHasher, entry: &Entry) {
        let DAffine3 { matrix3, translation } = entry.lattice.world_from_local;
        for v in [matrix3.x_axis, matrix3.y_axis, matrix3.z_axis, translation] {
            v.to_array().map(f64::to_bits).hash(hasher);
        }
        let Lattice { content, ramp, material, clip, .. } = entry.lattice;
        let material = material.filter(|own| self.materials >> own.kind & 1 != 0);
        let ramp = ramp.filter(|_| self.ramps);
        let clip = if self.clips { clip } else { 0 };
        (content, ramp, material.map(|own| own.content), clip).hash(hasher);
    }
}
