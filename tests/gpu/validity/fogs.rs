//! Variants of the trace, for fog.

use super::{EVERYTHING_DEF, SCATTERED_LIGHT, SHADOWS, TWO_FOGS, Trace, subsets};

/// Checks `surfaces` with every kind of light in the cache, each with all sets of further defs.
fn check_light_cache(surfaces: &[&str]) {
    let mut trace = Trace::new();
    for kinds in subsets(&["VDB_SMOOTH", "VDB_EMISSION"]) {
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
                trace.check(&[&cache, lights, surfaces, &kinds, &with, &SHADOWS]);
            }
        }
    }
    assert_eq!(trace.variants, 4 * 8 * 5);
}

#[test]
#[ignore = "slow: hundreds of variants"]
fn fog_in_the_light_cache_is_valid() {
    check_light_cache(&[]);
}

#[test]
#[ignore = "slow: hundreds of variants"]
fn fog_in_the_light_cache_beside_surfaces_is_valid() {
    check_light_cache(&["VDB_SURFACES"]);
}

/// With many fogs or many fires.
#[test]
#[ignore = "slow: hundreds of variants"]
fn fog_with_interpolated_lamps_is_valid() {
    let mut trace = Trace::new();
    for media in
        [["VDB_FOG_SLOTS=1", "VDB_EMITTER_SLOTS=8"], ["VDB_FOG_SLOTS=8", "VDB_EMITTER_SLOTS=1"]]
    {
        let with = [
            "VDB_EMISSION",
            "VDB_MULTIPLE_SCATTERING",
            "VDB_UNCACHED_FOGS",
            "VDB_OTHER_LIGHTS",
            "VDB_MOTION_VECTORS",
        ];
        for with in subsets(&with) {
            trace.check(&[&SCATTERED_LIGHT, &media, &with]);
        }
    }
    assert_eq!(trace.variants, 2 * 32);
}

#[test]
#[ignore = "slow: hundreds of variants"]
fn coloured_fog_is_valid() {
    let mut trace = Trace::new();
    for with in subsets(&["VDB_MULTIPLE_SCATTERING", "VDB_EMISSION", "VDB_REFLECTIONS"]) {
        let colors = ["VDB_LIT", "VDB_FOGS", "VDB_FOG_COLORS", "VDB_VARYING_ALBEDO"];
        trace.check(&[&colors, &with]);
        trace.check(&[&colors, &with, &SHADOWS]);
        let cache = ["VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_UNCACHED_FOGS"];
        trace.check(&[&colors, &cache, &TWO_FOGS, &with, &SHADOWS]);
        trace.check(&[&SCATTERED_LIGHT, &colors[2..], &TWO_FOGS, &with]);
    }
    assert_eq!(trace.variants, 8 * 4);
}

#[test]
#[ignore = "slow: hundreds of variants"]
fn ramps_are_valid() {
    let mut trace = Trace::new();
    for with in subsets(&["VDB_MULTIPLE_SCATTERING", "VDB_EMISSION", "VDB_FOG_COLORS"]) {
        let ramps = ["VDB_LIT", "VDB_FOGS", "VDB_RAMPS", "VDB_VARYING_ALBEDO", "VDB_EMITS"];
        trace.check(&[&ramps, &with]);
        trace.check(&[&ramps, &with, &SHADOWS]);
        let cache = ["VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_UNCACHED_FOGS"];
        trace.check(&[&ramps, &cache, &TWO_FOGS, &with, &SHADOWS]);
        trace.check(&[&SCATTERED_LIGHT, &ramps[2..], &TWO_FOGS, &with]);
        let single = ["VDB_FOG_SLOTS=1", "VDB_EMITTER_SLOTS=1"];
        trace.check(&[&ramps, &cache[..2], &single, &with, &SHADOWS]);
    }
    trace.check(&[&[
        "VDB_COUNT_STEPS",
        "VDB_FOGS",
        "VDB_RAMPS",
        "VDB_VARYING_ALBEDO",
        "VDB_EMITS",
    ]]);
    assert_eq!(trace.variants, 8 * 5 + 1);
}

/// On surfaces and in fog.
#[test]
#[ignore = "slow: hundreds of variants"]
fn custom_materials_are_valid() {
    let mut trace = Trace::new();
    for with in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_COLORS", "VDB_REFLECTIONS"]) {
        trace.check(&[&["VDB_LIT", "VDB_MATERIALS", EVERYTHING_DEF], &with, &SHADOWS]);
    }
    for with in
        subsets(&["VDB_FOG_STEPS", "VDB_MULTIPLE_SCATTERING", "VDB_FOG_COLORS", "VDB_RAMPS"])
    {
        let own = ["VDB_FOGS", "VDB_FOG_MATERIALS", "VDB_VARYING_ALBEDO", EVERYTHING_DEF];
        let emits = if with.contains(&"VDB_RAMPS") { &["VDB_EMITS"][..] } else { &[] };
        trace.check(&[&["VDB_LIT"], &own, &with, emits]);
        trace.check(&[&["VDB_LIT", "VDB_MATERIALS", "VDB_SMOOTH"], &own, &with, emits, &SHADOWS]);
        let cache = ["VDB_LIT", "VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_UNCACHED_FOGS"];
        trace.check(&[&cache, &own, &TWO_FOGS, &with, emits, &SHADOWS]);
        trace.check(&[&SCATTERED_LIGHT, &own, &TWO_FOGS, &with, emits]);
    }
    trace.check(&[&["VDB_COUNT_STEPS", "VDB_FOGS", "VDB_FOG_MATERIALS", EVERYTHING_DEF]]);
    assert_eq!(trace.variants, 16 + 16 * 4 + 1);
}
