// The material of a surface at a hit: that of the volume, changed by the custom function if it has one.
#define_import_path bevy_vdb::trace::material

#import bevy_vdb::material::VdbSurface
#import bevy_vdb::trace::segment::Segment
#import bevy_vdb::trace::surface::{Surface, visible_normal}
#import bevy_vdb::view::scene::volumes
#ifdef VDB_COLORS
#import bevy_vdb::trace::color::color_along
#endif
#ifdef VDB_MATERIALS
#import bevy_vdb::gpu::types::KIND_SURFACE
#import bevy_vdb::material::VdbHit
#import bevy_vdb::material::kinds::surface_of_kind
#import bevy_vdb::material::table::local_from_index
#import bevy_vdb::traversal::rays::safe_normalize
#import bevy_vdb::trace::segment::{point_at, world_position}
#import bevy_vdb::trace::surface::{facing_normal, geometric_normal}
#import bevy_vdb::view::scene::{index_position, material_number}
#endif

fn material_at(segment: Segment, surface: Surface, to_viewer: vec3<f32>) -> VdbSurface {
    let volume = surface.volume;
    var base_color = volumes[volume].base_color;
#ifdef VDB_COLORS
    base_color *= color_along(segment, surface.t, volume);
#endif
    let material = VdbSurface(
        base_color,
        volumes[volume].perceptual_roughness,
        visible_normal(surface, to_viewer),
        volumes[volume].metallic,
        volumes[volume].emissive,
        volumes[volume].reflectance,
    );
#ifdef VDB_MATERIALS
    let number = material_number(volume);
    if number != 0u {
        return changed_material(segment, surface, to_viewer, number, material);
    }
#endif
    return material;
}

#ifdef VDB_MATERIALS
// The largest colour and luminance, as in `src/render/view/volume.rs`.
const MAX_COLOR: f32 = 1e6;
const MAX_LIGHT: f32 = 1e15;

fn changed_material(
    segment: Segment,
    surface: Surface,
    to_viewer: vec3<f32>,
    number: u32,
    built_in: VdbSurface,
) -> VdbSurface {
    // Voxels are centred on samples.
    let offset = select(0.0, 0.5, volumes[surface.volume].kind == KIND_SURFACE);
    let at = index_position(surface.volume, surface.cell, surface.frac - offset);
    let hit = VdbHit(
        world_position(point_at(segment, surface.t)),
        surface.t * length(segment.dir),
        local_from_index(number, at),
        at,
        geometric_normal(surface),
        to_viewer,
    );
    let changed = surface_of_kind(number, hit, built_in);
    // Within the bounds of the crate's own materials, whatever the function returns.
    var sound = changed;
    sound.base_color = clamp(changed.base_color, vec3(0.0), vec3(MAX_COLOR));
    sound.perceptual_roughness = saturate(changed.perceptual_roughness);
    sound.metallic = saturate(changed.metallic);
    sound.emissive = clamp(changed.emissive, vec3(0.0), vec3(MAX_LIGHT));
    sound.reflectance = saturate(changed.reflectance);
    if any(changed.normal != built_in.normal) {
        sound.normal = facing_normal(safe_normalize(changed.normal), to_viewer);
    }
    return sound;
}
#endif
