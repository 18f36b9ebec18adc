//! Every variant of every shader passes naga's validator.

use std::collections::BTreeSet;

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
    save(&module, &info, name, defs);
}

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
#[ignore = "slow: more than a thousand variants"]
fn every_variant_of_the_trace_is_valid() {
    let mut composer = composer();
    let mut variants = 0;
    let mut check = |defs: &[&[&str]]| {
        let mut defs = defs.concat();
        if ["VDB_MULTIPLE_SCATTERING", "VDB_SHADOWS"].iter().all(|def| defs.contains(def)) {
            defs.push("VDB_SCATTERED");
        }
        if defs.contains(&"VDB_EMISSION") {
            defs.push("VDB_EMITS");
        }
        check(&mut composer, "trace/trace", &defs);
        variants += 1;
    };
    let shadows = ["VDB_SHADOWS", "SHADOW_FILTER_METHOD_GAUSSIAN"];
    let modes = unlit_modes();
    for kinds in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS"]) {
        // What is shown without light.
        for mode in &modes {
            for with in subsets(&["VDB_BEAMS", "VDB_OVERLAYS", "VDB_MOTION_VECTORS"]) {
                check(&[&kinds, &[mode], &with]);
            }
        }
        for dda in [
            vec!["VDB_COUNT_STEPS"],
            vec!["VDB_COUNT_STEPS", "VDB_HDDA"],
            vec!["VDB_COUNT_STEPS", "VDB_DDA", "VDB_MARCH"],
        ] {
            check(&[&kinds, &dda]);
        }
        // Light.
        for lights in
            subsets(&["VDB_LOCAL_LIGHTS", "ENVIRONMENT_MAP", "VDB_REFLECTIONS", "DISTANCE_FOG"])
        {
            let even =
                if lights.contains(&"VDB_LOCAL_LIGHTS") { &[][..] } else { &["VDB_EVEN_LIGHT"] };
            check(&[&["VDB_LIT"], &kinds, &lights, even]);
            check(&[&["VDB_LIT", "VDB_MOTION_VECTORS"], &kinds, &lights, &shadows]);
            if kinds.contains(&"VDB_FOGS") {
                check(&[&["VDB_LIT", "VDB_MULTIPLE_SCATTERING"], &kinds, &lights, even]);
                check(&[&["VDB_LIT", "VDB_MULTIPLE_SCATTERING"], &kinds, &lights, &shadows]);
            }
        }
        check(&[
            &["VDB_LIT", "VDB_LOCAL_LIGHTS", "VDB_OVERLAYS", "MULTISAMPLED", "VDB_BEAMS"],
            &kinds,
            &shadows,
        ]);
        // Further grids.
        for extras in subsets(&["VDB_EMISSION", "VDB_BLACKBODY", "VDB_COLORS"]) {
            if extras.contains(&"VDB_BLACKBODY") && !extras.contains(&"VDB_EMISSION") {
                continue;
            }
            check(&[&["VDB_LIT", "VDB_EVEN_LIGHT"], &kinds, &extras]);
            check(&[
                &["VDB_LIT", "VDB_LOCAL_LIGHTS", "DISTANCE_FOG", "VDB_REFLECTIONS"],
                &kinds,
                &extras,
                &shadows,
            ]);
        }
        for part in ["VDB_DIFFUSE_ONLY", "VDB_GLOSSY_ONLY"] {
            check(&[
                &["VDB_LIT", "VDB_LOCAL_LIGHTS", "ENVIRONMENT_MAP", "MULTISAMPLED", part],
                &kinds,
            ]);
        }
    }
    for filter in ["HARDWARE_2X2", "TEMPORAL"] {
        let filter = format!("SHADOW_FILTER_METHOD_{filter}");
        check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_LOCAL_LIGHTS", "VDB_SHADOWS", &filter]]);
    }
    check(&[&["VDB_LIT", "VDB_SURFACES", "DFG_LUT", "VDB_EVEN_LIGHT"]]);
    // Light probes.
    for with in subsets(&["VDB_FOGS", "VDB_REFLECTIONS", "VDB_LOCAL_LIGHTS"]) {
        let lit = ["VDB_LIT", "VDB_SURFACES"];
        let volumes = ["IRRADIANCE_VOLUME", "IRRADIANCE_VOLUMES_ARE_USABLE"];
        let arrays = ["MULTIPLE_LIGHT_PROBES_IN_ARRAY", "ENVIRONMENT_MAP"];
        check(&[&lit, &volumes, &with]);
        check(&[&lit, &volumes, &arrays[1..], &with]);
        check(&[&lit, &volumes, &arrays[..1], &with]);
        check(&[&lit, &arrays, &with]);
        check(&[&lit, &volumes, &arrays, &with]);
    }
    // Rectangle lights.
    for with in subsets(&["VDB_SURFACES", "VDB_REFLECTIONS", "VDB_LOCAL_LIGHTS"]) {
        let panes = ["VDB_LIT", "VDB_FOGS", "VDB_RECT_LIGHTS", "AREA_LIGHT_LUTS"];
        check(&[&panes, &with]);
        check(&[&panes, &["VDB_DIFFUSE_ONLY"], &with, &shadows]);
        let media = ["VDB_FOG_SLOTS=2", "VDB_EMITTER_SLOTS=1"];
        let cache = ["VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_OTHER_LIGHTS"];
        check(&[&panes, &cache, &media, &with, &shadows]);
    }
    // Surfaces that reflect the fire that lights them.
    for with in subsets(&["VDB_BLACKBODY", "VDB_MULTIPLE_SCATTERING", "VDB_DENOISE"]) {
        let fire = ["VDB_LIT", "VDB_SURFACES", "VDB_FOGS", "VDB_EMISSION", "VDB_REFLECTIONS"];
        check(&[&fire, &["VDB_LOCAL_LIGHTS", "VDB_FIRE_LIGHTS"], &with, &shadows]);
    }
    // Levels of detail within volumes.
    for with in subsets(&["VDB_SMOOTH", "VDB_BEAMS", "VDB_REFLECTIONS", "VDB_SMOOTH_NORMALS"]) {
        check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_LEVELS"], &with, &shadows]);
        check(&[&["VDB_SHOW_DEPTH", "VDB_SURFACES", "VDB_FOGS", "VDB_LEVELS"], &with]);
    }
    // Reflections of meshes.
    for with in subsets(&["VDB_FOGS", "VDB_EDGES", "MULTISAMPLED", "VDB_SCALED"]) {
        let mirrors = ["VDB_LIT", "VDB_SURFACES", "VDB_REFLECTIONS", "VDB_MESH_REFLECTIONS"];
        check(&[&mirrors, &with]);
    }
    // Many volumes, and suns with a size.
    for with in subsets(&["VDB_MANY", "VDB_SOFT_SUNS", "VDB_REFLECTIONS", "VDB_BEAMS"]) {
        check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS"], &with, &shadows]);
    }
    // Grids in pages, and samples of one format.
    for format in ["VDB_FORMAT=0", "VDB_FORMAT=1", "VDB_FORMAT=2"] {
        check(&[&["VDB_LIT", "VDB_SMOOTH", "VDB_FOGS", format], &shadows]);
        check(&[&["VDB_LIT", "VDB_FOGS", "VDB_FOG_STEPS", "VDB_EVEN_LIGHT", format]]);
        check(&[&["VDB_LIT", "VDB_SMOOTH", "VDB_SMOOTH_NORMALS", "VDB_EVEN_LIGHT", format]]);
    }
    check(&[
        &["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS", "VDB_PAGED", "VDB_PAGE_BITS=20"],
        &shadows,
    ]);
    // Smooth normals.
    for with in subsets(&["VDB_SURFACES", "VDB_FOGS", "VDB_REFLECTIONS", "VDB_WIDE_GRIDS"]) {
        check(&[&["VDB_LIT", "VDB_SMOOTH", "VDB_SMOOTH_NORMALS"], &with, &shadows]);
    }
    check(&[&["VDB_SHOW_NORMALS", "VDB_SMOOTH", "VDB_SMOOTH_NORMALS"]]);
    // Grids of many cells.
    for with in subsets(&["VDB_HDDA", "VDB_FOG_STEPS"]) {
        let wide = ["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS", "VDB_WIDE_GRIDS"];
        check(&[&wide, &with, &shadows]);
    }
    // The light cache.
    for kinds in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_EMISSION"]) {
        for with in subsets(&["VDB_MULTIPLE_SCATTERING", "VDB_MESH_CASTERS", "VDB_UNCACHED_FOGS"]) {
            for lights in [
                &["VDB_CACHED_SUNS=1", "VDB_FOG_SLOTS=1", "VDB_EMITTER_SLOTS=1"][..],
                &[
                    "VDB_CACHED_SUNS=4",
                    "VDB_FOG_SLOTS=2",
                    "VDB_EMITTER_SLOTS=2",
                    "VDB_OTHER_LIGHTS",
                ],
                &[
                    "VDB_CACHED_SUNS=1",
                    "VDB_FOG_SLOTS=8",
                    "VDB_EMITTER_SLOTS=8",
                    "VDB_CACHED_LAMPS",
                    "VDB_LOCAL_LIGHTS",
                ],
                &[
                    "VDB_CACHED_SUNS=0",
                    "VDB_FOG_SLOTS=1",
                    "VDB_EMITTER_SLOTS=1",
                    "VDB_OTHER_LIGHTS",
                    "VDB_LOCAL_LIGHTS",
                ],
                &[
                    "VDB_CACHED_SUNS=4",
                    "VDB_FOG_SLOTS=4",
                    "VDB_EMITTER_SLOTS=4",
                    "VDB_OTHER_LIGHTS",
                    "VDB_UNCACHED_LIGHTS",
                    "VDB_CACHED_LAMPS",
                    "VDB_LOCAL_LIGHTS",
                ],
            ] {
                let cache = ["VDB_LIT", "VDB_FOGS", "VDB_LIGHT_CACHE"];
                check(&[&cache, lights, &kinds, &with, &shadows]);
            }
        }
    }
    for media in
        [["VDB_FOG_SLOTS=1", "VDB_EMITTER_SLOTS=8"], ["VDB_FOG_SLOTS=8", "VDB_EMITTER_SLOTS=1"]]
    {
        let with =
            ["VDB_EMISSION", "VDB_MULTIPLE_SCATTERING", "VDB_UNCACHED_FOGS", "VDB_OTHER_LIGHTS"];
        for with in subsets(&with) {
            check(&[&SCATTERED_LIGHT, &media, &with]);
        }
    }
    // Colours in fog.
    for with in subsets(&["VDB_MULTIPLE_SCATTERING", "VDB_EMISSION", "VDB_REFLECTIONS"]) {
        let colors = ["VDB_LIT", "VDB_FOGS", "VDB_FOG_COLORS", "VDB_VARYING_ALBEDO"];
        check(&[&colors, &with]);
        check(&[&colors, &with, &shadows]);
        let media = ["VDB_FOG_SLOTS=2", "VDB_EMITTER_SLOTS=1"];
        let cache = ["VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_UNCACHED_FOGS"];
        check(&[&colors, &cache, &media, &with, &shadows]);
        check(&[&SCATTERED_LIGHT, &colors[2..], &media, &with]);
    }
    // Ramps.
    for with in subsets(&["VDB_MULTIPLE_SCATTERING", "VDB_EMISSION", "VDB_FOG_COLORS"]) {
        let ramps = ["VDB_LIT", "VDB_FOGS", "VDB_RAMPS", "VDB_VARYING_ALBEDO", "VDB_EMITS"];
        check(&[&ramps, &with]);
        check(&[&ramps, &with, &shadows]);
        let media = ["VDB_FOG_SLOTS=2", "VDB_EMITTER_SLOTS=1"];
        let cache = ["VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_UNCACHED_FOGS"];
        check(&[&ramps, &cache, &media, &with, &shadows]);
        check(&[&SCATTERED_LIGHT, &ramps[2..], &media, &with]);
    }
    check(&[&["VDB_COUNT_STEPS", "VDB_FOGS", "VDB_RAMPS", "VDB_VARYING_ALBEDO", "VDB_EMITS"]]);
    // Custom materials, on surfaces and in fog.
    for with in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_COLORS", "VDB_REFLECTIONS"]) {
        check(&[&["VDB_LIT", "VDB_MATERIALS", EVERYTHING_DEF], &with, &shadows]);
    }
    for with in
        subsets(&["VDB_FOG_STEPS", "VDB_MULTIPLE_SCATTERING", "VDB_FOG_COLORS", "VDB_RAMPS"])
    {
        let own = ["VDB_FOGS", "VDB_FOG_MATERIALS", "VDB_VARYING_ALBEDO", EVERYTHING_DEF];
        let emits = if with.contains(&"VDB_RAMPS") { &["VDB_EMITS"][..] } else { &[] };
        check(&[&["VDB_LIT"], &own, &with, emits]);
        check(&[&["VDB_LIT", "VDB_MATERIALS", "VDB_SMOOTH"], &own, &with, emits, &shadows]);
        let media = ["VDB_FOG_SLOTS=2", "VDB_EMITTER_SLOTS=1"];
        let cache = ["VDB_LIT", "VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_UNCACHED_FOGS"];
        check(&[&cache, &own, &media, &with, emits, &shadows]);
        check(&[&SCATTERED_LIGHT, &own, &media, &with, emits]);
    }
    check(&[&["VDB_COUNT_STEPS", "VDB_FOGS", "VDB_FOG_MATERIALS", EVERYTHING_DEF]]);
    // Fewer rays than pixels.
    for kinds in subsets(&["VDB_SURFACES", "VDB_FOGS", "MULTISAMPLED"]) {
        check(&[&["VDB_LIT", "VDB_SCALED", "VDB_LOCAL_LIGHTS", "DISTANCE_FOG"], &kinds, &shadows]);
        check(&[&["VDB_SHOW_DEPTH", "VDB_SCALED"], &kinds]);
    }
    // Temporal accumulation.
    for with in subsets(&["VDB_SCALED", "VDB_SOFT_SUNS", "VDB_REFLECTIONS", "VDB_BEAMS"]) {
        check(&[
            &["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS", "VDB_ACCUMULATED"],
            &with,
            &shadows,
        ]);
    }
    // Further rays through pixels on edges.
    for kinds in subsets(&["VDB_SMOOTH", "VDB_FOGS", "VDB_BEAMS", "MULTISAMPLED"]) {
        check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_EDGES"], &kinds, &shadows]);
    }
    // Modes, steps, lights, overlays, further grids and parts, for each set of kinds; and further
    // lights for the sets with fog.
    let kinds = 8 * (modes.len() * 8 + 3 + 2 * 16 + 1 + 2 * 6 + 2) + 4 * (2 * 16);
    // For each set of kinds and of further defs, the lights of the cache.
    let light_cache = 8 * 8 * 5 + 2 * 16;
    let (filters, many, formats, normals) = (2 + 1, 16, 3 * 3 + 1, 16 + 1);
    let (wide, scaled, accumulated, edges) = (4, 8 * 2, 16, 16);
    let (colors, ramps, probes) = (8 * 4, 8 * 4 + 1, 8 * 5);
    let materials = 16 + 16 * 4 + 1;
    let mirrors = 16;
    let (rectangles, fires, levels) = (8 * 3, 8, 16 * 2);
    let others = filters + many + formats + normals + wide + scaled + accumulated + edges;
    let others =
        others + colors + ramps + probes + materials + mirrors + rectangles + fires + levels;
    assert_eq!(variants, kinds + light_cache + others);
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
    for defs in subsets(&["VDB_ACCUMULATED"]) {
        check(&mut composer, "denoise/denoise", &[&["VDB_DENOISE"], &defs[..]].concat());
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
        check(&mut composer, "shadow_maps/cast", &kinds);
        let wide = [&kinds, &["VDB_WIDE_GRIDS"][..]].concat();
        check(&mut composer, "shadow_maps/cast", &wide);
        let cut = [&kinds, &["VDB_CLIP"][..]].concat();
        check(&mut composer, "shadow_maps/cast", &cut);
        if kinds.contains(&"VDB_FOGS") {
            for with in [&["VDB_RAMPS"][..], &["VDB_FOG_MATERIALS", EVERYTHING_DEF]] {
                check(&mut composer, "shadow_maps/cast", &[&kinds, with].concat());
            }
        }
        for format in ["VDB_FORMAT=0", "VDB_FORMAT=1", "VDB_FORMAT=2"] {
            let with = ["VDB_PAGED", "VDB_PAGE_BITS=20", format];
            check(&mut composer, "shadow_maps/cast", &[&kinds, &with[..]].concat());
        }
    }
    check(&mut composer, "shadow_maps/mesh_depth", &[]);
}
