//! Every variant of every shader passes naga's validator.

use naga::valid::{Capabilities, ValidationFlags, Validator};

use vdb_probe::compose;

#[test]
fn every_variant_of_the_trace_is_valid() {
    let trace = include_str!("../../assets/shaders/trace.wgsl");
    let modes = ["", "SHOW_NORMALS", "SHOW_DEPTH", "COUNT_STEPS", "DDA", "HDDA", "MARCH"];
    let mut variants = 0;
    for bits in 0..32 {
        for mode in modes {
            let all =
                [(1, "MULTISAMPLED"), (2, "SURFACES"), (4, "FOGS"), (8, "SMOOTH"), (16, "BEAMS")];
            let mut defs: Vec<&str> =
                all.iter().filter(|(bit, _)| bits & bit != 0).map(|(_, def)| *def).collect();
            defs.extend(Some(mode).filter(|mode| !mode.is_empty()));
            let module = compose(trace, &defs);
            Validator::new(ValidationFlags::all(), Capabilities::all())
                .validate(&module)
                .unwrap_or_else(|error| panic!("with {defs:?}: {}", error.emit_to_string(trace)));
            variants += 1;
        }
    }
    assert_eq!(variants, 32 * 7);
}

#[test]
fn the_beams_are_valid() {
    let beams = include_str!("../../assets/shaders/beams.wgsl");
    let module = compose(beams, &[]);
    Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string(beams)));
}
