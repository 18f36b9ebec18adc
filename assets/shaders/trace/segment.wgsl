// Path segments: the view's own rays, and secondary rays towards lights and reflections. Each can be
// expressed in the lattice of any volume.
#define_import_path bevy_vdb::trace::segment

#import bevy_vdb::gpu::types::{MAX_CLIP_PLANES, PAGE, Ray}
#import bevy_vdb::traversal::rays::{quantise_frac, ray_through}
#ifdef VDB_CLIP
#import bevy_vdb::traversal::hdda::FAR
#endif
#import bevy_vdb::view::scene::{view, volumes}

// No volume, and no clip plane.
const NONE: u32 = 0xffffffffu;

#ifdef VDB_CLIP
// Rounding of the distance of a point from a plane, relative to the numbers that it is computed from: 2^-20.
const CLIP_ROUNDING: f32 = 9.5367431640625e-7;
#endif

// A point in the world. In the lattice of the volume whose surface it lies on, it is exact to 2^-24 of a
// cell. In other lattices it is derived from the view ray, to within the f32 rounding of its distance.
struct Point {
    ndc: vec2<f32>,     // of the view ray at the start of the path
    t: f32,             // along that view ray
    offset: vec3<f32>,  // from that point of the view ray, world space
    volume: u32,        // the volume in whose lattice `cell` and `frac` are, or NONE
    cell: vec3<i32>,
    frac: vec3<f32>,    // a multiple of 2^-24 in [0, 1)
}

// A ray from a point. `dir` is in world space per unit of t. For view rays, t is depth; for all others, t is
// in world units.
struct Segment {
    start: Point,
    dir: vec3<f32>,
    is_view: bool,
    t_min: f32,
}

// A point on a view ray, not tied to any lattice.
fn point_on_view_ray(ndc: vec2<f32>, t: f32) -> Point {
    return Point(ndc, t, vec3(0.0), NONE, vec3(0), vec3(0.0));
}

fn view_segment(ndc: vec2<f32>) -> Segment {
    let dir = view.dir + ndc.x * view.dir_x + ndc.y * view.dir_y;
    return Segment(point_on_view_ray(ndc, 0.0), dir, true, view.t_near);
}

// Position relative to the view's eye, in world space.
fn position_from_eye(point: Point) -> vec3<f32> {
    let ndc = point.ndc;
    let eye_offset = ndc.x * view.eye_x + ndc.y * view.eye_y;
    return eye_offset + point.t * (view.dir + ndc.x * view.dir_x + ndc.y * view.dir_y) + point.offset;
}

// Position in world space.
fn world_position(point: Point) -> vec3<f32> {
    return view.eye + position_from_eye(point);
}

fn lattice_from_world(volume: u32, v: vec3<f32>) -> vec3<f32> {
    return volumes[volume].lattice_x * v.x
        + volumes[volume].lattice_y * v.y
        + volumes[volume].lattice_z * v.z;
}

// Largest distance from the eye at which a point still has an integer cell, in cells.
const MAX_CELL: f32 = 1073741824.0;     // 2^30

#ifdef VDB_LEVELS
// Whether a volume is the level of detail that secondary rays meet: on a whole path, the one where the view ray ends,
// so that no ray starts inside the surface of another level.
fn is_level_of_path(volume: u32, start: Point) -> bool {
    return start.t >= volumes[volume].t_first && start.t < volumes[volume].t_end;
}
#endif

#ifdef VDB_CLIP
// The part of a segment that the clip planes of a volume leave; empty if `t_last` is less than `t_first`.
struct ClippedPart {
    t_first: f32,
    t_last: f32,
    plane: u32,     // the clip plane through which the segment enters, or NONE
}

fn clipped_part(segment: Segment, volume: u32) -> ClippedPart {
    var part = ClippedPart(-FAR, FAR, NONE);
    let start = segment.start;
    let origin = position_from_eye(start);
    // Of the terms that add up to a position, whose sum may be much less than they are.
    let terms = abs(start.t) * length(view.dir + start.ndc.x * view.dir_x + start.ndc.y * view.dir_y)
        + length(start.ndc.x * view.eye_x + start.ndc.y * view.eye_y)
        + length(start.offset);
    for (var bits = volumes[volume].clip_planes; bits != 0u; bits &= bits - 1u) {
        let i = countTrailingZeros(bits) & (MAX_CLIP_PLANES - 1u);
        let plane = view.clip_planes[i];
        let slope = dot(plane.xyz, segment.dir);
        var distance = dot(plane.xyz, origin) + plane.w;
        if !segment.is_view {
            // From a point on the plane, no rounding may make a ray begin in what is kept.
            distance -= CLIP_ROUNDING * (terms + abs(plane.w));
        }
        if abs(slope) < 1e-20 {
            part.t_last = select(part.t_last, -2.0 * FAR, distance < 0.0);
            continue;
        }
        let t = clamp(-distance / slope, -FAR, FAR);
        if slope < 0.0 {
            part.t_last = min(part.t_last, t);
        } else if t > part.t_first {
            part.t_first = t;
            part.plane = i;
        }
    }
    return part;
}
#endif

// The ray of a segment in the lattice of a volume. It hits nothing that another level of detail represents, nor what
// clip planes cut away.
fn lattice_ray(segment: Segment, volume: u32, t_max: f32) -> Ray {
    var ray = ray_of_level(segment, volume, t_max);
#ifdef VDB_CLIP
    if volumes[volume].clip_planes != 0u {
        let part = clipped_part(segment, volume);
        ray.t_min = max(ray.t_min, part.t_first);
        ray.t_max = min(ray.t_max, part.t_last);
    }
#endif
    return ray;
}

// The same before clip planes shorten it.
fn ray_of_level(segment: Segment, volume: u32, t_max: f32) -> Ray {
    let start = segment.start;
    var ray = ray_through(volumes[volume].rays, start.ndc, segment.t_min, t_max);
    if segment.is_view {
#ifdef VDB_LEVELS
        ray.t_min = max(ray.t_min, volumes[volume].t_first);
        ray.t_max = min(ray.t_max, volumes[volume].t_end);
#endif
        return ray;
    }
    let from_cell = ray.frac + start.t * ray.dir + lattice_from_world(volume, start.offset);
    ray.dir = lattice_from_world(volume, segment.dir);
    if start.volume == volume {
        ray.cell = start.cell;
        ray.frac = start.frac;
    } else {
        let clamped = clamp(from_cell, vec3(-MAX_CELL), vec3(MAX_CELL - 128.0));
        let whole = floor(clamped);
        ray.cell += vec3<i32>(whole);
        ray.frac = quantise_frac(clamped - whole);
        if any(clamped != from_cell) {
            // Too far away to hit anything.
            ray.dir = vec3(0.0);
        }
    }
#ifdef VDB_LEVELS
    if !is_level_of_path(volume, start) {
        ray.dir = vec3(0.0);
    }
#endif
    return ray;
}

// Whether a ray enters a page from outside. `axis` is that of the face through which it enters the grid's box, or 3
// if it begins inside. If the ray is inside the solid at the entry, it has just crossed the surface, or a nearer
// hit in another page wins.
fn enters_page(volume: u32, axis: u32) -> bool {
    return (volumes[volume].flags & PAGE) != 0u && axis != 3u;
}

// The point at t on a segment.
fn point_at(segment: Segment, t: f32) -> Point {
    var point = segment.start;
    point.volume = NONE;
    if segment.is_view {
        point.t = t;
    } else {
        point.offset += t * segment.dir;
    }
    return point;
}
