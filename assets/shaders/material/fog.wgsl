// What the custom function makes of a fog at a point.
#define_import_path bevy_vdb::material::fog

#import bevy_vdb::gpu::types::{Grid, MATERIAL_SHIFT}
#import bevy_vdb::material::{VdbFog, VdbFogPoint}
#import bevy_vdb::material::kinds::fog_of_kind
#import bevy_vdb::material::table::local_from_index
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::hdda::{local_cell, unmirrored}
#import bevy_vdb::traversal::rebase::Rebased
#import bevy_vdb::view::scene::{index_position, material_number}

// Whether a function changes a fog, given its grid from `fog_grid`.
fn has_function(grid: Grid) -> bool {
    return (grid.ramp >> MATERIAL_SHIFT) != 0u;
}

// The factors for density and albedo at a point of a volume's lattice.
fn changed_fog(volume: u32, cell: vec3<i32>, frac: vec3<f32>) -> VdbFog {
    let number = material_number(volume);
    let index = index_position(volume, cell, frac);
    let at = VdbFogPoint(local_from_index(number, index), index);
    let fog = fog_of_kind(number, at, VdbFog(1.0, vec3(1.0)));
    // Bounds of density and albedo stay valid.
    return VdbFog(saturate(fog.density), saturate(fog.color));
}

// The factor for the density of a fog, given its grid from `fog_grid`.
fn density_factor(grid: Grid, cell: vec3<i32>, frac: vec3<f32>) -> f32 {
    return changed_fog(grid.records, cell, frac).density;
}

// The most points at which the function of a material is asked in a cube without samples of its own.
const MOST_POINTS: f32 = 32.0;

// Mean factor for the density between two parameters, counted from the rebased origin, within the cube of a span:
// at points one voxel apart, and in the middle of a shorter stretch.
fn mean_factor(grid: Grid, mirrored: MirroredRay, rebased: Rebased, t_from: f32, t_to: f32) -> f32 {
    let points = clamp(ceil((t_to - t_from) * length(mirrored.speed)), 1.0, MOST_POINTS);
    var sum = 0.0;
    for (var i = 0.5; i < points; i += 1.0) {
        let at = rebased.frac + mix(t_from, t_to, i / points) * mirrored.speed;
        let whole = floor(at);
        let cell = local_cell(mirrored, rebased.cell + vec3<u32>(whole));
        sum += density_factor(grid, cell, unmirrored(mirrored, at - whole));
    }
    return sum / points;
}
