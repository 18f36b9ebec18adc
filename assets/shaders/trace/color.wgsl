// Colours of surfaces and fogs from grids.
#define_import_path bevy_vdb::trace::color

#import bevy_vdb::gpu::bindings::grids
#ifdef VDB_FOG_MATERIALS
#import bevy_vdb::material::fog::changed_fog
#import bevy_vdb::view::scene::material_number
#endif
#import bevy_vdb::traversal::fog::SamplePoint
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::traversal::samples::{fog_cell, tile_value, trilinear}
#import bevy_vdb::view::scene::volumes
#import bevy_vdb::trace::segment::{NONE, Segment, ray_of_level}
#import bevy_vdb::traversal::tree::{locate, new_accessor, span_constant, span_occupied}

// A point on a segment in the lattice of a volume.
fn lattice_point_along(segment: Segment, t: f32, volume: u32) -> SamplePoint {
    let ray = ray_of_level(segment, volume, FAR);
    let position = ray.frac + t * ray.dir;
    let whole = floor(position);
    return SamplePoint(ray.cell + vec3<i32>(whole), position - whole);
}

// The value of a grid at a point on a segment: trilinear interpolation inside the grid, the background
// outside.
fn value_along(segment: Segment, t: f32, volume: u32) -> f32 {
    let grid = grids[volumes[volume].grid];
    let background = volumes[volume].background;
    let point = lattice_point_along(segment, t, volume);
    let cell = point.cell;
    if any(cell < grid.occupied_min) || any(cell > grid.occupied_max) {
        return background;
    }
    var accessor = new_accessor(cell);
    let span = locate(grid, cell, 0u, &accessor);
    if !span_occupied(span) {
        return background;
    }
    if span_constant(span) {
        return tile_value(grid, span.word);
    }
    let values = fog_cell(grid, span, cell);
    return values.offset + values.scale * trilinear(values.corners, point.u);
}

// Factor for the base colour of a volume at a point on a segment.
fn color_along(segment: Segment, t: f32, volume: u32) -> vec3<f32> {
    let first = volumes[volume].color_grids;
    if first == NONE {
        return vec3(1.0);
    }
    return min(
        vec3(
            value_along(segment, t, first),
            value_along(segment, t, first + 1u),
            value_along(segment, t, first + 2u),
        ),
        vec3(1e6),
    );
}

// The largest albedo: `MAX_ALBEDO` in `src/render/view/volume.rs`.
const MAX_ALBEDO: f32 = 1e6;

// Single-scattering albedo of a fog at a point on a segment.
fn albedo_along(segment: Segment, t: f32, fog: u32) -> vec3<f32> {
    var albedo = volumes[fog].base_color;
#ifdef VDB_FOG_COLORS
    albedo = min(albedo * color_along(segment, t, fog), vec3(MAX_ALBEDO));
#endif
#ifdef VDB_FOG_MATERIALS
    if material_number(fog) != 0u {
        let point = lattice_point_along(segment, t, fog);
        albedo *= changed_fog(fog, point.cell, point.u).color;
    }
#endif
    return albedo;
}
