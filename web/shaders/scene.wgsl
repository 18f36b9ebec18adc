// What a frame is made of: the view, the look, the sky, and random numbers. Colours are linear, light is in units of
// the page's own.
#define_import_path vdb_web::scene

#import bevy_vdb::gpu::types::Rays

// One volume as seen by the camera. `web/wasm/src/view.rs` mirrors it field by field.
struct View {
    rays: Rays,
    // World-space directions of view rays, per unit of t.
    dir: vec3<f32>,
    eye_height: f32,            // over the ground, world units
    dir_x: vec3<f32>,
    radius: f32,                // half the diagonal of the volume's box, world units
    dir_y: vec3<f32>,
    pad_a: f32,
    normal: array<vec4<f32>, 3>,    // columns of the matrix from index-space gradients to world normals
    lattice: array<vec4<f32>, 3>,   // columns of the matrix from world to lattice directions
    center: vec2<f32>,          // x and z of the centre of the volume's box, from the eye, world units
    pad_b: vec2<f32>,
    base: vec3<i32>,            // the index-space cell that is local cell 0
}

// `web/page/renderer.js` writes it, in this order.
struct Look {
    to_sun: vec3<f32>,          // unit length
    extinction: f32,            // of fog, per unit of density and world unit
    color: vec3<f32>,           // albedo
    frame: u32,                 // 0 for the first, whose rays pass through the centres of pixels
    size: vec2<u32>,            // of the image, in rays
    first_row: u32,             // of this dispatch, in tiles of 8×8 rays
    shows_data: u32,            // 1 to show what was found instead of its light
}

@group(2) @binding(4) var<uniform> view: View;
@group(2) @binding(5) var<uniform> look: Look;
// The first frame, and the sum of all others; in data, alpha is 1.
@group(2) @binding(6) var<storage, read_write> first_frame: array<vec4<f32>>;
@group(2) @binding(7) var<storage, read_write> frame_sum: array<vec4<f32>>;

const PI: f32 = 3.14159265;

// Irradiance of the sun at right angles, and its apparent radius as a tangent: larger than the real one, for soft
// shadows.
const SUN: vec3<f32> = vec3(3.5, 3.05, 2.5);
const SUN_RADIUS: f32 = 0.035;

const ZENITH: vec3<f32> = vec3(0.03, 0.085, 0.21);
const HORIZON: vec3<f32> = vec3(0.4, 0.48, 0.56);
// Irradiance of the sky on the ground, chosen by eye: up to three times the integral of `sky`, with which shadows are
// too dark.
const SKY: vec3<f32> = vec3(0.45, 0.67, 1.0);

const GROUND: vec3<f32> = vec3(0.2, 0.21, 0.23);
// The radii of the volume after which the ground has faded into the horizon by 1 - 1/e, and within which it is
// shaded by the volume.
const GROUND_FADE: f32 = 7.0;
const GROUND_SHADOW: f32 = 9.0;

// Radiance of the sky in a direction of unit length.
fn sky(dir: vec3<f32>) -> vec3<f32> {
    let clear = mix(ZENITH, HORIZON, exp(-6.5 * max(dir.y, 0.0)));
    let to_sun = saturate(dot(dir, look.to_sun));
    let glow = 0.35 * pow(to_sun, 12.0) + 0.5 * pow(to_sun, 160.0);
    return clear + glow * vec3(1.0, 0.72, 0.45);
}

// Radiance that the lit ground sends upwards, far from the volume.
fn ground_light() -> vec3<f32> {
    return GROUND / PI * (max(look.to_sun.y, 0.0) * SUN + SKY);
}

// Radiance from a direction in which there is no volume.
fn surroundings(dir: vec3<f32>) -> vec3<f32> {
    if dir.y < 0.0 {
        return mix(ground_light(), sky(dir), exp(8.0 * dir.y));
    }
    return sky(dir);
}

// A permutation of 32-bit numbers without visible pattern (Jarzynski and Olano 2020, "Hash functions for GPU
// rendering").
fn pcg(x: u32) -> u32 {
    let state = x * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// Two numbers in [0, 1), evenly distributed over the frames of a pixel: the R2 sequence (Roberts 2018), shifted for
// each pixel and dimension.
fn random_pair(pixel: vec2<u32>, dimension: u32) -> vec2<f32> {
    let seed = pcg(pixel.x + pcg(pixel.y + pcg(dimension)));
    let shift = vec2(seed, pcg(seed));
    // In units of 2^-32, whose sums wrap as fractions do.
    let sequence = shift + look.frame * vec2(3242174889u, 2447445414u);
    return vec2<f32>(sequence >> vec2(8u)) / 16777216.0;
}

// Where the rays of a frame pass through their pixels, from the centre: the R2 sequence, the same in all pixels.
fn pixel_offset() -> vec2<f32> {
    let sequence = look.frame * vec2(3242174889u, 2447445414u);
    let random = vec2<f32>(sequence >> vec2(8u)) / 16777216.0;
    return select(random - 0.5, vec2(0.0), look.frame == 0u);
}

// Two directions that complete one of unit length (Duff et al. 2017, "Building an orthonormal basis, revisited").
struct Basis {
    x: vec3<f32>,
    y: vec3<f32>,
}

fn basis_of(n: vec3<f32>) -> Basis {
    let sign = select(-1.0, 1.0, n.z >= 0.0);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    return Basis(
        vec3(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        vec3(b, sign + n.y * n.y * a, -n.y),
    );
}

fn on_disc(random: vec2<f32>) -> vec2<f32> {
    let angle = 2.0 * PI * random.y;
    return sqrt(random.x) * vec2(cos(angle), sin(angle));
}

// A direction to a point of the sun; to its centre in the first frame.
fn to_sun_point(random: vec2<f32>) -> vec3<f32> {
    if look.frame == 0u {
        return look.to_sun;
    }
    let basis = basis_of(look.to_sun);
    let at = SUN_RADIUS * on_disc(random);
    return normalize(look.to_sun + at.x * basis.x + at.y * basis.y);
}

// A direction around a normal, distributed like the cosine.
fn around_normal(n: vec3<f32>, random: vec2<f32>) -> vec3<f32> {
    let basis = basis_of(n);
    let at = on_disc(random);
    return at.x * basis.x + at.y * basis.y + sqrt(max(1.0 - dot(at, at), 0.0)) * n;
}
