//! Every variant of every shader passes naga's validator, and can be written as SPIR-V: naga's writer panics at some
//! modules that its validator accepts.

mod fogs;
mod trace;

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

use naga::back::spv;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga_oil::compose::Composer;

use crate::compose::{composed, composer, source};
use crate::variants::save;

/// The def with which the functions of `compose::Everything` are compiled.
const EVERYTHING_DEF: &str = "VDB_MATERIAL_KIND_AA";

fn check(composer: &mut Composer, name: &str, defs: &[&str]) {
    let module = composed(composer, name, defs);
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .unwrap_or_else(|error| panic!("with {defs:?}: {}", error.emit_to_string(&source(name))));
    // As wgpu writes modules that are not checked at run time.
    let options =
        spv::Options { lang_version: (1, 3), force_loop_bounding: false, ..Default::default() };
    catch_unwind(AssertUnwindSafe(|| spv::write_vec(&module, &info, &options, None)))
        .unwrap_or_else(|_| panic!("naga panics while it writes {name} with {defs:?} as SPIR-V"))
        .unwrap_or_else(|error| {
            panic!("{name} with {defs:?} cannot be written as SPIR-V: {error}")
        });
    save(&module, &info, name, defs);
}

/// Checks variants of the trace, and counts them, so that no loop over defs is empty.
struct Trace {
    composer: Composer,
    variants: usize,
}

impl Trace {
    fn new() -> Self {
        Self { composer: composer(), variants: 0 }
    }

    fn check(&mut self, defs: &[&[&str]]) {
        let mut defs = defs.concat();
        if ["VDB_MULTIPLE_SCATTERING", "VDB_SHADOWS"].iter().all(|def| defs.contains(def)) {
            defs.push("VDB_SCATTERED");
        }
        if defs.contains(&"VDB_EMISSION") {
            defs.push("VDB_EMITS");
        }
        check(&mut self.composer, "trace/trace", &defs);
        self.variants += 1;
    }
}

/// Up to two fogs and one emission grid on a ray.
const TWO_FOGS: [&str; 2] = ["VDB_FOG_SLOTS=2", "VDB_EMITTER_SLOTS=1"];

const SHADOWS: [&str; 2] = ["VDB_SHADOWS", "SHADOW_FILTER_METHOD_GAUSSIAN"];

/// The defs of a view that interpolates the light that lamps scatter in fog.
const SCATTERED_LIGHT: [&str; 9] = [
    "VDB_LIT",
    "VDB_FOGS",
    "VDB_SHADOWS",
    "SHADOW_FILTER_METHOD_GAUSSIAN",
    "VDB_LOCAL_LIGHTS",
    "VDB_LIGHT_CACHE",
    "VDB_CACHED_LAMPS",
    "VDB_LAMP_LIGHT",
    "VDB_CACHED_SUNS=1",
];

/// All sets of some of the defs.
fn subsets<'a>(defs: &'a [&'a str]) -> impl Iterator<Item = Vec<&'a str>> + 'a {
    (0..1_u32 << defs.len()).map(|bits| {
        let on = |(i, def): (usize, &&'a str)| (bits >> i & 1 == 1).then_some(*def);
        defs.iter().enumerate().filter_map(on).collect()
    })
}

/// The shader defs of render modes without light, from the shader that asks for them.
fn unlit_modes() -> BTreeSet<String> {
    let path = source("trace/path");
    let words = path.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    let modes: BTreeSet<_> =
        words.filter(|word| word.starts_with("VDB_SHOW_")).map(Into::into).collect();
    assert!(!modes.is_empty(), "trace/path has the modes");
    modes
}

#[test]
fn cutting_volumes_is_valid() {
    let mut composer = composer();
    for with in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS", "VDB_LEVELS", "VDB_MANY"]) {
        let cut = [&["VDB_CLIP", "VDB_BEAMS"], &with[..]].concat();
        for mode in [
            &["VDB_SHOW_NORMALS"][..],
            &["VDB_LIT", "VDB_LOCAL_LIGHTS", "VDB_REFLECTIONS", "VDB_SMOOTH_NORMALS"],
            &["VDB_LIT", "VDB_SHADOWS", "SHADOW_FILTER_METHOD_GAUSSIAN"],
        ] {
            check(&mut composer, "trace/trace", &[&cut, mode].concat());
        }
    }
}

#[test]
fn gathering_the_light_of_lamps_is_valid() {
    let mut composer = composer();
    for with in
        [&[][..], &["VDB_MULTIPLE_SCATTERING", "VDB_SCATTERED"], &["VDB_PAGED", "VDB_PAGE_BITS=20"]]
    {
        check(&mut composer, "trace/lamp_light", &[&SCATTERED_LIGHT, with].concat());
    }
}

#[test]
fn filling_the_light_cache_is_valid() {
    let mut composer = composer();
    let features = [
        "VDB_EMISSION",
        "VDB_MULTIPLE_SCATTERING",
        "VDB_MANY",
        "VDB_WIDE_GRIDS",
        "VDB_RAMPS",
        "VDB_FOG_MATERIALS",
        "VDB_CLIP",
    ];
    for defs in subsets(&features) {
        let pages = ["VDB_FOGS", "VDB_PAGED", "VDB_PAGE_BITS=20", "VDB_FORMAT=2"];
        for shader in ["light_cache/fill", "light_cache/sun_rays"] {
            for target in [&[][..], &["VDB_STORABLE_LATTICE"]] {
                check(
                    &mut composer,
                    shader,
                    &[&["VDB_FOGS", EVERYTHING_DEF], target, &defs].concat(),
                );
                check(&mut composer, shader, &[&pages, target, &defs].concat());
            }
        }
    }
    check(&mut composer, "light_cache/sun_samples", &[]);
    check(&mut composer, "light_cache/sun_samples", &["VDB_STORABLE_LATTICE"]);
}

#[test]
fn solving_for_scattered_light_is_valid() {
    let mut composer = composer();
    let features = [
        "VDB_EMISSION",
        "VDB_MANY",
        "VDB_WIDE_GRIDS",
        "VDB_FOG_COLORS",
        "VDB_RAMPS",
        "VDB_FOG_MATERIALS",
        "VDB_CLIP",
        "VDB_LIGHT_CACHE",
        "VDB_CACHED_LAMPS",
    ];
    let always = ["VDB_FOGS", "VDB_MULTIPLE_SCATTERING", "VDB_SCATTERED"];
    for defs in subsets(&features) {
        let varying = ["VDB_FOG_COLORS", "VDB_RAMPS", "VDB_FOG_MATERIALS"];
        let albedo = if defs.iter().any(|def| varying.contains(def)) {
            &["VDB_VARYING_ALBEDO"][..]
        } else {
            &[]
        };
        let defs = [&always, &defs[..], albedo].concat();
        let pages = ["VDB_PAGED", "VDB_PAGE_BITS=20", "VDB_FORMAT=2"];
        check(&mut composer, "scattered_light/octants", &[&defs, &[EVERYTHING_DEF][..]].concat());
        check(&mut composer, "scattered_light/octants", &[&defs, &pages[..]].concat());
    }
    check(&mut composer, "scattered_light/solve", &[]);
}

#[test]
fn the_upscaling_is_valid() {
    let mut composer = composer();
    for defs in subsets(&["MULTISAMPLED", "VDB_MOTION_VECTORS", "VDB_ACCUMULATED"]) {
        check(&mut composer, "upscale/upscale", &defs);
    }
}

#[test]
fn the_means_of_frames_are_valid() {
    let mut composer = composer();
    for defs in subsets(&["MULTISAMPLED", "VDB_SCALED"]) {
        check(&mut composer, "accumulate/accumulate", &[&["VDB_ACCUMULATED"], &defs[..]].concat());
    }
}

#[test]
fn denoising_is_valid() {
    let mut composer = composer();
    let one_of: [&[_]; 3] = [&[], &["VDB_ACCUMULATED"], &["VDB_REFLECTION_HISTORY"]];
    for defs in one_of {
        check(&mut composer, "denoise/denoise", &[&["VDB_DENOISE"], defs].concat());
    }
}

#[test]
fn finding_edges_is_valid() {
    check(&mut composer(), "trace/edges", &["VDB_EDGES"]);
}

#[test]
fn the_beams_are_valid() {
    let mut composer = composer();
    let all = [
        "MULTISAMPLED",
        "VDB_SCALED",
        "VDB_ACCUMULATED",
        "VDB_EDGES",
        "VDB_WIDE_GRIDS",
        "VDB_LEVELS",
        "VDB_CLIP",
    ];
    for defs in subsets(&all) {
        check(&mut composer, "trace/beams", &defs);
        check(
            &mut composer,
            "trace/beams",
            &[&defs, &["VDB_PAGED", "VDB_PAGE_BITS=20"][..]].concat(),
        );
    }
}

#[test]
fn what_is_drawn_into_shadow_maps_is_valid() {
    let mut composer = composer();
    for kinds in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS"]) {
        let mut programs = vec!["shadow_maps/quad", "shadow_maps/cast"];
        if kinds.contains(&"VDB_FOGS") {
            programs.extend(["shadow_maps/cast_fog", "shadow_maps/fill_opacity"]);
        }
        for program in programs {
            let mut check = |with: &[&str]| check(&mut composer, program, &[&kinds, with].concat());
            check(&[]);
            check(&["VDB_WIDE_GRIDS"]);
            check(&["VDB_CLIP"]);
            if kinds.contains(&"VDB_FOGS") {
                check(&["VDB_RAMPS"]);
                check(&["VDB_FOG_MATERIALS", EVERYTHING_DEF]);
            }
            for format in ["VDB_FORMAT=0", "VDB_FORMAT=1", "VDB_FORMAT=2"] {
                check(&["VDB_PAGED", "VDB_PAGE_BITS=20", format]);
            }
        }
    }
    check(&mut composer, "shadow_maps/mesh_depth", &[]);
}

#[test]
fn smoothing_the_shadows_of_fog_is_valid() {
    let mut composer = composer();
    for filter in ["HARDWARE_2X2", "GAUSSIAN", "TEMPORAL"] {
        let filter = format!("SHADOW_FILTER_METHOD_{filter}");
        for defs in subsets(&["MULTISAMPLED", "VDB_LOCAL_LIGHTS", "VDB_WITH_FOG"]) {
            check(&mut composer, "fog_shadows/find", &[&defs, &[filter.as_str()][..]].concat());
        }
    }
    check(&mut composer, "fog_shadows/smooth", &[]);
    check(&mut composer, "fog_shadows/draw", &[]);
}
