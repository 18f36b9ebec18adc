//! The mean of reflections over frames, which follows the surfaces that reflect.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::diagnostic::FrameCount;
use bevy::math::DMat4;
use bevy::prelude::*;
use bevy::render::render_resource::TextureFormat;
use bevy::render::renderer::RenderDevice;
use bevy::render::texture::CachedTexture;
use bevy::render::view::ExtractedView;

use crate::quality::features::Features;
use crate::render::extract::{ExtractedMaterials, SceneChanges};
use crate::render::gpu::{affine, lasting_texture, types};
use crate::render::view::{Entry, Lattice, PreparedView};

/// The most frames that a reflection is the mean of, while nothing but the camera changes.
const MAX_FRAMES: u32 = 32;
/// The same while something changes that may be reflected.
const MAX_CHANGING_FRAMES: u32 = 2;

/// What is known of earlier frames of a view.
pub(super) struct History {
    size: UVec2,
    /// Those up to the previous frame and those up to this one, which swap places every frame.
    pub means: [CachedTexture; 2],
    /// The number of frames so far, with this one.
    frame: u32,
    /// Bevy's count of frames when the view was last drawn.
    drawn: u32,
    /// From world to clip space in the frame that was last drawn, without jitter.
    clip_from_world: DMat4,
    /// The hash of what may be reflected.
    fingerprint: u64,
    /// The number of frames since the fingerprint last changed.
    unchanged: u32,
}

impl History {
    fn new(size: UVec2, device: &RenderDevice) -> Self {
        let texture = |label| lasting_texture(label, TextureFormat::Rgba32Uint, size, device);
        Self {
            size,
            means: ["vdb_reflection_means_a", "vdb_reflection_means_b"].map(texture),
            frame: 0,
            drawn: 0,
            clip_from_world: DMat4::IDENTITY,
            fingerprint: 0,
            unchanged: 0,
        }
    }

    /// Continues with frame `now`, and tells the shaders how it follows the previous one.
    pub fn next(
        before: Option<Self>,
        prepared: &mut PreparedView,
        view: &ExtractedView,
        (changes, materials): (&SceneChanges, &ExtractedMaterials),
        now: FrameCount,
        device: &RenderDevice,
    ) -> Self {
        let size = prepared.size();
        let before = before.filter(|before| before.size == size);
        let is_known = before.as_ref().is_some_and(|before| now.0 == before.drawn.wrapping_add(1));
        let mut history = before.unwrap_or_else(|| Self::new(size, device));
        let world_from_view = affine(view.world_from_view.affine());
        let clip_from_world =
            view.clip_from_view.as_dmat4() * DMat4::from(world_from_view.inverse());
        let then_from_now = history.clip_from_world * clip_from_world.inverse();
        let fingerprint = fingerprint(prepared, changes, materials);
        let is_same = fingerprint == history.fingerprint;
        let unchanged = if is_same { history.unchanged.saturating_add(1) } else { 0 };
        prepared.data.then_from_now = then_from_now.as_mat4().to_cols_array_2d();
        prepared.data.max_history_frames =
            if is_known { unchanged.clamp(MAX_CHANGING_FRAMES, MAX_FRAMES) } else { 1 };
        prepared.data.reflection_frame = history.frame;
        history.means.swap(0, 1);
        let frame = history.frame.wrapping_add(1);
        Self { frame, drawn: now.0, clip_from_world, fingerprint, unchanged, ..history }
    }
}

/// The features that change how surfaces and fog are lit.
const LIGHT: Features = Features::LIGHT
    .union(Features::SHADOWS)
    .union(Features::SOFT_SHADOWS)
    .union(Features::LAMPS)
    .union(Features::ENVIRONMENT)
    .union(Features::MULTIPLE_SCATTERING);

/// A hash of what may be reflected, wherever the camera is.
fn fingerprint(
    prepared: &PreparedView,
    changes: &SceneChanges,
    materials: &ExtractedMaterials,
) -> u64 {
    let mut hasher = DefaultHasher::new();
    (changes.grids, changes.lights, changes.casters, materials.changes).hash(&mut hasher);
    (prepared.key.mode, prepared.key.features & LIGHT).hash(&mut hasher);
    let data = &prepared.data;
    (data.sun_count, data.reflections).hash(&mut hasher);
    hash_floats(&[data.exposure, data.shadow_range, data.reflection_range], &mut hasher);
    hash_floats(data.suns.as_flattened(), &mut hasher);
    hash_floats(data.disks.as_flattened(), &mut hasher);
    // The order depends on the camera, so the sum must not depend on it.
    let volumes = prepared.entries.iter().zip(&prepared.volumes);
    volumes.map(hash_of_volume).fold(0, u64::wrapping_add).hash(&mut hasher);
    hasher.finish()
}

fn hash_of_volume((entry, volume): (&Entry, &types::Volume)) -> u64 {
    let mut hasher = DefaultHasher::new();
    let Lattice { world_from_local, ramp, clip, colors, content, .. } = &entry.lattice;
    (entry.owner, volume.kind, ramp, clip, colors, content).hash(&mut hasher);
    world_from_local.to_cols_array().map(f64::to_bits).hash(&mut hasher);
    // Not the level of detail, which depends on the camera.
    let flags = types::NO_CASTER | types::NO_RECEIVER | types::SMOOTH_NORMALS;
    (volume.flags & (flags | u32::MAX << types::MATERIAL_SHIFT)).hash(&mut hasher);
    hash_floats(&volume.base_color, &mut hasher);
    hash_floats(&volume.emissive, &mut hasher);
    let surface = [volume.perceptual_roughness, volume.metallic, volume.reflectance];
    hash_floats(&surface, &mut hasher);
    let fog = [volume.density_scale, volume.anisotropy, volume.background, volume.ramp_emission];
    hash_floats(&fog, &mut hasher);
    hash_floats(&[volume.temperature_scale, volume.temperature_offset], &mut hasher);
    hasher.finish()
}

fn hash_floats(floats: &[f32], hasher: &mut DefaultHasher) {
    floats.iter().for_each(|float| float.to_bits().hash(hasher));
}
