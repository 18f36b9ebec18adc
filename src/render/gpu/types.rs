//! The structs of `assets/shaders/gpu/types.wgsl`, field by field. WGSL aligns a `vec3` to 16
//! bytes, so each is followed by a scalar; a test compares the offsets with those that naga
//! computes.

use bytemuck::{Pod, Zeroable};
use vdb_core::view::GpuRays;

pub(crate) const KIND_SURFACE: u32 = 0;
pub(crate) const KIND_FOG: u32 = 1;
pub(crate) const KIND_SMOOTH: u32 = 2;
pub(crate) const KIND_EMISSION: u32 = 3;
pub(crate) const KIND_BLACKBODY: u32 = 4;
pub(crate) const KIND_COLOR: u32 = 5;

/// [`Volume::color_grids`] of a volume without a colour grid.
pub(crate) const NO_COLOR: u32 = u32::MAX;
/// The kind of an entry that shaders ignore.
pub(crate) const KIND_NONE: u32 = 6;

/// One volume as one view sees it.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Volume {
    pub rays: GpuRays,
    pub normal_x: [f32; 3],
    pub grid: u32,
    pub normal_y: [f32; 3],
    pub kind: u32,
    pub normal_z: [f32; 3],
    pub density_scale: f32,
    pub lattice_x: [f32; 3],
    pub anisotropy: f32,
    pub lattice_y: [f32; 3],
    pub perceptual_roughness: f32,
    pub lattice_z: [f32; 3],
    pub metallic: f32,
    pub base_color: [f32; 3],
    pub reflectance: f32,
    pub emissive: [f32; 3],
    pub tiles_first: u32,
    pub base: [i32; 3],
    pub tiles_last: u32,
    pub color_grids: u32,
    pub background: f32,
    pub temperature_scale: f32,
    pub temperature_offset: f32,
    pub box_min: [f32; 3],
    pub flags: u32,
    pub box_max: [f32; 3],
    pub fog_step: f32,
    pub node_min: [f32; 3],
    pub light_step: f32,
    pub node_max: [f32; 3],
    pub shadow_step: f32,
    pub light_origin: [i32; 3],
    pub light_scale: f32,
    pub light_texel: [f32; 3],
    pub light_planes: u32,
    pub ramp: u32,
    pub ramp_low: f32,
    pub ramp_scale: f32,
    pub ramp_emission: f32,
    pub t_first: f32,
    pub t_end: f32,
    pub clip_planes: u32,
    pub scattered: u32,
}

/// The largest length of a ray in world units: `FAR` in the shaders.
pub(crate) const FARTHEST: f32 = 1e30;

/// The roughness below which a surface reflects as a mirror: `is_mirror` in `trace/shade.wgsl`.
pub(crate) const MIRROR_ROUGHNESS: f32 = 0.089;

/// Bits of [`Volume::flags`].
pub(crate) const NO_CASTER: u32 = 1;
pub(crate) const NO_RECEIVER: u32 = 2;
pub(crate) const SMOOTH_NORMALS: u32 = 4;
pub(crate) const PAGE: u32 = 8;
/// Where [`Volume::flags`] have the level of detail.
pub(crate) const LEVEL_SHIFT: u32 = 8;
/// Where [`Volume::flags`] have the number of the custom material, in 16 bits.
pub(crate) const MATERIAL_SHIFT: u32 = 16;

/// The largest number of directional lights of a view, as in Bevy.
pub(crate) const MAX_SUNS: usize = 10;

/// The largest number of directional lights in the light cache.
pub(crate) const MAX_CACHED_SUNS: usize = 4;

/// The largest number of point and spot lights in the light cache.
pub(crate) const MAX_CACHED_LAMPS: usize = 32;

/// The largest number of clip planes: a bit each in [`Volume::clip_planes`].
pub(crate) const MAX_CLIP_PLANES: usize = 32;

/// The largest number of lights of fires whose highlights a view leaves to reflections.
pub(crate) const MAX_FIRE_LIGHTS: usize = 32;

/// The largest number of lattices of scattered light in a view.
pub(crate) const MAX_SCATTERED_LIGHTS: usize = 16;

/// A lattice of scattered light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct ScatteredLattice {
    pub x: [f32; 4],
    pub y: [f32; 4],
    pub z: [f32; 4],
    pub size: [f32; 3],
    pub first: f32,
    pub scale: [f32; 3],
    pub channels: u32,
}

/// The uniform of a view.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct View {
    pub t_from_depth: [f32; 4],
    pub depth_from_t: [f32; 4],
    pub dir: [f32; 3],
    pub t_near: f32,
    pub dir_x: [f32; 3],
    pub t_far: f32,
    pub dir_y: [f32; 3],
    pub exposure: f32,
    pub eye: [f32; 3],
    pub volume_first: u32,
    pub eye_x: [f32; 3],
    pub volume_count: u32,
    pub eye_y: [f32; 3],
    pub offscreen_count: u32,
    pub size: [u32; 2],
    pub origin: [u32; 2],
    pub mode_scale: f32,
    pub reflections: u32,
    pub overlays: u32,
    pub sun_count: u32,
    pub slabs: u32,
    pub tile_words: u32,
    pub group_bits: u32,
    pub has_tile_starts: u32,
    pub picture: [u32; 2],
    pub shadow_range: f32,
    pub reflection_range: f32,
    pub suns: [[f32; 4]; MAX_SUNS],
    pub disks: [[f32; 4]; MAX_SUNS],
    pub random_offset: f32,
    pub frame: u32,
    pub jitter: [f32; 2],
    pub max_frames: u32,
    pub cached_sun_count: u32,
    pub edge_samples: u32,
    pub fire_light_count: u32,
    pub cached_suns: [[f32; 4]; MAX_CACHED_SUNS],
    pub light_texel: [f32; 3],
    pub cached_lamp_count: u32,
    pub cached_lamps: [[u32; 4]; MAX_CACHED_LAMPS / 4],
    pub fire_lights: [[u32; 4]; MAX_FIRE_LIGHTS / 4],
    pub clip_planes: [[f32; 4]; MAX_CLIP_PLANES],
    pub scattered: [ScatteredLattice; MAX_SCATTERED_LIGHTS],
    pub then_from_now: [[f32; 4]; 4],
    pub reflection_frame: u32,
    pub max_history_frames: u32,
    pub padding: [u32; 2],
}

/// The rectangle of the traced image in the target.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Placement {
    pub origin: [u32; 2],
    pub size: [u32; 2],
}

/// Where the opacity map of a fog is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct OpacityMap {
    pub origin: [u32; 2],
    pub size: [u32; 2],
    pub first_texel: [f32; 2],
    pub spacing: [f32; 2],
    pub t_first: f32,
    pub t_last: f32,
}

/// The velocities within a volume, for motion vectors.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Velocities {
    pub lattice_from_clip: [[f32; 4]; 4],
    pub clip_from_mean: [[f32; 4]; 3],
    pub size: [u32; 3],
    pub first: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use naga::{Module, TypeInner};
    use naga_oil::compose::{
        ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderLanguage,
    };
    use std::mem::offset_of;
    use vdb_core::pack::GridHeader;

    /// Composes a module that uses structs of `types.wgsl`; unused ones would be omitted.
    fn compose(text: &str) -> Module {
        let mut composer = Composer::default();
        let source = include_str!("../../../assets/shaders/gpu/types.wgsl");
        let types = ComposableModuleDescriptor {
            source,
            file_path: "types.wgsl",
            language: ShaderLanguage::Wgsl,
            ..Default::default()
        };
        composer.add_composable_module(types).map(drop).unwrap();
        let using = NagaModuleDescriptor { source: text, file_path: "test", ..Default::default() };
        composer.make_naga_module(using).unwrap()
    }

    fn check(module: &Module, name: &str, size: usize, fields: &[(&str, usize)]) {
        let found = module.types.iter().find_map(|(_, ty)| match (&ty.name, &ty.inner) {
            (Some(own), TypeInner::Struct { members, span }) if own.contains(name) => {
                Some((members, *span))
            }
            _ => None,
        });
        let (members, span) = found.unwrap_or_else(|| panic!("no struct {name}"));
        let theirs: Vec<(&str, usize)> = members
            .iter()
            .map(|member| (member.name.as_deref().unwrap(), member.offset as usize))
            .collect();
        assert_eq!(theirs, fields, "the fields of {name}");
        assert_eq!(span as usize, size, "the size of {name}");
    }

    macro_rules! fields {
        ($ty:ty: $($field:ident),*) => {
            [$((stringify!($field), offset_of!($ty, $field))),*]
        };
    }

    #[test]
    fn structs_have_the_layout_of_the_shaders() {
        let module = compose(
            "#import bevy_vdb::gpu::types::{Grid, OpacityMap, View, Volume}
             @group(0) @binding(0) var<storage, read> grids: array<Grid>;
             @group(0) @binding(1) var<storage, read> volumes: array<Volume>;
             @group(0) @binding(2) var<uniform> view: View;
             @group(0) @binding(3) var<storage, read> opacity_maps: array<OpacityMap>;
             @compute @workgroup_size(1) fn main() {
                 let sum = grids[0].top + volumes[0].grid + view.volume_count + opacity_maps[0].size.x;
             }",
        );
        let grid = fields!(GridHeader: top_origin, top_levels, occupied_min, top,
            occupied_max, lower_nodes, heads, masks, leaf_records, records, samples, palette, format,
            brick_words, scale, ramp, ramp_low, ramp_scale);
        check(&module, "Grid", size_of::<GridHeader>(), &grid);
        let rays = fields!(GpuRays: eye_cell, eye_frac, eye_x, eye_y, dir, dir_rest, dir_x, dir_y);
        check(&module, "Rays", size_of::<GpuRays>(), &rays);
        let volume = fields!(Volume: rays, normal_x, grid, normal_y, kind, normal_z,
            density_scale, lattice_x, anisotropy, lattice_y, perceptual_roughness, lattice_z,
            metallic, base_color, reflectance, emissive, tiles_first, base, tiles_last, color_grids,
            background, temperature_scale, temperature_offset, box_min, flags, box_max, fog_step,
            node_min, light_step, node_max, shadow_step, light_origin, light_scale,
            light_texel, light_planes, ramp, ramp_low, ramp_scale, ramp_emission, t_first, t_end,
            clip_planes, scattered);
        check(&module, "Volume", size_of::<Volume>(), &volume);
        let view = fields!(View: t_from_depth, depth_from_t, dir, t_near, dir_x, t_far, dir_y,
            exposure, eye, volume_first, eye_x, volume_count, eye_y, offscreen_count, size, origin,
            mode_scale, reflections, overlays, sun_count, slabs, tile_words, group_bits,
            has_tile_starts, picture, shadow_range, reflection_range, suns, disks, random_offset,
            frame, jitter, max_frames, cached_sun_count, edge_samples, fire_light_count, cached_suns,
            light_texel, cached_lamp_count, cached_lamps, fire_lights, clip_planes,
            scattered, then_from_now, reflection_frame, max_history_frames);
        let map = fields!(OpacityMap: origin, size, first_texel, spacing, t_first, t_last);
        check(&module, "OpacityMap", size_of::<OpacityMap>(), &map);
        let lattice = fields!(ScatteredLattice: x, y, z, size, first, scale, channels);
        check(&module, "ScatteredLattice", size_of::<ScatteredLattice>(), &lattice);
        check(&module, "View", size_of::<View>(), &view);
    }
}
