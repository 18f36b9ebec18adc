//! Seed inputs for fuzzing, generated without files.

use std::path::Path;

use arbitrary::Unstructured;
use vdb_core::WriteOptions;
use vdb_core::synth::Random;

use super::generate;

/// Writes inputs for `tree` and `mutant`, and the files generated from them, if they are small, for
/// `file`, into folders of these names.
///
/// # Errors
/// Errors of the operating system.
pub fn write_seeds(folder: &Path, count: u64) -> std::io::Result<()> {
    let folders = ["tree", "mutant", "file"].map(|name| folder.join(name));
    for folder in &folders {
        std::fs::create_dir_all(folder)?;
    }
    for number in 0..count {
        let mut random = Random::new(number);
        let length = 1 << (4 + random.below(6));
        let bytes: Vec<u8> = (0..length).map(|_| random.bits() as u8).collect();
        for folder in &folders[..2] {
            std::fs::write(folder.join(format!("seed-{number}")), &bytes)?;
        }
        let file = generate::file(&mut Unstructured::new(&bytes)).ok();
        let written = file.and_then(|file| file.write(&WriteOptions::default()).ok());
        if let Some(written) = written.filter(|written| written.len() < 1 << 15) {
            std::fs::write(folders[2].join(format!("seed-{number}.vdb")), written)?;
        }
    }
    Ok(())
}
