// Light of Bevy's rectangle lights, which have no shadows.
#define_import_path bevy_vdb::trace::rect_lights

#import bevy_pbr::lighting
#import bevy_pbr::mesh_view_bindings as bevy
#import bevy_vdb::trace::scattering::phase
#import bevy_vdb::traversal::hdda::FAR

// Gauss's rule with three points for an interval from -1 to 1: a point, beside those at 0 and opposite to it.
const GAUSS_NODE: f32 = 0.77459667;
// A stretch of a ray is divided into parts that are at most a third as long as the distance to the light, unless
// there would be more than eight.
const PARTS_PER_DISTANCE: f32 = 3.0;
const MAX_PARTS: f32 = 8.0;

// Light that a surface reflects, cd/m², by Bevy's own function.
fn reflected_rect_lights(input: lighting::LightingInput) -> vec3<f32> {
    var surface = input;
    var light = vec3(0.0);
    for (var i = 0u; i < bevy::lights.n_rect_lights; i++) {
        light += lighting::rect_light(i, &surface, true);
    }
#ifdef VDB_DIFFUSE_ONLY
    // Bevy's function has specular light even without reflectance.
    surface.diffuse_color = vec3(0.0);
    for (var i = 0u; i < bevy::lights.n_rect_lights; i++) {
        light -= lighting::rect_light(i, &surface, true);
    }
#endif
    return light;
}

// Solid angle of a triangle seen from the origin, given the absolute triple product of its corners. Van Oosterom
// and Strackee 1983, "The solid angle of a plane triangle".
fn solid_angle(triple: f32, a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> f32 {
    let lengths = vec3(length(a), length(b), length(c));
    let denominator = lengths.x * lengths.y * lengths.z
        + dot(a, b) * lengths.z
        + dot(b, c) * lengths.x
        + dot(c, a) * lengths.y;
    return 2.0 * atan2(triple, denominator);
}

// Where fog is lit by a rectangle light, relative to it.
struct RectPlace {
    from_light: vec3<f32>,  // from its centre, world space
    half_width: vec3<f32>,
    half_height: vec3<f32>,
    height: f32,            // above its plane, on the side to which it shines
}

fn rect_place(i: u32, position: vec3<f32>) -> RectPlace {
    let right = bevy::lights.rect_lights[i].right;
    let up = bevy::lights.rect_lights[i].up;
    let from_light = position - bevy::lights.rect_lights[i].position;
    let half_width = 0.5 * bevy::lights.rect_lights[i].width * right;
    let half_height = 0.5 * bevy::lights.rect_lights[i].height * up;
    return RectPlace(from_light, half_width, half_height, dot(cross(up, right), from_light));
}

// Distance from a point (world space) to a rectangle light.
fn distance_to_rect(i: u32, position: vec3<f32>) -> f32 {
    let place = rect_place(i, position);
    let along = vec2(
        dot(place.from_light, bevy::lights.rect_lights[i].right),
        dot(place.from_light, bevy::lights.rect_lights[i].up),
    );
    let half = 0.5 * vec2(bevy::lights.rect_lights[i].width, bevy::lights.rect_lights[i].height);
    return length(vec3(max(abs(along) - half, vec2(0.0)), place.height));
}

// Light of all rectangle lights that fog scatters at a point.
struct ScatteredRects {
    light: vec3<f32>,   // cd/m²
    nearest: f32,       // distance to the nearest of them
}

// The mean of `scattered_rect_light` over a stretch of a ray (world space, unit length) around a point, for all
// lights.
fn scattered_rect_lights(
    position: vec3<f32>,
    ray: vec3<f32>,
    extent: f32,
    anisotropy: f32,
) -> ScatteredRects {
    var scattered = ScatteredRects(vec3(0.0), FAR);
    for (var i = 0u; i < bevy::lights.n_rect_lights; i++) {
        let distance = distance_to_rect(i, position);
        scattered.nearest = min(scattered.nearest, distance);
        let parts = clamp(ceil(PARTS_PER_DISTANCE * extent / max(distance, 1e-30)), 1.0, MAX_PARTS);
        for (var part = 0.5; part < parts; part += 1.0) {
            let at = position + (extent * (part / parts - 0.5)) * ray;
            scattered.light += scattered_rect_light(i, at, ray, anisotropy) / parts;
        }
    }
    return scattered;
}

// Light of a rectangle light that fog with an albedo of 1 scatters at a point (world space) along a ray (world
// space, unit length), cd/m²: its radiance, times its solid angle, times the mean of the phase function over nine
// points.
fn scattered_rect_light(i: u32, position: vec3<f32>, ray: vec3<f32>, anisotropy: f32) -> vec3<f32> {
    let place = rect_place(i, position);
    if place.height <= 0.0 {
        return vec3(0.0);
    }
    let to_light = -place.from_light;
    let corners = array(
        to_light + place.half_width - place.half_height,
        to_light - place.half_width - place.half_height,
        to_light - place.half_width + place.half_height,
        to_light + place.half_width + place.half_height,
    );
    let area = bevy::lights.rect_lights[i].width * bevy::lights.rect_lights[i].height;
    // From the area rather than the corners, whose product would cancel far from the light.
    let triple = area * place.height;
    let angle = solid_angle(triple, corners[0], corners[1], corners[2])
        + solid_angle(triple, corners[0], corners[2], corners[3]);
    var weights = 0.0;
    var phases = 0.0;
    for (var point = 0u; point < 9u; point++) {
        let along = vec2(f32(point % 3u), f32(point / 3u)) - 1.0;
        let node = GAUSS_NODE * along;
        let to_point = to_light + node.x * place.half_width + node.y * place.half_height;
        let inverse = inverseSqrt(max(dot(to_point, to_point), 1e-30));
        // The rule's weights are in the ratio 5 to 8; the distance to the plane is the same for all.
        let rule = vec2(8.0) - 3.0 * abs(along);
        let weight = rule.x * rule.y * inverse * inverse * inverse;
        weights += weight;
        phases += weight * phase(anisotropy, clamp(dot(to_point, ray) * inverse, -1.0, 1.0));
    }
    let range = max(bevy::lights.rect_lights[i].range, 0.01);
    let falloff = lighting::getRangeFalloff(dot(to_light, to_light), 1.0 / (range * range));
    return bevy::lights.rect_lights[i].color.rgb * (falloff * angle * phases / weights);
}
