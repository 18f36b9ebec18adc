//! Cooked files: what is written comes back, and nothing that is read leads out of the words.

use arbitrary::{Result, Unstructured};
use vdb_core::cooked::{CookOptions, CookedFile};
use vdb_core::pack::{PackKind, ValueFormat};
use vdb_core::synth::Random;
use vdb_core::{ReadOptions, VdbFile};

use super::{TREE_BYTES, damage, generate, limits, rays, seed, tree_bytes};

/// The extent in cells beyond which no rays are traced: they end, but not soon.
const LARGEST: u64 = 1 << 12;

/// Runs a cooked file given by its bytes, or one made of trees generated from them and damaged.
pub fn cooked(bytes: &[u8]) {
    if CookedFile::is_cooked(bytes) {
        return read(bytes.to_vec(), seed(bytes));
    }
    let mut choices = Unstructured::new(bytes);
    if let Ok(file) = generate::file(&mut choices)
        && tree_bytes(&file) <= TREE_BYTES
        && let Ok(options) = options(&mut choices)
    {
        generated(&file, &options, &mut choices, seed(bytes));
    }
}

fn read_options() -> ReadOptions {
    ReadOptions { limits: limits(), ..ReadOptions::default() }
}

fn options(choices: &mut Unstructured) -> Result<CookOptions> {
    let formats = [ValueFormat::Exact, ValueFormat::Full, ValueFormat::Half, ValueFormat::Byte];
    let iso = *choices.choose(&[0.0, 0.5, -1.0])?;
    let kinds = [
        None,
        Some(PackKind::Fog),
        Some(PackKind::Smooth { iso }),
        Some(PackKind::Surface { iso }),
    ];
    Ok(CookOptions {
        format: *choices.choose(&formats)?,
        kind: *choices.choose(&kinds)?,
        limits: limits(),
        ..CookOptions::default()
    })
}

fn generated(file: &VdbFile, options: &CookOptions, choices: &mut Unstructured, seed: u64) {
    let Ok(cooked) = CookedFile::cook(file, options) else { return };
    let Ok(mut written) = cooked.write() else { return };
    let again = CookedFile::read(&written, &read_options());
    let again = again.unwrap_or_else(|error| panic!("what was written is refused: {error}"));
    for (again, cooked) in again.grids.iter().zip(&cooked.grids) {
        assert_eq!(again.packed.header(0), cooked.packed.header(0));
        assert!(again.packed.words == cooked.packed.words, "the words differ");
    }
    if damage::damage(&mut written, choices).is_ok() {
        read(written, seed);
    }
}

/// Reads bytes after correcting their checksum, and traces rays through the grids.
fn read(mut bytes: Vec<u8>, seed: u64) {
    let Some((head, rest)) = bytes.split_first_chunk_mut::<16>() else { return };
    head[12..].copy_from_slice(&vdb_core::cooked::checksum(rest).to_le_bytes());
    let Ok(file) = CookedFile::read(&bytes, &read_options()) else { return };
    let mut random = Random::new(seed);
    for grid in &file.grids {
        let extent =
            grid.packed.occupied.map_or(0, |cells| cells.dim().into_iter().max().unwrap_or(0));
        if extent <= LARGEST {
            rays::dda(&grid.packed, &mut random);
            rays::check_packed(&grid.packed, &mut random);
        }
    }
}
