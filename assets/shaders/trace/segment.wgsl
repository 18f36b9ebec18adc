// Rays that begin anywhere in the world, in the lattice of every volume: the view's own, and those
// that go on from what they meet, to lights and to what is reflected.
#define_import_path bevy_vdb::trace::segment

#import bevy_vdb::gpu::types::Ray
#import bevy_vdb::traversal::rays::ray_through
#import bevy_vdb::view::scene::{view, volumes}

// No volume.
const NONE: u32 = 0xffffffffu;

// A place in the world. In the lattice of the volume whose surface it is on, it is known to 2^-24 of a
// cell. In the others it is worked out from the view's ray, to within what f32 has of its length.
struct Point {
    ndc: vec2<f32>,     // of the view's ray that leads there, directly or in the end
    t: f32,             // how far along that ray
    shift: vec3<f32>,   // and from there on; world space
    own: u32,           // the volume with a place of its own, or NONE
    cell: vec3<i32>,
    frac: vec3<f32>,    // a multiple of 2^-24, from 0 up to but not 1
}

// A ray from a place. `dir` is in world space, per unit of t: of the view's own rays, t is the depth;
// of others, world units.
struct Segment {
    start: Point,
    dir: vec3<f32>,
    is_view: bool,
    t_min: f32,
}

// A place on a ray of the view, in no lattice of its own.
fn point_on_view(ndc: vec2<f32>, t: f32) -> Point {
    return Point(ndc, t, vec3(0.0), NONE, vec3(0), vec3(0.0));
}

fn view_segment(ndc: vec2<f32>) -> Segment {
    let dir = view.dir + ndc.x * view.dir_x + ndc.y * view.dir_y;
    return Segment(point_on_view(ndc, 0.0), dir, true, view.t_near);
}

// Where a place is in the world, from the view's eye on.
fn from_eye(point: Point) -> vec3<f32> {
    let ndc = point.ndc;
    let aside = ndc.x * view.eye_x + ndc.y * view.eye_y;
    return aside + point.t * (view.dir + ndc.x * view.dir_x + ndc.y * view.dir_y) + point.shift;
}

// Where a place is in the world.
fn world_position(point: Point) -> vec3<f32> {
    return view.eye + from_eye(point);
}

// Fractions of a cell as the traversal wants them.
fn quantised(frac: vec3<f32>) -> vec3<f32> {
    return clamp(floor(frac * 16777216.0), vec3(0.0), vec3(16777215.0)) / 16777216.0;
}

fn to_lattice(volume: u32, v: vec3<f32>) -> vec3<f32> {
    return volumes[volume].lattice_x * v.x + volumes[volume].lattice_y * v.y + volumes[volume].lattice_z * v.z;
}

// Cells from the eye within which a place has an integer cell.
const FARTHEST: f32 = 1073741824.0;     // 2^30

// The ray of a segment in the lattice of a volume.
fn ray_of(segment: Segment, volume: u32, t_max: f32) -> Ray {
    let start = segment.start;
    var ray = ray_through(volumes[volume].rays, start.ndc, segment.t_min, t_max);
    if segment.is_view {
        return ray;
    }
    let way = ray.frac + start.t * ray.dir + to_lattice(volume, start.shift);
    ray.dir = to_lattice(volume, segment.dir);
    if start.own == volume {
        ray.cell = start.cell;
        ray.frac = start.frac;
    } else {
        let near = clamp(way, vec3(-FARTHEST), vec3(FARTHEST - 128.0));
        let whole = floor(near);
        ray.cell += vec3<i32>(whole);
        ray.frac = quantised(near - whole);
        if any(near != way) {
            // Too far away to be met.
            ray.dir = vec3(0.0);
        }
    }
    return ray;
}

// A place on a segment.
fn along(segment: Segment, t: f32) -> Point {
    var point = segment.start;
    point.own = NONE;
    if segment.is_view {
        point.t = t;
    } else {
        point.shift += t * segment.dir;
    }
    return point;
}
