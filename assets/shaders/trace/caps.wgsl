// Caps: the flat faces where clip planes cut the solids of smooth surfaces.
#define_import_path bevy_vdb::trace::caps

#import bevy_vdb::gpu::types::{Grid, MAX_CLIP_PLANES}
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::hdda::{Dda, FAR, enter, mirrored_ray}
#import bevy_vdb::traversal::smooth::{SurfaceHit, first_root}
#import bevy_vdb::trace::segment::{ClippedPart, NONE, Segment, clipped_part, ray_of_level}
#import bevy_vdb::view::scene::{view, volumes}

// Whether a ray that begins within the grid's box does so where it passes a clip plane, not at the eye or at the end
// of another level of detail. The part may have been computed twice, with different rounding.
fn begins_at_plane(part: ClippedPart, mirrored: MirroredRay) -> bool {
    return part.plane != NONE
        && part.t_first > 0.0
        && part.t_first >= mirrored.t_min * (1.0 - 1e-6);
}

// What a ray meets first of a smooth surface that clip planes cut.
struct ClippedRoot {
    root: SurfaceHit,   // found if that is the surface itself
    is_cap: bool,
    plane: u32,         // of the cap
}

// The first root of the interpolant on the ray of a segment, or the cap where the ray begins. Only the first cell
// with a root tells whether it begins inside, so the ray is followed to there, past other clip planes, too.
fn first_clipped_root(
    segment: Segment,
    volume: u32,
    grid: Grid,
    mirrored: MirroredRay,
    entry: Dda,
    begins_outside: bool,
) -> ClippedRoot {
    var part = ClippedPart(0.0, 0.0, NONE);
    if volumes[volume].clip_planes != 0u && entry.inside && entry.axis == 3u {
        part = clipped_part(segment, volume);
    }
    let at_plane = begins_at_plane(part, mirrored);
    var endless = mirrored;
    var dda = entry;
    if at_plane {
        var ray = ray_of_level(segment, volume, FAR);
        ray.t_min = max(ray.t_min, part.t_first);
        ray.t_max = FAR;
        endless = mirrored_ray(grid, ray);
        dda = enter(endless);
    }
    var root = first_root(grid, endless, dda, begins_outside && !at_plane);
    let is_cap = at_plane && root.found && root.begins_inside;
    root.found = root.found && !is_cap && root.t <= mirrored.t_max;
    return ClippedRoot(root, is_cap, part.plane);
}

// The outward normal of the cap at a clip plane, as a gradient in the lattice of a volume.
fn cap_gradient(volume: u32, plane: u32) -> vec3<f32> {
    let outwards = -view.clip_planes[plane & (MAX_CLIP_PLANES - 1u)].xyz;
    let x = volumes[volume].lattice_x;
    let y = volumes[volume].lattice_y;
    let z = volumes[volume].lattice_z;
    // The transpose of the matrix from lattice to world directions, times its determinant, whose sign counts.
    let gradient = outwards.x * cross(y, z) + outwards.y * cross(z, x) + outwards.z * cross(x, y);
    return select(gradient, -gradient, dot(x, cross(y, z)) < 0.0);
}
