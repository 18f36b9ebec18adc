// What the fogs of a ray scatter to the viewer, once and again.
//
// Lights, by octaves: Wrenninge, Kulla and Lundqvist 2013, "Oz: The Great and Volumetric". Light that is
// scattered again reaches deeper and from all sides more evenly; each octave has half the optical depth
// towards the light (all share one ray to it), a rounder phase function, and a part of the light. Theirs is a
// fixed part, so that fog too thin to scatter anything again shines twice as bright; here it is the random
// numbers that the light meets the fog again, by the ray's own optical depth, and the albedo.
//
// Surroundings that shine evenly: two streams through a layer of the ray's optical depth (Schuster 1905,
// "Radiation through a foggy atmosphere"), which have a closed form. What of them is not absorbed is seen.
//
// docs/reference/fog.md has the error of both, beside that of single scattering.
#define_import_path bevy_vdb::trace::scattering

// Where no light throws shadows, there is no depth towards it to halve.
#ifdef VDB_MULTIPLE_SCATTERING
#ifdef VDB_SHADOWS
const OCTAVES: u32 = 4u;
#else
const OCTAVES: u32 = 1u;
#endif
#else
const OCTAVES: u32 = 1u;
#endif

// The part of the anisotropy that the next octave has.
const OCTAVE_ANISOTROPY: f32 = 0.75;
// The part of the light that is scattered again in a fog without an end that absorbs nothing, and the
// optical depth at which it is half of that: with these, clouds in the light of suns all around them are
// as bright as if they were not there, on the whole.
const RESCATTERED: f32 = 0.9;
const RESCATTER_DEPTH: f32 = 2.0;
// What is behind this optical depth is not known: rays end there.
const MAX_DEPTH: f32 = 16.0;

// What fog of albedo 1 scatters back along a ray at a place, cd/m².
struct InScattered {
    octaves: array<vec3<f32>, OCTAVES>,     // of lights
    environment: vec3<f32>,                      // of surroundings, as if nothing dimmed them
    anisotropy: f32,                        // of that fog
}

// Sums over places on a ray, by how much is seen of each.
struct ScatteringSums {
    octaves: array<vec3<f32>, OCTAVES>,
#ifdef VDB_MULTIPLE_SCATTERING
    environment: vec3<f32>,
    albedo: vec3<f32>,
    anisotropy: f32,
    weight: f32,
#endif
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

// Adds what was gathered within a stretch.
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

// The light of all that was gathered along a ray through so much optical depth.
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
    // Of even light, a layer without end absorbs 2a / (1 + a).
    let absorption = 1.0 - albedo;
    let reduced_extinction = 1.0 - anisotropy * albedo;
    let layer_absorption = sqrt(absorption / reduced_extinction) * tanh(0.5 * depth * sqrt(absorption * reduced_extinction));
    let returned = max((1.0 - layer_absorption) / (1.0 + layer_absorption) - exp(-depth), vec3(0.0));
    // An albedo above 1 gives light that there was not.
    radiance += returned * max(mean_albedo, vec3(1.0)) * sums.environment / weight;
#endif
    return radiance;
}
