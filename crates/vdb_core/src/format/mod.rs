//! The `.vdb` format, one file per part. OpenVDB's own source is its only specification.

mod buffer;
mod buffers;
mod build;
mod cursor;
mod demand;
mod descriptor;
mod file;
mod header;
mod metadata;
mod open;
mod save;
mod topology;
mod transform;
mod value_types;
mod values;
mod write;

pub use buffer::FileBuffer;
pub(crate) use file::read as read_file;
pub(crate) use header::WRITTEN_VERSION;
pub(crate) use open::open as open_file;
pub(crate) use save::save as save_file;
pub(crate) use write::write as write_file;

/// Reads one part of a file and forgets it.
#[cfg(fuzzing)]
pub(crate) fn fuzz_head(which: u8, bytes: &[u8], limits: &crate::Limits) {
    let (mut cursor, mut budget) = (cursor::Cursor::new(bytes), topology::Budget::new(limits));
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
