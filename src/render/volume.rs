//! One volume as one view sees it: its rays, its matrices, its material.

use bevy::math::{Affine3A, DAffine3, DMat3, DMat4};
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use vdb_core::pack::PackKind;
use vdb_core::view::{GpuRays, LatticeRays, ViewRays};

use super::extract::{ExtractedVolume, non_negative};
use super::gpu_data;
use super::tiles::TileRange;
use super::warnings::{Setting, Trouble, Warned};
use crate::{VdbMaterial, VdbQuality};

// What a shader computes with must not exceed f32, which it may assume: infinities are not for WGSL.
// With these, albedo · light · exposure stays below 10³⁵ under any light that Bevy can be given in
// earnest. No picture shows the difference.

/// Luminance; the sun's surface has 2·10⁹ cd/m².
const MOST_LIGHT: f32 = 1e15;
/// Albedo: one above 1 is not physical, but Bevy's colours allow it.
const MOST_ALBEDO: f32 = 1e6;
/// Extinction per unit of density.
const MOST_EXTINCTION: f32 = 1e30;
/// Anisotropy, in size: beyond, f32 does not tell the directions into which most of the light goes.
const MOST_ANISOTROPY: f32 = 0.99;
/// Cells per edge of the largest nodes below the root.
const LARGEST_NODE: i32 = 4096;

/// What the shader gets of a volume, or nothing if it cannot be shown. Says what is wrong with it if
/// there is someone to tell.
pub(super) fn volume_data(
    entity: MainEntity,
    volume: &ExtractedVolume,
    grid: u32,
    (rays, world_from_view, width): (&ViewRays, DAffine3, u32),
    quality: &VdbQuality,
    warned: Option<&mut Warned>,
) -> Option<gpu_data::Volume> {
    let world_from_index = affine(volume.world_from_local) * volume.local_from_index;
    let lattice = LatticeRays::new(rays, world_from_view, world_from_index, &volume.packed);
    let (quality, wrong) = volume.quality.over(quality).sound();
    if let Some(warned) = warned {
        let shown = match &lattice {
            Ok(rays) => rays.is_coarse(width).then_some(Trouble::Coarse),
            Err(why) => Some(Trouble::NotShown(*why)),
        };
        let setting = wrong_setting(&volume.material).map(Trouble::Setting);
        let quality = wrong.map(Trouble::Quality);
        for trouble in [shown, setting, quality].into_iter().flatten() {
            if let Some(text) = warned.note(entity, &volume.name, trouble) {
                warn!("{text}");
            }
        }
    }
    let rays = lattice.ok()?;
    let normal = rays.normal;
    let lattice = world_from_index.inverse().matrix3;
    let material = &volume.material;
    let kind = match volume.packed.kind {
        PackKind::Surface { .. } => gpu_data::KIND_SURFACE,
        PackKind::Smooth { .. } => gpu_data::KIND_SMOOTH,
        PackKind::Fog => gpu_data::KIND_FOG,
    };
    let array = |v: bevy::math::DVec3| v.as_vec3().to_array();
    let capped = |color: Vec3, most: f32| color.to_array().map(|c| non_negative(c).min(most));
    Some(gpu_data::Volume {
        rays: GpuRays::from(&rays),
        grid,
        kind,
        normal_x: array(normal.x_axis),
        normal_y: array(normal.y_axis),
        normal_z: array(normal.z_axis),
        lattice_x: array(lattice.x_axis),
        lattice_y: array(lattice.y_axis),
        lattice_z: array(lattice.z_axis),
        density_scale: non_negative(material.density_scale).min(MOST_EXTINCTION),
        anisotropy: anisotropy(material.anisotropy),
        perceptual_roughness: share(material.perceptual_roughness),
        metallic: share(material.metallic),
        reflectance: share(material.reflectance),
        base_color: capped(material.base_color.to_linear().to_vec3(), MOST_ALBEDO),
        emissive: capped(material.emissive.to_vec3(), MOST_LIGHT),
        fog_step: quality.fog_step,
        light_step: quality.fog_light_step,
        shadow_step: quality.fog_shadow_step,
        base: volume.packed.base.to_array().map(|b| b.rem_euclid(LARGEST_NODE)),
        ..default()
    })
}

/// The tiles of a picture of so many pixels that show a volume.
pub(super) fn tile_range(
    volume: &ExtractedVolume,
    clip_from_world: DMat4,
    size: UVec2,
) -> TileRange {
    let world_from_index = affine(volume.world_from_local) * volume.local_from_index;
    let packed = &volume.packed;
    let Some(occupied) = packed.occupied else { return TileRange::NONE };
    let origin = packed.base.as_dvec3() + packed.kind.lattice_origin();
    let min = origin + occupied.min.as_dvec3();
    let max = origin + occupied.max.as_dvec3() + 1.0;
    TileRange::of_box(clip_from_world * DMat4::from(world_from_index), min, max, size)
}

/// From 0 to 1; no number is 0.
fn share(x: f32) -> f32 {
    non_negative(x).min(1.0)
}

/// What a shader can compute with; no number is 0.
fn anisotropy(x: f32) -> f32 {
    if x.is_nan() { 0.0 } else { x.clamp(-MOST_ANISOTROPY, MOST_ANISOTROPY) }
}

/// The first setting of a material that makes no sense.
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

pub(super) fn affine(m: Affine3A) -> DAffine3 {
    DAffine3 {
        matrix3: DMat3::from_cols(
            m.matrix3.x_axis.as_dvec3(),
            m.matrix3.y_axis.as_dvec3(),
            m.matrix3.z_axis.as_dvec3(),
        ),
        translation: m.translation.as_dvec3(),
    }
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
