//! What a lattice of optical depths is made from, in one number.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::math::{DAffine3, Vec3};

use crate::quality::features::Features;
use crate::render::gpu::types;
use crate::render::view::{Entry, PreparedView};

/// A number that changes whenever the optical depths towards a directional light may change: with the fog of
/// an entry, with any fog that casts shadows, and with the light.
pub(super) fn fingerprint(prepared: &PreparedView, i: usize, to_light: Vec3) -> u64 {
    let mut hasher = DefaultHasher::new();
    let add_f32 = |hasher: &mut DefaultHasher, x: f32| x.to_bits().hash(hasher);
    to_light.to_array().iter().for_each(|x| add_f32(&mut hasher, *x));
    add_f32(&mut hasher, prepared.data.shadow_range);
    // With multiple scattering, rays go on to larger depths.
    prepared.key.has(Features::MULTIPLE_SCATTERING).hash(&mut hasher);
    add_entry(&mut hasher, &prepared.entries[i]);
    for (volume, entry) in prepared.volumes.iter().zip(&prepared.entries) {
        if volume.kind == types::KIND_FOG && volume.flags & types::NO_CASTER == 0 {
            add_f32(&mut hasher, volume.density_scale);
            add_f32(&mut hasher, volume.shadow_step);
            add_entry(&mut hasher, entry);
        }
    }
    hasher.finish()
}

fn add_entry(hasher: &mut DefaultHasher, entry: &Entry) {
    let DAffine3 { matrix3, translation } = entry.lattice.world_from_local;
    for v in [matrix3.x_axis, matrix3.y_axis, matrix3.z_axis, translation] {
        v.to_array().iter().for_each(|x| x.to_bits().hash(hasher));
    }
    entry.lattice.content.hash(hasher);
}
