//! The `.vdb` file format, one module per part. OpenVDB's source is its only specification.

pub(crate) mod budget;
mod buffer;
mod buffers;
pub(crate) mod build;
pub(crate) mod cursor;
mod demand;
pub(crate) mod descriptor;
pub(crate) mod file;
mod header;
pub(crate) mod list;
pub(crate) mod masks;
pub(crate) mod metadata;
pub(crate) mod open;
mod points;
pub(crate) mod save;
pub(crate) mod streamed;
pub(crate) mod topology;
pub(crate) mod transform;
pub(crate) mod value_types;
mod values;
mod vdb_file;
mod write;

pub use buffer::FileBuffer;
pub use save::save_bytes;

/// Reads one part of a file, for fuzzing.
#[cfg(fuzzing)]
pub(crate) fn fuzz_head(which: u8, bytes: &[u8], limits: &crate::Limits) {
    let (mut cursor, mut budget) = (cursor::Cursor::new(bytes), budget::Budget::new(limits));
    match which % 4 {
        0 => drop(header::read(&mut cursor)),
        1 => drop(metadata::read(&mut cursor, &mut budget)),
        2 => drop(descriptor::read(&mut cursor, &mut budget)),
        _ => {
            let version = if bytes.len().is_multiple_of(2) { 224 } else { 218 };
            if let Ok(transform) = transform::read(&mut cursor, version, limits) {
                let p = transform.world_from_index(glam::DVec3::ONE);
                let _ = (transform.index_from_world(p), transform.linear());
            }
        }
    }
}
