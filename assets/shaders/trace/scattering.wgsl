// Single and multiple scattering of fog towards the viewer.
//
// Light from light sources is split into octaves, after Wrenninge, Kulla and Lundqvist 2013, "Oz: The Great
// and Volumetric". Light that has been scattered several times reaches deeper into fog, and more evenly from
// all sides, so each octave has a smaller extinction towards the light, a more isotropic phase function and
// an amplitude of its own. Here they depend on what decides how often light is scattered: on the optical
// depth of the ray, on the albedo and the anisotropy, and on how near the point is to where light enters and
// leaves. The constants are fitted to path tracing by scripts/fit-scattering.
//
// Uniform light from the environment uses the closed form of the two-stream approximation for a layer with
// the optical depth of the ray (Schuster 1905, "Radiation through a foggy atmosphere"). The light that the
// layer does not absorb is visible.
//
// docs/reference/fog.md compares the errors of both with those of single scattering.
#define_import_path bevy_vdb::trace::scattering

#import bevy_render::maths::PI

#ifdef VDB_OCTAVES
const OCTAVES: u32 = 3u;
#else
const OCTAVES: u32 = 1u;
#endif

// The second octave is mostly light that is scattered twice; the third, light that is scattered many times.
// `u` is 1 - g for an anisotropy g > 0, and otherwise 1.
//
// Ratios of the extinction towards the light to that of the first octave, divided by √u.
const OCTAVE_EXTINCTION = vec2(0.987, 0.247);
// Close to where light enters, the second octave has not built up yet: it is multiplied by exp(-B T), for a
// transmittance T towards the light.
const BUILD_UP: f32 = 0.678;
// Likewise, close to where light leaves for the viewer, octaves are multiplied by exp(-E T), for a
// transmittance T towards the viewer. For the second octave, E = ESCAPE.x - u ESCAPE.y; for the third, E =
// ESCAPE.z.
const ESCAPE = vec3(1.13, 0.567, 4.54);
// The amplitude of the second octave is A τ / (τ + D), for a ray of optical depth τ; of the third,
// A τ / (1 + u τ / D).
const OCTAVE_AMPLITUDE = vec2(2.89, 0.609);
const OCTAVE_DEPTH = vec2(1.1, 29.0);
// Optical depth beyond which nothing is visible: e^-16 is 1/4,000 of the step of 16-bit floats near 1. Rays
// end there, so the fog beyond it is unknown.
const OPAQUE_DEPTH: f32 = 16.0;

// Light scattered along a ray at a point in fog with an albedo of 1, cd/m².
struct InScattered {
    octaves: array<vec3<f32>, OCTAVES>,     // from lights
    environment: vec3<f32>,                 // from the environment, without attenuation
    anisotropy: f32,                        // of the fog
}

// Sums over points on a ray, weighted by how much of each is visible.
struct ScatteringSums {
    octaves: array<vec3<f32>, OCTAVES>,
#ifdef VDB_MULTIPLE_SCATTERING
    environment: vec3<f32>,
    albedo: vec3<f32>,
    anisotropy: f32,
    weight: f32,
#endif
}

// Henyey–Greenstein phase function per steradian, normalised over the sphere. Henyey and Greenstein 1941,
// "Diffuse radiation in the galaxy".
fn phase(anisotropy: f32, cosine: f32) -> f32 {
    // 1 + g² - 2·g·cos, from terms that do not cancel.
    let one_minus_g = 1.0 - anisotropy;
    let root = inverseSqrt(one_minus_g * one_minus_g + 2.0 * anisotropy * (1.0 - cosine));
    return (1.0 - anisotropy * anisotropy) / (4.0 * PI) * (root * root * root);
}

// Anisotropy of each octave: scattering n times has the Henyey–Greenstein phase function of gⁿ.
fn octave_anisotropies(anisotropy: f32) -> array<f32, OCTAVES> {
    var octaves = array<f32, OCTAVES>();
    octaves[0] = anisotropy;
#ifdef VDB_OCTAVES
    let squared = anisotropy * anisotropy;
    octaves[1] = squared;
    octaves[2] = squared * squared * squared * squared;
#endif
    return octaves;
}

fn isotropic_part(anisotropy: f32) -> f32 {
    return 1.0 - max(anisotropy, 0.0);
}

// How much light an occluder of an optical depth lets through in each octave.
fn octave_transmittances(depth: f32, anisotropy: f32) -> array<f32, OCTAVES> {
    var octaves = array<f32, OCTAVES>();
    octaves[0] = exp(-depth);
#ifdef VDB_OCTAVES
    let depths = (sqrt(isotropic_part(anisotropy)) * depth) * OCTAVE_EXTINCTION;
    octaves[1] = exp(-depths.x);
    octaves[2] = exp(-depths.y);
#endif
    return octaves;
}

// How much light arrives through an optical depth of fog in each octave.
fn octaves_of_depth(depth: f32, anisotropy: f32) -> array<f32, OCTAVES> {
    var octaves = octave_transmittances(depth, anisotropy);
#ifdef VDB_OCTAVES
    octaves[1] *= exp(-BUILD_UP * octaves[0]);
#endif
    return octaves;
}

// Transmittances towards the viewer at both ends of a stretch of a ray: mean, and half of the difference.
struct Visibility {
    mean: f32,
    half_range: f32,
}

fn visibility_between(near: f32, far: f32) -> Visibility {
    return Visibility(0.5 * (near + far), 0.5 * (near - far));
}

// Weights of a stretch of a ray in each octave. `weight` is the fraction of the pixel that the stretch
// covers. The second and third octaves are multiplied by the mean of exp(-E T) over the stretch, in which T
// is evenly distributed when weighted by visibility: exp(-E mean) sinh(x) / x, by the first terms of its
// series.
fn octave_weights(weight: f32, visible: Visibility, anisotropy: f32) -> array<f32, OCTAVES> {
    var weights = array<f32, OCTAVES>();
    weights[0] = weight;
#ifdef VDB_OCTAVES
    let escape = vec2(ESCAPE.x - ESCAPE.y * isotropic_part(anisotropy), ESCAPE.z);
    let x = escape * visible.half_range;
    let x_squared = x * x;
    let others = weight * exp(-escape * visible.mean) * (1.0 + x_squared / 6.0 * (1.0 + x_squared / 20.0));
    weights[1] = others.x;
    weights[2] = others.y;
#endif
    return weights;
}

// Adds a sample with the weights of its octaves.
fn add_sample(
    sums: ptr<function, ScatteringSums>,
    weights: array<f32, OCTAVES>,
    albedo: vec3<f32>,
    light: InScattered,
) {
    let weight = weights[0];
#ifdef VDB_MULTIPLE_SCATTERING
    for (var i = 0u; i < OCTAVES; i++) {
        (*sums).octaves[i] += weights[i] * albedo * light.octaves[i];
    }
    (*sums).environment += weight * light.environment;
    (*sums).albedo += weight * albedo;
    (*sums).anisotropy += weight * light.anisotropy;
    (*sums).weight += weight;
#else
    (*sums).octaves[0] += weight * albedo * (light.octaves[0] + light.environment);
#endif
}

#ifdef VDB_VARYING_ALBEDO
// Adds a sample of which `weight` is the weight and `scattered` the products of the weights of its octaves with
// an albedo that varies within it.
fn add_varied_sample(
    sums: ptr<function, ScatteringSums>,
    weight: f32,
    scattered: array<vec3<f32>, OCTAVES>,
    light: InScattered,
) {
    var factors = scattered;
#ifdef VDB_MULTIPLE_SCATTERING
    for (var i = 0u; i < OCTAVES; i++) {
        (*sums).octaves[i] += factors[i] * light.octaves[i];
    }
    (*sums).environment += weight * light.environment;
    (*sums).albedo += factors[0];
    (*sums).anisotropy += weight * light.anisotropy;
    (*sums).weight += weight;
#else
    (*sums).octaves[0] += factors[0] * (light.octaves[0] + light.environment);
#endif
}
#endif

// Adds the sums over a slab, times a factor.
fn add_sums(sums: ptr<function, ScatteringSums>, weight: f32, visible: Visibility, other: ScatteringSums) {
#ifdef VDB_MULTIPLE_SCATTERING
    let anisotropy = other.anisotropy / max(other.weight, 1e-30);
    var weights = octave_weights(weight, visible, anisotropy);
    for (var i = 0u; i < OCTAVES; i++) {
        (*sums).octaves[i] += weights[i] * other.octaves[i];
    }
    (*sums).environment += weight * other.environment;
    (*sums).albedo += weight * other.albedo;
    (*sums).anisotropy += weight * other.anisotropy;
    (*sums).weight += weight * other.weight;
#else
    (*sums).octaves[0] += weight * other.octaves[0];
#endif
}

// Radiance scattered along a ray of an optical depth, from its sums.
fn scattered_radiance(sums: ScatteringSums, optical_depth: f32) -> vec3<f32> {
    var radiance = sums.octaves[0];
#ifdef VDB_MULTIPLE_SCATTERING
    let weight = max(sums.weight, 1e-30);
    let mean_albedo = sums.albedo / weight;
    let albedo = saturate(mean_albedo);
    let anisotropy = sums.anisotropy / weight;
    let depth = min(optical_depth, OPAQUE_DEPTH);
#ifdef VDB_OCTAVES
    // Light in the second octave has been scattered once more than in the first, in the third eleven times
    // more.
    let squared = albedo * albedo;
    let fourth = squared * squared;
    radiance += (OCTAVE_AMPLITUDE.x * depth / (depth + OCTAVE_DEPTH.x)) * albedo * sums.octaves[1];
    radiance += (OCTAVE_AMPLITUDE.y * depth / (1.0 + isotropic_part(anisotropy) * depth / OCTAVE_DEPTH.y))
        * (fourth * fourth * squared * albedo) * sums.octaves[2];
#endif
    // Under uniform light, an infinitely deep layer absorbs 2a / (1 + a).
    let absorption = 1.0 - albedo;
    let reduced_extinction = 1.0 - anisotropy * albedo;
    let layer_absorption = sqrt(absorption / reduced_extinction)
        * tanh(0.5 * depth * sqrt(absorption * reduced_extinction));
    let returned = max((1.0 - layer_absorption) / (1.0 + layer_absorption) - exp(-depth), vec3(0.0));
    // An albedo above 1 amplifies light.
    radiance += returned * max(mean_albedo, vec3(1.0)) * sums.environment / weight;
#endif
    return radiance;
}

// Mean transmittance out of a homogeneous slab of an optical depth τ: (1 - e^-τ) / τ.
fn mean_transmittance(depth: f32) -> f32 {
    let exact = (1.0 - exp(-depth)) / max(depth, 1e-2);
    return select(exact, 1.0 - depth * (0.5 - depth / 6.0), depth < 1e-2);
}
