//! NanoVDB files: what is written comes back, and damage leads to an error or to a sound tree.

use arbitrary::{Result, Unstructured};
use vdb_core::{AnyTree, Codec, NanoVdbOptions, NanoVdbValues, ReadOptions, VdbFile};

use super::{TREE_BYTES, damage, file, generate, limits, tree_bytes};

/// Runs trees generated from the bytes, written as a NanoVDB file and damaged.
pub fn nanovdb(bytes: &[u8]) {
    let mut choices = Unstructured::new(bytes);
    let Ok(mut generated) = generate::file(&mut choices) else { return };
    generated.grids.retain(|grid| matches!(grid.tree, AnyTree::Float(_)));
    if generated.grids.is_empty() || tree_bytes(&generated) > TREE_BYTES {
        return;
    }
    let Ok(options) = options(&mut choices) else { return };
    // What cannot be quantised, and maps without a matrix, are refused.
    let Ok(mut written) = generated.write_nanovdb(&options) else { return };
    if options.values == NanoVdbValues::Float {
        check(&generated, &written);
    }
    if harm(&mut written, &mut choices).is_ok() {
        file(&written);
    }
}

fn options(choices: &mut Unstructured) -> Result<NanoVdbOptions> {
    let values = [NanoVdbValues::Float, NanoVdbValues::Fp8, NanoVdbValues::Fp16];
    // Mostly what can be damaged in every place.
    let codecs = [Codec::None, Codec::None, Codec::None, Codec::Zip, Codec::Blosc];
    Ok(NanoVdbOptions { values: *choices.choose(&values)?, codec: *choices.choose(&codecs)? })
}

/// Whether floats come back, value by value and with their states.
fn check(generated: &VdbFile, written: &[u8]) {
    let mut options = ReadOptions { limits: limits(), ..ReadOptions::default() };
    // A packed grid is counted beside the trees.
    options.limits.tree_bytes = 64 << 20;
    let again = VdbFile::read(written, &options)
        .unwrap_or_else(|error| panic!("what was written is refused: {error}"));
    assert_eq!(generated.grids.len(), again.grids.len());
    for (own, grid) in generated.grids.iter().zip(&again.grids) {
        let (AnyTree::Float(own), AnyTree::Float(tree)) = (&own.tree, &grid.tree) else {
            panic!("{} became {}", own.type_name, grid.type_name);
        };
        assert_eq!(own.background().to_bits(), tree.background().to_bits());
        assert_eq!(own.stats().levels, tree.stats().levels);
        for (a, b) in own.values().zip(tree.values()) {
            let parts = |v: &vdb_core::tree::ValueAt<f32>| (v.origin, v.log2_dim, v.active);
            assert_eq!((parts(&a), a.value.to_bits()), (parts(&b), b.value.to_bits()));
        }
    }
}

/// Damages a few words that are not zero, as most of a file is.
fn harm(bytes: &mut Vec<u8>, choices: &mut Unstructured) -> Result<()> {
    let words = bytes.len() / 4;
    for _ in 0..choices.int_in_range(1..=4)? {
        let mut word = choices.int_in_range(0..=words.saturating_sub(1))?;
        // Within the next few, if there is one.
        for _ in 0..4096 {
            if word + 2 >= words || bytes[word * 4..word * 4 + 4] != [0; 4] {
                break;
            }
            word += 1;
        }
        let at = word * 4;
        let length = 1 << choices.int_in_range(0..=3)?;
        let Some(place) = bytes.get_mut(at..at + length) else { continue };
        let mut old = [0; 8];
        old[..length].copy_from_slice(place);
        let new = damage::nasty(choices, u64::from_le_bytes(old))?;
        place.copy_from_slice(&new.to_le_bytes()[..length]);
    }
    damage::damage(bytes, choices)
}
