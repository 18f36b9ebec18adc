//! The `.vdb` format, one file per part. OpenVDB's own source is its only specification.

mod buffers;
mod build;
mod cursor;
mod descriptor;
mod file;
mod header;
mod metadata;
mod topology;
mod transform;
mod value_types;
mod values;
mod write;

pub(crate) use file::read as read_file;
pub(crate) use header::WRITTEN_VERSION;
pub(crate) use write::{save as save_file, write as write_file};

/// Reads one part of a file and forgets it.
#[cfg(fuzzing)]
pub(crate) fn fuzz_head(which: u8, bytes: &[u8], limits: &crate::Limits) {
    let mut cursor = cursor::Cursor::new(bytes);
    match which % 4 {
        0 => drop(header::read(&mut cursor)),
        1 => drop(metadata::read(&mut cursor, limits)),
        2 => drop(descriptor::read(&mut cursor, limits)),
        _ => {
            let version = if bytes.len().is_multiple_of(2) { 224 } else { 218 };
            if let Ok(transform) = transform::read(&mut cursor, version, limits) {
                let p = transform.world_from_index(glam::DVec3::ONE);
                let _ = (transform.index_from_world(p), transform.linear());
            }
        }
    }
}
