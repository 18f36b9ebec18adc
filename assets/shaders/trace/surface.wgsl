// The nearest surface on a ray, and where rays go on from there.
#define_import_path bevy_vdb::trace::surface

#import bevy_vdb::gpu::types::{KIND_SMOOTH, KIND_SURFACE, Ray}
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::rebase::rebased_at
#import bevy_vdb::traversal::hdda::{FAR, Hit, mirrored_ray, enter_at, first_hit, unmirrored}
#import bevy_vdb::view::scene::{scene_end, view, volumes}
#import bevy_vdb::trace::segment::{Point, Segment, point_at, quantise_frac, lattice_ray}
#ifdef VDB_SMOOTH
#import bevy_vdb::traversal::smooth::first_root
#endif

// What a ray has met.
struct Surface {
    found: bool,
    volume: u32,
    t: f32,
    cell: vec3<i32>,        // local
    frac: vec3<f32>,       // in the cell, 0 to 1
    gradient: vec3<f32>,    // outwards, in the lattice, not of unit length
    is_face: bool,          // of a voxel
}

fn no_surface() -> Surface {
    return Surface(false, 0u, 0.0, vec3(0), vec3(0.0), vec3(0.0), false);
}

// A voxel's face, outwards; where a ray began inside the voxel, one that looks along z.
fn face_normal(mirrored: MirroredRay, axis: u32) -> vec3<f32> {
    let axis_mask = vec3(axis == 0u, axis == 1u, axis >= 2u);
    let outwards = select(vec3(-1.0), vec3(1.0), mirrored.mirror != vec3(0));
    return select(vec3(0.0), outwards, axis_mask);
}

#ifdef VDB_SURFACES
// The first voxel of a volume on a ray.
fn intersect_voxels(volume: u32, ray: Ray, start: f32) -> Surface {
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, ray);
    let hit = first_hit(grid, mirrored, enter_at(mirrored, start));
    if !hit.found {
        return no_surface();
    }
    let rel = bitcast<vec3<u32>>((hit.cell ^ mirrored.mirror) - mirrored.cell);
    let frac = unmirrored(mirrored, rebased_at(mirrored, rel, hit.axis, hit.t).frac);
    return Surface(true, volume, hit.t, hit.cell, frac, face_normal(mirrored, hit.axis), true);
}
#endif

#ifdef VDB_SMOOTH
// The first root of a volume on a ray.
fn intersect_smooth(volume: u32, ray: Ray, start: f32) -> Surface {
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, ray);
    let root = first_root(grid, mirrored, enter_at(mirrored, start));
    if !root.found {
        return no_surface();
    }
    let position = ray.frac + root.t * ray.dir;
    let whole = floor(position);
    let face = face_normal(mirrored, root.axis);
    // A gradient may be zero where eight values are alike.
    let gradient = select(face, root.gradient, any(abs(root.gradient) > vec3(1e-30)));
    return Surface(true, volume, root.t, ray.cell + vec3<i32>(whole), position - whole, gradient, false);
}
#endif

// The nearer of two.
fn nearer(a: Surface, b: Surface) -> Surface {
    if b.found && (!a.found || b.t < a.t) {
        return b;
    }
    return a;
}

// A vector of any size, made to length 1.
fn safe_normalize(v: vec3<f32>) -> vec3<f32> {
    // Scaled first: its square can be more, or less, than f32 holds.
    let largest = max(max(abs(v.x), abs(v.y)), abs(v.z));
    return normalize(v / max(largest, 1e-30));
}

// World-space unit normal, outwards.
fn normal_of(surface: Surface) -> vec3<f32> {
    let v = volumes[surface.volume].normal_x * surface.gradient.x
        + volumes[surface.volume].normal_y * surface.gradient.y
        + volumes[surface.volume].normal_z * surface.gradient.z;
    return safe_normalize(v);
}

// Cells that rays from a smooth surface begin above it. The trilinear interpolant of a surface whose
// radius of curvature is R cells has bumps of 1 / 4R cells, on which light that grazes the surface would
// throw shadows: this is above those of all surfaces with R of 2.5 or more.
const RAY_OFFSET: f32 = 0.1;
// And for each cell that the ray has come, what f32 may get wrong of the place.
const RAY_OFFSET_PER_CELL: f32 = 4.76837158203125e-7;   // 2^-21

// Where rays leave a surface on the side that a segment came from.
//
// From a voxel's face, they leave from the empty cell before it: the traversal is exact, so that they
// cannot come back to the voxel. Less than 2^-24 cells lie between the face and where they begin.
fn offset_origin(segment: Segment, surface: Surface) -> Point {
    var point = point_at(segment, surface.t);
    point.volume = surface.volume;
    point.cell = surface.cell;
    if surface.is_face {
        let outwards = vec3<i32>(surface.gradient);
        point.cell += outwards;
        // The lower neighbour is left at its upper end, the upper one at its lower end.
        let frac = select(surface.frac, vec3(1.0), outwards < vec3(0));
        point.frac = quantise_frac(select(frac, vec3(0.0), outwards > vec3(0)));
        return point;
    }
    let ray = lattice_ray(segment, surface.volume, FAR);
    let distance_in_cells = max(max(abs(ray.dir.x), abs(ray.dir.y)), abs(ray.dir.z)) * surface.t;
    let gradient_dir = safe_normalize(surface.gradient);
    let offset_dir = select(gradient_dir, -gradient_dir, dot(gradient_dir, ray.dir) > 0.0);
    let start = surface.frac + (RAY_OFFSET + RAY_OFFSET_PER_CELL * distance_in_cells) * offset_dir;
    let whole = floor(start);
    point.cell += vec3<i32>(whole);
    point.frac = quantise_frac(start - whole);
    return point;
}
