// The nearest surface on a ray, and the origins of secondary rays.
#define_import_path bevy_vdb::trace::surface

#import bevy_vdb::gpu::types::{Ray, SMOOTH_NORMALS}
#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::traversal::exact::MirroredRay
#import bevy_vdb::traversal::rays::{quantise_frac, safe_normalize, surface_offset}
#import bevy_vdb::traversal::rebase::rebased_at
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray, enter_at, first_hit, local_cell, plane_t, unmirrored}
#import bevy_vdb::view::scene::{view, volumes}
#import bevy_vdb::trace::segment::{Point, Segment, enters_page, point_at, ray_of_level}
#ifdef VDB_CLIP
#import bevy_vdb::trace::caps::{begins_at_plane, cap_gradient, first_clipped_root}
#import bevy_vdb::trace::segment::clipped_part
#endif
#ifdef VDB_SMOOTH
#import bevy_vdb::traversal::smooth::first_root
#endif
#ifdef VDB_SMOOTH_NORMALS
#import bevy_vdb::traversal::normals::smooth_gradient
#endif

// A hit of a ray on a surface.
struct Surface {
    found: bool,
    volume: u32,
    t: f32,
    cell: vec3<i32>,        // local
    frac: vec3<f32>,        // within the cell, 0 to 1
    gradient: vec3<f32>,    // pointing outwards, in lattice space, not normalised
    shading: vec3<f32>,     // the same for shading
    is_face: bool,          // whether this is a voxel face
}

fn no_surface() -> Surface {
    var none: Surface;
    return none;
}

// Outward normal of a voxel face. If a ray began inside the voxel, the normal points along z.
fn face_normal(mirrored: MirroredRay, axis: u32) -> vec3<f32> {
    let axis_mask = vec3(axis == 0u, axis == 1u, axis >= 2u);
    let outwards = select(vec3(-1.0), vec3(1.0), mirrored.mirror != vec3(0));
    return select(vec3(0.0), outwards, axis_mask);
}

// Whether a ray begins at the near end of a coarser level of detail, having hit nothing in the finer one.
fn begins_at_level(ray: Ray) -> bool {
#ifdef VDB_LEVELS
    return ray.t_min > view.t_near;
#else
    return false;
#endif
}

#ifdef VDB_SURFACES
// The first voxel of a volume on a ray.
fn intersect_voxels(segment: Segment, volume: u32, ray: Ray, start: f32) -> Surface {
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, ray);
    let hit = first_hit(grid, mirrored, enter_at(mirrored, start));
    if !hit.found {
        return no_surface();
    }
    let rel = bitcast<vec3<u32>>((hit.cell ^ mirrored.mirror) - mirrored.cell);
    let frac = unmirrored(mirrored, rebased_at(mirrored, rel, hit.axis, hit.t).frac);
#ifdef VDB_CLIP
    if hit.axis == 3u && volumes[volume].clip_planes != 0u {
        let part = clipped_part(segment, volume);
        if begins_at_plane(part, mirrored) {
            let cap = cap_gradient(volume, part.plane);
            return Surface(true, volume, hit.t, hit.cell, frac, cap, cap, false);
        }
    }
#endif
    var axis = hit.axis;
    if axis == 3u && begins_at_level(ray) {
        // As if the ray had come from outside.
        let near = plane_t(mirrored, rel);
        axis = select(select(2u, 1u, near.y > max(near.x, near.z)), 0u, near.x > max(near.y, near.z));
    }
    let normal = face_normal(mirrored, axis);
    return Surface(true, volume, hit.t, hit.cell, frac, normal, normal, true);
}
#endif

#ifdef VDB_SMOOTH
// The first root of a volume's interpolant on a ray.
fn intersect_smooth(segment: Segment, volume: u32, ray: Ray, start: f32) -> Surface {
    let grid = grids[volumes[volume].grid];
    let mirrored = mirrored_ray(grid, ray);
    let entry = enter_at(mirrored, start);
    let begins_outside = begins_at_level(ray) || enters_page(volume, entry.axis);
#ifdef VDB_CLIP
    let clipped = first_clipped_root(segment, volume, grid, mirrored, entry, begins_outside);
    if clipped.is_cap {
        let frac = unmirrored(mirrored, rebased_at(mirrored, entry.rel, 3u, entry.t).frac);
        let cap = cap_gradient(volume, clipped.plane);
        return Surface(true, volume, entry.t, local_cell(mirrored, entry.rel), frac, cap, cap, false);
    }
    let root = clipped.root;
#else
    let root = first_root(grid, mirrored, entry, begins_outside);
#endif
    if !root.found {
        return no_surface();
    }
    let face = face_normal(mirrored, root.axis);
    // The gradient may be zero where all eight corner values are equal.
    var gradient = gradient_or(root.gradient, face);
    let along = dot(gradient, ray.dir);
    if along > 0.0 && begins_outside {
        // The ray begins just inside, where it may already lead outwards. Seen from outside, a surface faces the eye.
        gradient -= (1.001 * along / dot(ray.dir, ray.dir)) * ray.dir;
    }
    var shading = gradient;
#ifdef VDB_SMOOTH_NORMALS
    if (volumes[volume].flags & SMOOTH_NORMALS) != 0u {
        shading = gradient_or(smooth_gradient(grid, root), gradient);
    }
#endif
    return Surface(true, volume, root.t, root.cell, root.frac, gradient, shading, false);
}

// A gradient, or another vector if it is zero.
fn gradient_or(gradient: vec3<f32>, otherwise: vec3<f32>) -> vec3<f32> {
    return select(otherwise, gradient, any(abs(gradient) > vec3(1e-30)));
}
#endif

// The nearer of two hits.
fn nearer(a: Surface, b: Surface) -> Surface {
    if b.found && (!a.found || b.t < a.t) {
        return b;
    }
    return a;
}

// The unit vector in world space along a gradient in the lattice of a volume.
fn normal_along(volume: u32, gradient: vec3<f32>) -> vec3<f32> {
    let v = volumes[volume].normal_x * gradient.x
        + volumes[volume].normal_y * gradient.y
        + volumes[volume].normal_z * gradient.z;
    return safe_normalize(v);
}

// Outward unit normal in world space, of the surface that rays hit.
fn geometric_normal(surface: Surface) -> vec3<f32> {
    return normal_along(surface.volume, surface.gradient);
}

// The same for shading, without jumps from cell to cell if the volume has smooth normals.
fn shading_normal(surface: Surface) -> vec3<f32> {
#ifdef VDB_SMOOTH_NORMALS
    return normal_along(surface.volume, surface.shading);
#else
    // Nothing reads `shading` then, so that compilers leave it out.
    return geometric_normal(surface);
#endif
}

// A unit vector, or its projection onto the plane perpendicular to the direction to the viewer if it points away
// from the viewer.
fn facing_normal(normal: vec3<f32>, to_viewer: vec3<f32>) -> vec3<f32> {
    let visible = normal - min(dot(normal, to_viewer), 0.0) * to_viewer;
    return normalize(select(to_viewer, visible, any(abs(visible) > vec3(1e-6))));
}

// The shading normal on the side of the surface that is seen from a direction (unit length). Near a
// silhouette, it may point away from the viewer. It is then projected, so that it is not shaded from behind.
fn visible_normal(surface: Surface, to_viewer: vec3<f32>) -> vec3<f32> {
    let is_inside = dot(geometric_normal(surface), to_viewer) < 0.0;
    let outwards = shading_normal(surface);
    return facing_normal(select(outwards, -outwards, is_inside), to_viewer);
}

// Origin of a secondary ray, on the side of the surface that the segment arrived from.
//
// From a voxel face, the ray starts in the empty cell in front of it. The traversal is exact, so the ray
// cannot hit the same voxel again. The origin is less than 2^-24 cells from the face.
fn offset_origin(segment: Segment, surface: Surface) -> Point {
    var point = point_at(segment, surface.t);
    point.volume = surface.volume;
    point.cell = surface.cell;
    if surface.is_face {
        let outwards = vec3<i32>(surface.gradient);
        point.cell += outwards;
        // Start at the upper end of the lower neighbour, or the lower end of the upper neighbour.
        let frac = select(surface.frac, vec3(1.0), outwards < vec3(0));
        point.frac = quantise_frac(select(frac, vec3(0.0), outwards > vec3(0)));
        return point;
    }
    let ray = ray_of_level(segment, surface.volume, FAR);
    let start = surface.frac + surface_offset(surface.gradient, ray.dir, surface.t);
    let whole = floor(start);
    point.cell += vec3<i32>(whole);
    point.frac = quantise_frac(start - whole);
    return point;
}
