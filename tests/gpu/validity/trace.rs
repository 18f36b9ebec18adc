//! Variants of the trace, for surfaces and for all kinds of volumes.

use super::{SHADOWS, TWO_FOGS, Trace, subsets, unlit_modes};

/// Modes and steps, for each set of kinds of volumes.
#[test]
#[ignore = "slow: hundreds of variants"]
fn views_without_light_are_valid() {
    let mut trace = Trace::new();
    let modes = unlit_modes();
    for kinds in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS"]) {
        for mode in &modes {
            for with in subsets(&["VDB_BEAMS", "VDB_OVERLAYS", "VDB_MOTION_VECTORS"]) {
                trace.check(&[&kinds, &[mode], &with]);
            }
        }
        for dda in [
            vec!["VDB_COUNT_STEPS"],
            vec!["VDB_COUNT_STEPS", "VDB_HDDA"],
            vec!["VDB_COUNT_STEPS", "VDB_DDA", "VDB_MARCH"],
        ] {
            trace.check(&[&kinds, &dda]);
        }
    }
    assert_eq!(trace.variants, 8 * (modes.len() * 8 + 3));
}

#[test]
#[ignore = "slow: hundreds of variants"]
fn lit_views_are_valid() {
    let mut trace = Trace::new();
    for kinds in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS"]) {
        for lights in
            subsets(&["VDB_LOCAL_LIGHTS", "ENVIRONMENT_MAP", "VDB_REFLECTIONS", "DISTANCE_FOG"])
        {
            let even =
                if lights.contains(&"VDB_LOCAL_LIGHTS") { &[][..] } else { &["VDB_EVEN_LIGHT"] };
            trace.check(&[&["VDB_LIT"], &kinds, &lights, even]);
            trace.check(&[&["VDB_LIT", "VDB_MOTION_VECTORS"], &kinds, &lights, &SHADOWS]);
            if kinds.contains(&"VDB_FOGS") {
                trace.check(&[&["VDB_LIT", "VDB_MULTIPLE_SCATTERING"], &kinds, &lights, even]);
                trace.check(&[&["VDB_LIT", "VDB_MULTIPLE_SCATTERING"], &kinds, &lights, &SHADOWS]);
            }
        }
        trace.check(&[
            &["VDB_LIT", "VDB_LOCAL_LIGHTS", "VDB_OVERLAYS", "MULTISAMPLED", "VDB_BEAMS"],
            &kinds,
            &SHADOWS,
        ]);
    }
    assert_eq!(trace.variants, 8 * (2 * 16 + 1) + 4 * (2 * 16));
}

/// Emission and colours; diffuse and glossy light apart.
#[test]
#[ignore = "slow: hundreds of variants"]
fn further_grids_are_valid() {
    let mut trace = Trace::new();
    for kinds in subsets(&["VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS"]) {
        for extras in subsets(&["VDB_EMISSION", "VDB_BLACKBODY", "VDB_COLORS"]) {
            if extras.contains(&"VDB_BLACKBODY") && !extras.contains(&"VDB_EMISSION") {
                continue;
            }
            trace.check(&[&["VDB_LIT", "VDB_EVEN_LIGHT"], &kinds, &extras]);
            trace.check(&[
                &["VDB_LIT", "VDB_LOCAL_LIGHTS", "DISTANCE_FOG", "VDB_REFLECTIONS"],
                &kinds,
                &extras,
                &SHADOWS,
            ]);
        }
        for part in ["VDB_DIFFUSE_ONLY", "VDB_GLOSSY_ONLY"] {
            trace.check(&[
                &["VDB_LIT", "VDB_LOCAL_LIGHTS", "ENVIRONMENT_MAP", "MULTISAMPLED", part],
                &kinds,
            ]);
        }
    }
    assert_eq!(trace.variants, 8 * (2 * 6 + 2));
}

#[test]
#[ignore = "slow: hundreds of variants"]
fn lights_of_all_kinds_are_valid() {
    let mut trace = Trace::new();
    for filter in ["HARDWARE_2X2", "TEMPORAL"] {
        let filter = format!("SHADOW_FILTER_METHOD_{filter}");
        trace.check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_LOCAL_LIGHTS", "VDB_SHADOWS", &filter]]);
    }
    trace.check(&[&["VDB_LIT", "VDB_SURFACES", "DFG_LUT", "VDB_EVEN_LIGHT"]]);
    // Light probes.
    for with in subsets(&["VDB_FOGS", "VDB_REFLECTIONS", "VDB_LOCAL_LIGHTS"]) {
        let lit = ["VDB_LIT", "VDB_SURFACES"];
        let volumes = ["IRRADIANCE_VOLUME", "IRRADIANCE_VOLUMES_ARE_USABLE"];
        let arrays = ["MULTIPLE_LIGHT_PROBES_IN_ARRAY", "ENVIRONMENT_MAP"];
        trace.check(&[&lit, &volumes, &with]);
        trace.check(&[&lit, &volumes, &arrays[1..], &with]);
        trace.check(&[&lit, &volumes, &arrays[..1], &with]);
        trace.check(&[&lit, &arrays, &with]);
        trace.check(&[&lit, &volumes, &arrays, &with]);
    }
    // Rectangle lights.
    for with in subsets(&["VDB_SURFACES", "VDB_REFLECTIONS", "VDB_LOCAL_LIGHTS"]) {
        let panes = ["VDB_LIT", "VDB_FOGS", "VDB_RECT_LIGHTS", "AREA_LIGHT_LUTS"];
        trace.check(&[&panes, &with]);
        trace.check(&[&panes, &["VDB_DIFFUSE_ONLY"], &with, &SHADOWS]);
        let cache = ["VDB_LIGHT_CACHE", "VDB_CACHED_SUNS=1", "VDB_OTHER_LIGHTS"];
        trace.check(&[&panes, &cache, &TWO_FOGS, &with, &SHADOWS]);
    }
    // Surfaces that reflect the fire that lights them.
    for with in subsets(&["VDB_BLACKBODY", "VDB_MULTIPLE_SCATTERING", "VDB_DENOISE"]) {
        let fire = ["VDB_LIT", "VDB_SURFACES", "VDB_FOGS", "VDB_EMISSION", "VDB_REFLECTIONS"];
        trace.check(&[&fire, &["VDB_LOCAL_LIGHTS", "VDB_FIRE_LIGHTS"], &with, &SHADOWS]);
    }
    assert_eq!(trace.variants, (2 + 1) + 8 * 5 + 8 * 3 + 8);
}

#[test]
#[ignore = "slow: hundreds of variants"]
fn levels_pages_and_many_volumes_are_valid() {
    let mut trace = Trace::new();
    // Levels of detail within volumes.
    for with in subsets(&["VDB_SMOOTH", "VDB_BEAMS", "VDB_REFLECTIONS", "VDB_SMOOTH_NORMALS"]) {
        trace.check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_LEVELS"], &with, &SHADOWS]);
        trace.check(&[&["VDB_SHOW_DEPTH", "VDB_SURFACES", "VDB_FOGS", "VDB_LEVELS"], &with]);
    }
    // Many volumes, and suns with a size.
    for with in subsets(&["VDB_MANY", "VDB_SOFT_SUNS", "VDB_REFLECTIONS", "VDB_BEAMS"]) {
        trace.check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS"], &with, &SHADOWS]);
    }
    // Grids in pages, and samples of one format.
    for format in ["VDB_FORMAT=0", "VDB_FORMAT=1", "VDB_FORMAT=2"] {
        trace.check(&[&["VDB_LIT", "VDB_SMOOTH", "VDB_FOGS", format], &SHADOWS]);
        trace.check(&[&["VDB_LIT", "VDB_FOGS", "VDB_FOG_STEPS", "VDB_EVEN_LIGHT", format]]);
        trace.check(&[&["VDB_LIT", "VDB_SMOOTH", "VDB_SMOOTH_NORMALS", "VDB_EVEN_LIGHT", format]]);
    }
    trace.check(&[
        &["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS", "VDB_PAGED", "VDB_PAGE_BITS=20"],
        &SHADOWS,
    ]);
    // Grids of many cells.
    for with in subsets(&["VDB_HDDA", "VDB_FOG_STEPS"]) {
        let wide = ["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS", "VDB_WIDE_GRIDS"];
        trace.check(&[&wide, &with, &SHADOWS]);
    }
    assert_eq!(trace.variants, 16 * 2 + 16 + (3 * 3 + 1) + 4);
}

/// Normals, reflections, further rays, fewer rays, and means of frames.
#[test]
#[ignore = "slow: hundreds of variants"]
fn normals_reflections_and_kinds_of_rays_are_valid() {
    let mut trace = Trace::new();
    // Smooth normals.
    for with in subsets(&["VDB_SURFACES", "VDB_FOGS", "VDB_REFLECTIONS", "VDB_WIDE_GRIDS"]) {
        trace.check(&[&["VDB_LIT", "VDB_SMOOTH", "VDB_SMOOTH_NORMALS"], &with, &SHADOWS]);
    }
    trace.check(&[&["VDB_SHOW_NORMALS", "VDB_SMOOTH", "VDB_SMOOTH_NORMALS"]]);
    // Reflections of meshes.
    for with in subsets(&["VDB_FOGS", "VDB_EDGES", "MULTISAMPLED", "VDB_SCALED"]) {
        let mirrors = ["VDB_LIT", "VDB_SURFACES", "VDB_REFLECTIONS", "VDB_MESH_REFLECTIONS"];
        trace.check(&[&mirrors, &with]);
    }
    // Fewer rays than pixels.
    for kinds in subsets(&["VDB_SURFACES", "VDB_FOGS", "MULTISAMPLED"]) {
        trace.check(&[
            &["VDB_LIT", "VDB_SCALED", "VDB_LOCAL_LIGHTS", "DISTANCE_FOG"],
            &kinds,
            &SHADOWS,
        ]);
        trace.check(&[&["VDB_SHOW_DEPTH", "VDB_SCALED"], &kinds]);
    }
    // Temporal accumulation.
    for with in subsets(&["VDB_SCALED", "VDB_SOFT_SUNS", "VDB_REFLECTIONS", "VDB_BEAMS"]) {
        trace.check(&[
            &["VDB_LIT", "VDB_SURFACES", "VDB_SMOOTH", "VDB_FOGS", "VDB_ACCUMULATED"],
            &with,
            &SHADOWS,
        ]);
    }
    // Further rays through pixels on edges.
    for kinds in subsets(&["VDB_SMOOTH", "VDB_FOGS", "VDB_BEAMS", "MULTISAMPLED"]) {
        trace.check(&[&["VDB_LIT", "VDB_SURFACES", "VDB_EDGES"], &kinds, &SHADOWS]);
    }
    assert_eq!(trace.variants, (16 + 1) + 16 + 8 * 2 + 16 + 16);
}
