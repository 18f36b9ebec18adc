// Single and multiple scattering of fog towards the viewer.
//
// Light from light sources is split into octaves, after Wrenninge, Kulla and Lundqvist 2013, "Oz: The Great
// and Volumetric". Light that has been scattered several times reaches deeper into fog, and more evenly from
// all sides. Each octave therefore has half the optical depth towards the light (all octaves share one ray),
// a more isotropic phase function, and a smaller share of the light. In the paper that share is constant, so
// fog too thin to scatter light twice appears twice as bright. Here it is the probability that light is
// scattered again, which depends on the optical depth of the ray and on the albedo.
//
// Uniform light from the environment uses the closed form of the two-stream approximation for a layer with
// the optical depth of the ray (Schuster 1905, "Radiation through a foggy atmosphere"). The light that the
// layer does not absorb is visible.
//
// docs/reference/fog.md compares the errors of both with those of single scattering.
#define_import_path bevy_vdb::trace::scattering

// Without shadows, there is no optical depth towards the light to halve.
#ifdef VDB_MULTIPLE_SCATTERING
#ifdef VDB_SHADOWS
const OCTAVES: u32 = 4u;
#else
const OCTAVES: u32 = 1u;
#endif
#else
const OCTAVES: u32 = 1u;
#endif

// Ratio of the anisotropy of each octave to that of the previous one.
const OCTAVE_ANISOTROPY: f32 = 0.75;
// Fraction of light that is scattered again in infinitely deep fog without absorption, and the optical depth
// at which that fraction is halved. With these values, white clouds lit by suns from all sides are on
// average as bright as their surroundings.
const RESCATTERED: f32 = 0.9;
const RESCATTER_DEPTH: f32 = 2.0;
// Rays end at this optical depth, so the fog beyond it is unknown.
const MAX_DEPTH: f32 = 16.0;

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

// How much light arrives through an optical depth in each octave, which has half the depth of the one before.
fn octaves_of_depth(depth: f32) -> array<f32, OCTAVES> {
    var octaves = array<f32, OCTAVES>();
    var visibility = exp(-depth / f32(1u << (OCTAVES - 1u)));
    for (var octave = OCTAVES; octave > 0u; octave--) {
        octaves[octave - 1u] = visibility;
        visibility *= visibility;
    }
    return octaves;
}

fn add_sample(sums: ptr<function, ScatteringSums>, weight: f32, albedo: vec3<f32>, light: InScattered) {
#ifdef VDB_MULTIPLE_SCATTERING
    for (var i = 0u; i < OCTAVES; i++) {
        (*sums).octaves[i] += weight * albedo * light.octaves[i];
    }
    (*sums).environment += weight * light.environment;
    (*sums).albedo += weight * albedo;
    (*sums).anisotropy += weight * light.anisotropy;
    (*sums).weight += weight;
#else
    (*sums).octaves[0] += weight * albedo * (light.octaves[0] + light.environment);
#endif
}

// Adds the sums over a slab.
fn add_sums(sums: ptr<function, ScatteringSums>, weight: f32, other: ScatteringSums) {
    for (var i = 0u; i < OCTAVES; i++) {
        (*sums).octaves[i] += weight * other.octaves[i];
    }
#ifdef VDB_MULTIPLE_SCATTERING
    (*sums).environment += weight * other.environment;
    (*sums).albedo += weight * other.albedo;
    (*sums).anisotropy += weight * other.anisotropy;
    (*sums).weight += weight * other.weight;
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
    let depth = min(optical_depth, MAX_DEPTH);
    let rescattered = RESCATTERED * albedo * albedo * (depth / (depth + RESCATTER_DEPTH));
    var octave_weight = rescattered;
    for (var i = 1u; i < OCTAVES; i++) {
        radiance += octave_weight * sums.octaves[i];
        octave_weight *= rescattered;
    }
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
