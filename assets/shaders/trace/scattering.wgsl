// Single and multiple scattering of fog towards the viewer.
//
// The phase function of Henyey and Greenstein with an anisotropy g is divided into a forward peak and a rest that
// is linear in the cosine (delta-Eddington approximation: Joseph, Wiscombe and Weinman 1976): f q + (1 - f) p',
// with f = g², p'(c) = (1 + 3 g' c) / 4π and g' = g / (1 + g). Moments of q up to the second are those of a ray
// that goes straight on, so light that is only scattered in the peak has a closed form: of k such events on a
// path through the optical depths towards the light and the viewer, the number is distributed as Poisson's, and
// their phase function is q convolved k times. Light that was scattered otherwise twice or more comes from a
// coarse lattice (`trace/scattered_light.wgsl`), in which only the rest attenuates.
//
// Uniform light from the environment uses the closed form of the two-stream approximation for a layer with
// the optical depth of the ray (Schuster 1905, "Radiation through a foggy atmosphere"). The light that the
// layer does not absorb is visible.
//
// docs/reference/fog.md compares the errors of both with those of single scattering.
#define_import_path bevy_vdb::trace::scattering

#import bevy_render::maths::PI

// Optical depth beyond which nothing is visible: e^-16 is 1/4,000 of the step of 16-bit floats near 1. Rays
// end there, so the fog beyond it is unknown.
const OPAQUE_DEPTH: f32 = 16.0;

// A factor for each channel, where albedos vary or have a colour; otherwise one for all channels.
struct Tint {
#ifdef VDB_VARYING_ALBEDO
    value: vec3<f32>,
#else
    value: f32,
#endif
}

// The factor of a colour that is the same in all channels unless factors are for each.
fn tint(color: vec3<f32>) -> Tint {
#ifdef VDB_VARYING_ALBEDO
    return Tint(color);
#else
    return Tint(dot(color, vec3(1.0 / 3.0)));
#endif
}

// What `tint` leaves of a colour.
fn remaining_color(color: vec3<f32>) -> vec3<f32> {
#ifdef VDB_VARYING_ALBEDO
    return vec3(1.0);
#else
    return color / max(dot(color, vec3(1.0 / 3.0)), 1e-30);
#endif
}

// A homogeneous slab of an optical depth τ: its opacity 1 - e^-τ, and its mean transmittance, (1 - e^-τ) / τ.
struct Slab {
    opacity: f32,
    mean: f32,
}

fn slab(depth: f32) -> Slab {
    let opacity = 1.0 - exp(-depth);
    let mean = select(opacity / max(depth, 1e-2), 1.0 - depth * (0.5 - depth / 6.0), depth < 1e-2);
    return Slab(opacity, mean);
}

fn mean_transmittance(depth: f32) -> f32 {
    return slab(depth).mean;
}

// Henyey–Greenstein phase function per steradian, normalised over the sphere. Henyey and Greenstein 1941,
// "Diffuse radiation in the galaxy".
fn phase(anisotropy: f32, cosine: f32) -> f32 {
    // 1 + g² - 2·g·cos, from terms that do not cancel.
    let one_minus_g = 1.0 - anisotropy;
    let root = inverseSqrt(one_minus_g * one_minus_g + 2.0 * anisotropy * (1.0 - cosine));
    return (1.0 - anisotropy * anisotropy) / (4.0 * PI) * (root * root * root);
}

// What is visible of a point on a ray or, in the mean, of a stretch of it.
struct Visible {
    whole: f32,
#ifdef VDB_SCATTERED
    rest: Tint,         // where only what is scattered outside of the peak, or absorbed, attenuates
    forward: Tint,      // optical depth of scattering in the peak, between the viewer and what is visible
#endif
}

// What is visible where a ray from the viewer starts: everything.
fn all_visible() -> Visible {
    var visible = Visible();
    visible.whole = 1.0;
#ifdef VDB_SCATTERED
    visible.rest = Tint(Tint().value + 1.0);
#endif
    return visible;
}

// Properties of fog at a point that decide how its light is scattered.
struct Scatterer {
    anisotropy: f32,
    albedo: Tint,
#ifdef VDB_SCATTERED
    forward: Tint,      // optical depth of scattering in the peak towards the viewer
#endif
}

// Light at a point in fog that is scattered towards the viewer, for an albedo of 1, cd/m².
struct InScattered {
    whole: vec3<f32>,           // has the weight `Visible::whole`
#ifdef VDB_SCATTERED
    rest: vec3<f32>,            // has the weight `Visible::rest`
    // Illuminance of lights with shadows, and what surfaces and meshes let through of it.
    all: f32,
    unoccluded: f32,
#endif
}

// Sums over points on a ray, weighted by how much of each is visible.
struct ScatteringSums {
    radiance: vec3<f32>,        // light from lights
#ifdef VDB_MULTIPLE_SCATTERING
    environment: vec3<f32>,     // light from the environment, without attenuation
    albedo: vec3<f32>,
    anisotropy: f32,
    weight: f32,
#endif
}

fn add_tints(a: Tint, b: Tint) -> Tint {
    return Tint(a.value + b.value);
}

#ifdef VDB_SCATTERED
// The fraction f of the forward peak.
fn forward_part(anisotropy: f32) -> f32 {
    let g = max(anisotropy, 0.0);
    return g * g;
}

// The anisotropy g' of the rest.
fn rest_anisotropy(anisotropy: f32) -> f32 {
    return anisotropy / (1.0 + max(anisotropy, 0.0));
}

// Below this anisotropy, the terms of the convolved peaks cancel; they are those of an anisotropy of 0.
const LEAST_PEAK: f32 = 0.1;

// Phase functions, per steradian: of light scattered in the peak once, twice, and more often, times f; and of
// light scattered otherwise, times 1 - f.
fn split_phases(anisotropy: f32, cosine: f32) -> vec4<f32> {
    let f = forward_part(anisotropy);
    let rest = (1.0 - f) * (1.0 + 3.0 * rest_anisotropy(anisotropy) * cosine) / (4.0 * PI);
    let once = phase(anisotropy, cosine) - rest;
    let g = max(anisotropy, LEAST_PEAK);
    let squared = g * g;
    let factors = vec2(1.0 / squared, 1.0 / (squared * squared));
    let peaks = factors * vec2(phase(squared, cosine), phase(squared * g, cosine));
    let moments = squared - factors + 3.0 * cosine * (squared - vec2(1.0, 1.0 / g));
    let even = f * (1.0 + 3.0 * cosine + 2.5 * (3.0 * cosine * cosine - 1.0)) / (4.0 * PI);
    let twice = select(peaks + moments / (4.0 * PI), vec2(even), anisotropy < LEAST_PEAK);
    return vec4(once, twice, rest);
}

// Light that arrives through an optical depth τ of fog, for m expected events in the peak up to the viewer: all of it
// that is scattered once there, twice, and more often, and what is scattered otherwise.
struct Arriving {
    once: f32,
    twice: Tint,
    often: Tint,
    rest: Tint,
}

// ((e^m - 1) / m - 1 - m / 2) e^-τ, given e^-τ and e^(m - τ).
fn scattered_often(m: f32, e: f32, e_m: f32) -> f32 {
    let exact = (e_m - e) / max(m, 0.1) - e * (1.0 + 0.5 * m);
    return max(select(exact, e * m * m * (1.0 / 6.0 + m / 24.0), m < 0.1), 0.0);
}

// `forward` is the part of the depth that is scattering in the peak, `towards_viewer` the same depth towards the
// viewer, and `gain` its exponential.
fn arriving_light(depth: f32, forward: Tint, towards_viewer: Tint, gain: Tint) -> Arriving {
    let e = exp(-depth);
    let m = towards_viewer.value + forward.value;
    let rest = exp(forward.value - depth);
    let e_m = rest * gain.value;
#ifdef VDB_VARYING_ALBEDO
    let often = vec3(
        scattered_often(m.x, e, e_m.x),
        scattered_often(m.y, e, e_m.y),
        scattered_often(m.z, e, e_m.z),
    );
#else
    let often = scattered_often(m, e, e_m);
#endif
    return Arriving(e, Tint((0.5 * e) * m), Tint(often), Tint(rest));
}

// The optical depth of scattering in the peak, for an optical depth of fog.
fn forward_depth(depth: f32, albedo: Tint, anisotropy: f32) -> Tint {
    // An albedo above 1 amplifies light; it does not make fog thinner.
    return Tint((depth * forward_part(anisotropy)) * min(albedo.value, Tint().value + 1.0));
}

#endif

// What is visible of a homogeneous stretch with an optical depth, of which `forward` is that of scattering in the peak.
// `end` is what is visible of its start, and then of its end.
fn pass_stretch(
    end: ptr<function, Visible>,
    depth: f32,
#ifdef VDB_SCATTERED
    forward: Tint,
#endif
) -> Visible {
    var visible = Visible();
    let whole = slab(depth);
    visible.whole = (*end).whole * whole.mean;
    (*end).whole -= (*end).whole * whole.opacity;
#ifdef VDB_SCATTERED
#ifdef VDB_VARYING_ALBEDO
    let x = slab(max(depth - forward.value.x, 0.0));
    let y = slab(max(depth - forward.value.y, 0.0));
    let z = slab(max(depth - forward.value.z, 0.0));
    let opacity = vec3(x.opacity, y.opacity, z.opacity);
    let mean = vec3(x.mean, y.mean, z.mean);
#else
    let rest = slab(max(depth - forward.value, 0.0));
    let opacity = rest.opacity;
    let mean = rest.mean;
#endif
    visible.rest = Tint((*end).rest.value * mean);
    (*end).rest = Tint((*end).rest.value * (1.0 - opacity));
    // What is visible in the mean is behind the optical depth -ln(1 - opacity / 2): the first terms of its series,
    // and a last one that makes it right for all that is opaque.
    let series = 0.5 + whole.opacity * (0.125 + whole.opacity * (0.041667 + whole.opacity * 0.02648));
    visible.forward = Tint((*end).forward.value + (whole.mean * series) * forward.value);
    (*end).forward = add_tints((*end).forward, forward);
#endif
    return visible;
}

#ifdef VDB_SCATTERED
// Adds a light with shadows, of which surfaces and meshes let a fraction through.
fn add_occlusion(light: ptr<function, InScattered>, illuminance: vec3<f32>, unoccluded: f32) {
    let amount = dot(illuminance, vec3(1.0));
    (*light).all += amount;
    (*light).unoccluded += unoccluded * amount;
}
#endif

// Adds light that arrives at a point through an optical depth of fog, from a light whose direction has a cosine with
// that of the view ray. 1 is straight ahead of the viewer.
fn add_attenuated(
    light: ptr<function, InScattered>,
    illuminance: vec3<f32>,
    depth: f32,
    cosine: f32,
    scatterer: Scatterer,
) {
#ifdef VDB_SCATTERED
    let phases = split_phases(scatterer.anisotropy, cosine);
    let forward = forward_depth(depth, scatterer.albedo, scatterer.anisotropy);
    let own = arriving_light(depth, forward, scatterer.forward, Tint(exp(scatterer.forward.value)));
    (*light).whole += illuminance
        * (phases.x * own.once + phases.y * own.twice.value + phases.z * own.often.value);
    (*light).rest += illuminance * (phases.w * own.rest.value);
#else
    (*light).whole += illuminance * (exp(-depth) * phase(scatterer.anisotropy, cosine));
#endif
}

// Adds light that arrives at a point as it is.
fn add_unattenuated(
    light: ptr<function, InScattered>,
    illuminance: vec3<f32>,
    cosine: f32,
    anisotropy: f32,
) {
    (*light).whole += illuminance * phase(anisotropy, cosine);
}

// Adds a stretch of fog to the sums for the environment, of whose light it is.
fn add_environment(
    sums: ptr<function, ScatteringSums>,
    weight: f32,
    albedo: vec3<f32>,
    environment: vec3<f32>,
    anisotropy: f32,
) {
#ifdef VDB_MULTIPLE_SCATTERING
    (*sums).environment += weight * environment;
    (*sums).albedo += weight * albedo;
    (*sums).anisotropy += weight * anisotropy;
    (*sums).weight += weight;
#else
    (*sums).radiance += weight * albedo * environment;
#endif
}

// Radiance scattered along a ray of an optical depth, from its sums.
fn scattered_radiance(sums: ScatteringSums, optical_depth: f32) -> vec3<f32> {
    // The rest of a phase function is negative backwards.
    var radiance = max(sums.radiance, vec3(0.0));
#ifdef VDB_MULTIPLE_SCATTERING
    let weight = max(sums.weight, 1e-30);
    let mean_albedo = sums.albedo / weight;
    let albedo = saturate(mean_albedo);
    let anisotropy = sums.anisotropy / weight;
    let depth = min(optical_depth, OPAQUE_DEPTH);
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
