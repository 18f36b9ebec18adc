//! The data of a volume in a view: rays, matrices and material.

use bevy::math::{DAffine3, DMat4, DVec3};
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use vdb_core::pack::{PackKind, PackedGrid};
use vdb_core::view::{GpuRays, LatticeRays};

use super::eye::{Eye, Footprint};
use super::materials::material_flags;
use super::tiles::TileRange;
use crate::asset::{corners, index_bounds};
use crate::render::extract::{
    ExtractedRamp, ExtractedVolume, MaterialRow, Setting, Trouble, Warned,
};
use crate::render::gpu::{GridKey, affine, non_negative, types};
use crate::render::pool::VdbTreePool;
use crate::{VdbMaterial, VdbQuality};

// WGSL may assume that there are no infinities, so no value in a shader may exceed f32. With these
// limits, albedo · light · exposure stays below 10³⁵ for any realistic light, and no image changes
// visibly.

/// The largest luminance in cd/m²; the sun's surface has 2·10⁹.
const MAX_LIGHT: f32 = 1e15;
/// The largest albedo. Values above 1 are not physical, but Bevy's colours allow them.
const MAX_ALBEDO: f32 = 1e6;
/// The largest extinction per unit of density.
const MAX_EXTINCTION: f32 = 1e30;
/// The largest absolute value of the anisotropy: beyond, f32 cannot resolve the directions into
/// which most of the light is scattered.
const MAX_ANISOTROPY: f32 = 0.99;

/// A volume at one of its levels of detail.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shown<'a> {
    volume: &'a ExtractedVolume,
    packed: &'a PackedGrid,
    world_from_index: DAffine3,
    key: GridKey,
    /// The index of the grid's header in the pool.
    grid: u32,
    /// The level of detail.
    level: u32,
    /// The depths between which this level represents the volume.
    depths: [f32; 2],
}

impl<'a> Shown<'a> {
    /// The levels that represent a volume, from near to far: at each depth, the coarsest one on the
    /// GPU whose voxels cover no more than `detail` pixels. Fog, and whatever an orthographic camera
    /// sees, has one level for all depths. Empty if the grid itself is not on the GPU.
    pub fn levels(
        volume: &'a ExtractedVolume,
        pool: &VdbTreePool,
        eye: Eye,
        detail: f64,
    ) -> Vec<Self> {
        let Some(finest) = Self::finest(volume, pool) else { return Vec::new() };
        let (most, world_from_index) = (volume.levels.len(), finest.world_from_index);
        let bounds = finest.index_box().filter(|_| most > 0 && detail > 0.0);
        let Some(bounds) = bounds else { return vec![finest] };
        let [near, far] = eye.depths(world_from_index, bounds);
        let footprint = Footprint::new(eye, world_from_index, detail);
        let nearest = (0..=footprint.level(near, most)).rev();
        let mut nearest = nearest.filter_map(|level| finest.at_level(pool, level));
        let mut shown = vec![nearest.next().unwrap_or(finest)];
        if finest.packed.kind == PackKind::Fog {
            return shown;
        }
        for level in shown[0].level as usize + 1..=footprint.level(far, most) {
            let Some(depth) = footprint.depth(level) else { break };
            let Some(next) = finest.at_level(pool, level) else { continue };
            if let Some(before) = shown.last_mut() {
                before.depths[1] = depth;
            }
            shown.push(Self { depths: [depth, types::FARTHEST], ..next });
        }
        shown
    }

    /// A level of the grid, if it is on the GPU.
    fn at_level(self, pool: &VdbTreePool, level: usize) -> Option<Self> {
        let Some(coarser) = level.checked_sub(1) else { return Some(self) };
        let key = self.volume.grid.level(level);
        let scale = DAffine3::from_scale(DVec3::splat(f64::from(1_u32 << level)));
        Some(Self {
            packed: self.volume.levels.get(coarser)?,
            world_from_index: self.world_from_index * scale,
            key,
            grid: pool.index(key)?,
            level: level as u32,
            ..self
        })
    }

    /// The grid itself, if it is on the GPU.
    pub fn finest(volume: &'a ExtractedVolume, pool: &VdbTreePool) -> Option<Self> {
        let world_from_index = affine(volume.world_from_local) * volume.local_from_index;
        let grid = pool.index(volume.grid)?;
        let (packed, key) = (&*volume.packed, volume.grid);
        let depths = [-types::FARTHEST, types::FARTHEST];
        Some(Self { volume, packed, world_from_index, key, grid, level: 0, depths })
    }

    /// The sample format, if the grid has samples.
    pub fn sample_format(&self) -> Option<u32> {
        self.packed.sample_format()
    }

    pub fn world_from_index(&self) -> DAffine3 {
        self.world_from_index
    }

    /// The grid of this level of detail.
    pub fn key(&self) -> GridKey {
        self.key
    }

    pub fn packed(&self) -> &PackedGrid {
        self.packed
    }

    /// The ramp of a fog.
    pub fn ramp(&self) -> Option<&ExtractedRamp> {
        self.volume.ramp.as_ref().map(|own| &*own.ramp)
    }

    /// Identifies what cuts the volume.
    pub fn clip(&self) -> u64 {
        self.volume.clip.content
    }

    /// The custom material.
    pub fn own_material(&self) -> Option<MaterialRow> {
        self.volume.own_material
    }

    /// The box of everything that can stop or dim a ray, in index space.
    pub fn index_box(&self) -> Option<(DVec3, DVec3)> {
        index_bounds(self.packed)
    }

    /// The tiles that show the volume, in an image of `size` pixels.
    pub fn tile_range(&self, clip_from_world: DMat4, size: UVec2) -> TileRange {
        let Some((min, max)) = index_bounds(self.packed) else { return TileRange::NONE };
        TileRange::of_box(clip_from_world * DMat4::from(self.world_from_index), min, max, size)
    }
}

/// The shader data of a volume, or `None` if it cannot be displayed. Warns of problems if `warned`
/// is given.
pub(crate) fn volume_data(
    entity: MainEntity,
    shown: &Shown,
    eye: Eye,
    quality: &VdbQuality,
    warned: Option<&mut Warned>,
) -> Option<types::Volume> {
    let Shown { volume, packed, world_from_index, grid, level, depths, .. } = *shown;
    let lattice = LatticeRays::new(eye.rays, eye.world_from_view, world_from_index, packed);
    let (quality, wrong) = volume.quality.over(quality).sound();
    if let Some(warned) = warned {
        let shown = match &lattice {
            Ok(rays) => rays.is_coarse(eye.size.x).then_some(Trouble::Coarse),
            Err(why) => Some(Trouble::NotShown(*why)),
        };
        let wrong_ramp = volume.ramp.as_ref().is_some_and(|own| own.ramp.is_changed);
        let wrong_ramp = wrong_ramp.then_some(Setting::RampStops);
        let setting = wrong_setting(&volume.material).or(wrong_ramp).map(Trouble::Setting);
        let quality = wrong.map(Trouble::Quality);
        let planes = volume.clip.has_too_many.then_some(Trouble::TooManyPlanes);
        for trouble in [shown, setting, quality, planes].into_iter().flatten() {
            if let Some(text) = warned.note(entity, &volume.name, trouble) {
                warn!("{text}");
            }
        }
    }
    let rays = lattice.ok()?;
    let normal = rays.normal;
    let lattice = world_from_index.inverse().matrix3;
    let material = &volume.material;
    let kind = match packed.kind {
        PackKind::Surface { .. } => types::KIND_SURFACE,
        PackKind::Smooth { .. } => types::KIND_SMOOTH,
        PackKind::Fog => types::KIND_FOG,
    };
    let array = |v: DVec3| v.as_vec3().to_array();
    let capped = |color: Vec3, most: f32| color.to_array().map(|c| non_negative(c).min(most));
    Some(types::Volume {
        rays: GpuRays::from(&rays),
        grid,
        kind,
        normal_x: array(normal.x_axis),
        normal_y: array(normal.y_axis),
        normal_z: array(normal.z_axis),
        lattice_x: array(lattice.x_axis),
        lattice_y: array(lattice.y_axis),
        lattice_z: array(lattice.z_axis),
        density_scale: non_negative(material.density_scale).min(MAX_EXTINCTION),
        anisotropy: anisotropy(material.anisotropy),
        perceptual_roughness: share(material.perceptual_roughness),
        metallic: share(material.metallic),
        reflectance: share(material.reflectance),
        base_color: capped(material.base_color.to_linear().to_vec3(), MAX_ALBEDO),
        emissive: capped(material.emissive.to_vec3(), MAX_LIGHT),
        color_grids: types::NO_COLOR,
        fog_step: quality.fog_step,
        light_step: quality.fog_light_step,
        shadow_step: quality.fog_shadow_step,
        base: packed.base.to_array(),
        flags: flags(volume, quality.smooth_normals, level),
        t_first: depths[0],
        t_end: depths[1],
        clip_planes: volume.clip.planes,
        ..ramp_data(volume)
    })
}

/// The bits of a volume, shown at a level of detail.
fn flags(volume: &ExtractedVolume, has_smooth_normals: bool, level: u32) -> u32 {
    let bits = [
        (!volume.casts, types::NO_CASTER),
        (!volume.receives, types::NO_RECEIVER),
        (has_smooth_normals, types::SMOOTH_NORMALS),
        (volume.is_page, types::PAGE),
    ];
    let set = bits.into_iter().filter(|(is_set, _)| *is_set).map(|(_, bit)| bit).sum::<u32>();
    set | level << types::LEVEL_SHIFT | material_flags(volume.own_material)
}

/// The shader data of a volume's ramp.
fn ramp_data(volume: &ExtractedVolume) -> types::Volume {
    let Some(own) = &volume.ramp else { return default() };
    types::Volume {
        ramp: own.number,
        ramp_low: own.ramp.table.low,
        ramp_scale: own.ramp.table.entries_per_value,
        ramp_emission: if own.ramp.ramp.emits() { volume.share } else { 0.0 },
        ..default()
    }
}

/// The corners of all boxes of a volume in world space: of its grid at every level of detail, and
/// of its emission.
pub(crate) fn world_corners(volume: &ExtractedVolume) -> impl Iterator<Item = DVec3> + use<'_> {
    let world_from_local = affine(volume.world_from_local);
    let levels = [&volume.packed].into_iter().chain(&*volume.levels).enumerate();
    let levels = levels.map(|(level, packed)| {
        let scale = DAffine3::from_scale(DVec3::splat(f64::from(1_u32 << level)));
        (packed, volume.local_from_index * scale)
    });
    let shining =
        volume.auxiliary.emission.iter().map(|part| (&part.packed, part.local_from_index));
    levels.chain(shining).flat_map(move |(packed, local_from_index)| {
        let world_from_index = world_from_local * local_from_index;
        let corners = index_bounds(packed).into_iter().flat_map(corners);
        corners.map(move |at| world_from_index.transform_point3(at))
    })
}

/// Clamps to 0–1; NaN becomes 0.
fn share(x: f32) -> f32 {
    non_negative(x).min(1.0)
}

/// Clamps to the range that shaders can compute with; NaN becomes 0.
fn anisotropy(x: f32) -> f32 {
    if x.is_nan() { 0.0 } else { x.clamp(-MAX_ANISOTROPY, MAX_ANISOTROPY) }
}

/// The first invalid field of a material.
fn wrong_setting(material: &VdbMaterial) -> Option<Setting> {
    let color = |c: LinearRgba| [c.red, c.green, c.blue].iter().all(|&c| c >= 0.0 && c.is_finite());
    let is_share = |x: f32| (0.0..=1.0).contains(&x);
    let settings = [
        (color(material.base_color.to_linear()), Setting::BaseColor),
        (color(material.emissive), Setting::Emissive),
        (is_share(material.perceptual_roughness), Setting::PerceptualRoughness),
        (is_share(material.metallic), Setting::Metallic),
        (is_share(material.reflectance), Setting::Reflectance),
        (
            material.density_scale >= 0.0 && material.density_scale.is_finite(),
            Setting::DensityScale,
        ),
        ((-1.0..=1.0).contains(&material.anisotropy), Setting::Anisotropy),
    ];
    settings.into_iter().find(|(sound, _)| !sound).map(|(_, setting)| setting)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_make_no_sense_are_found() {
        let plain = VdbMaterial::default;
        assert_eq!(wrong_setting(&plain()), None);
        let black =
            VdbMaterial { perceptual_roughness: 0.0, metallic: 1.0, anisotropy: -1.0, ..plain() };
        assert_eq!(wrong_setting(&black), None);
        for x in [f32::NAN, -0.1, 1.1, f32::INFINITY] {
            let found = wrong_setting(&VdbMaterial { perceptual_roughness: x, ..plain() });
            assert_eq!(found, Some(Setting::PerceptualRoughness), "{x}");
            let found = wrong_setting(&VdbMaterial { metallic: x, ..plain() });
            assert_eq!(found, Some(Setting::Metallic), "{x}");
            let found = wrong_setting(&VdbMaterial { reflectance: x, ..plain() });
            assert_eq!(found, Some(Setting::Reflectance), "{x}");
            assert!((0.0..=1.0).contains(&share(x)), "{x}");
        }
        for x in [f32::NAN, -1.1, 1.1, f32::INFINITY] {
            let found = wrong_setting(&VdbMaterial { anisotropy: x, ..plain() });
            assert_eq!(found, Some(Setting::Anisotropy), "{x}");
            assert!(anisotropy(x).abs() < 1.0, "{x}");
        }
        for x in [f32::NAN, -0.1, f32::INFINITY] {
            let color = LinearRgba::rgb(0.0, x, 0.0);
            let found = wrong_setting(&VdbMaterial { base_color: color.into(), ..plain() });
            assert_eq!(found, Some(Setting::BaseColor), "{x}");
            let found = wrong_setting(&VdbMaterial { emissive: color, ..plain() });
            assert_eq!(found, Some(Setting::Emissive), "{x}");
            let found = wrong_setting(&VdbMaterial { density_scale: x, ..plain() });
            assert_eq!(found, Some(Setting::DensityScale), "{x}");
        }
    }
}
