// Rays through the volume, for each kind: what a view ray meets, and how much light passes along a secondary ray.
#define_import_path vdb_web::volume

#import bevy_vdb::gpu::types::Ray
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::hdda::{FAR, enter, enter_at, first_hit, mirrored_ray, unmirrored}
#import bevy_vdb::traversal::rays::quantise_frac
#ifdef VDB_FOG
#import bevy_vdb::traversal::fog::{optical_length, stepped_length}
#import bevy_vdb::traversal::march::scaled_step
#else
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::rebase::rebased_at
#endif
#ifdef VDB_SMOOTH
#import bevy_vdb::traversal::rays::surface_offset
#import bevy_vdb::traversal::normals::smooth_gradient
#import bevy_vdb::traversal::smooth::first_root
#endif
#ifdef VDB_FOG
#import vdb_web::scene::look
#endif
#import vdb_web::scene::view

// A point in local lattice coordinates: the origin of a secondary ray.
struct Point {
    cell: vec3<i32>,
    frac: vec3<f32>,    // a multiple of 2^-24 in [0, 1)
}

// A point near a cell.
fn point_from(cell: vec3<i32>, offset: vec3<f32>) -> Point {
    let whole = floor(offset);
    return Point(cell + vec3<i32>(whole), quantise_frac(offset - whole));
}

// The point at t on a ray, to within the rounding of f32.
fn point_on(ray: Ray, t: f32) -> Point {
    return point_from(ray.cell, ray.frac + t * ray.dir);
}

// The ray from a point in a direction of unit length in world space; t is in world units.
fn ray_from(start: Point, dir: vec3<f32>) -> Ray {
    let along = view.lattice[0].xyz * dir.x + view.lattice[1].xyz * dir.y + view.lattice[2].xyz * dir.z;
    return Ray(start.cell, start.frac, along, 0.0, FAR);
}

#ifdef VDB_FOG
// Optical depth at which rays end: what is left of the light is less than a step of 8 bits.
const OPAQUE_DEPTH: f32 = 7.0;
// Voxels between samples on rays towards the sun.
const SUN_STEP: f32 = 1.5;

// Optical depth from a point in fog, in a direction of unit length in world space. Sampled, because the errors of
// many points on a ray average out.
fn depth_from(start: Point, dir: vec3<f32>) -> f32 {
    let grid = grids[0];
    let mirrored = mirrored_ray(grid, ray_from(start, dir));
    let scale = max(look.extinction, 1e-30);
    let step = scaled_step(grid, SUN_STEP, 128.0);
    return scale * stepped_length(grid, mirrored, 0.0, 4.0 * OPAQUE_DEPTH / scale, step, 0.0);
}

// Transmittance along a ray whose t is in a number of world units, without any step.
fn transmittance(ray: Ray, start: f32, world_units: f32) -> f32 {
    let grid = grids[0];
    let mirrored = mirrored_ray(grid, ray);
    let scale = max(look.extinction * world_units, 1e-30);
    return exp(-scale * optical_length(grid, mirrored, enter_at(mirrored, start), 16.0 / scale));
}
#else
// What a view ray meets first.
struct Surface {
    found: bool,
    t: f32,
    cell: vec3<i32>,        // local
    gradient: vec3<f32>,    // outwards, in index space, of any length; interpolated for shading
    outside: Point,         // where secondary rays begin
}
#endif

#ifdef VDB_VOXELS
// Outward normal of the face through which a mirrored ray enters; along z if it began inside.
fn face_normal(mirrored: MirroredRay, axis: u32) -> vec3<f32> {
    let outwards = select(vec3(-1.0), vec3(1.0), mirrored.mirror != vec3(0));
    return select(vec3(0.0), outwards, vec3(axis == 0u, axis == 1u, axis >= 2u));
}

// The first voxel on a ray. Secondary rays begin in the empty cell before it, so that they cannot meet it again.
fn first_surface(ray: Ray, start: f32) -> Surface {
    var surface: Surface;
    let mirrored = mirrored_ray(grids[0], ray);
    let hit = first_hit(grids[0], mirrored, enter_at(mirrored, start));
    if !hit.found {
        return surface;
    }
    let normal = face_normal(mirrored, hit.axis);
    let outwards = vec3<i32>(normal);
    let rel = bitcast<vec3<u32>>((hit.cell ^ mirrored.mirror) - mirrored.cell);
    var frac = unmirrored(mirrored, rebased_at(mirrored, rel, hit.axis, hit.t).frac);
    frac = select(frac, vec3(1.0), outwards < vec3(0));
    frac = select(frac, vec3(0.0), outwards > vec3(0));
    let outside = Point(hit.cell + outwards, quantise_frac(frac));
    return Surface(true, hit.t, hit.cell, normal, outside);
}

// Whether a surface is in the way of a secondary ray.
fn is_blocked(start: Point, dir: vec3<f32>) -> bool {
    let mirrored = mirrored_ray(grids[0], ray_from(start, dir));
    return first_hit(grids[0], mirrored, enter(mirrored)).found;
}
#endif

#ifdef VDB_SMOOTH
// The first root of the interpolant on a ray.
fn first_surface(ray: Ray, start: f32) -> Surface {
    var surface: Surface;
    let mirrored = mirrored_ray(grids[0], ray);
    let root = first_root(grids[0], mirrored, enter_at(mirrored, start), false);
    if !root.found {
        return surface;
    }
    // The gradient may be zero where all eight samples are equal.
    let is_flat = all(abs(root.gradient) <= vec3(1e-30));
    let steepest = select(root.gradient, -ray.dir, is_flat);
    let shading = select(smooth_gradient(grids[0], root), -ray.dir, is_flat);
    let outside = point_from(root.cell, root.frac + surface_offset(steepest, ray.dir, root.t));
    return Surface(true, root.t, root.cell, shading, outside);
}

fn is_blocked(start: Point, dir: vec3<f32>) -> bool {
    let mirrored = mirrored_ray(grids[0], ray_from(start, dir));
    return first_root(grids[0], mirrored, enter(mirrored), false).found;
}
#endif

// Transmittance from a point towards a light, in a direction of unit length in world space.
fn visibility(start: Point, dir: vec3<f32>) -> f32 {
#ifdef VDB_FOG
    return transmittance(ray_from(start, dir), 0.0, 1.0);
#else
    return select(1.0, 0.0, is_blocked(start, dir));
#endif
}
