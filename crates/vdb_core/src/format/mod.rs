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
mod values;

pub(crate) use file::read as read_file;
