//! Whole files: one segment with all grids.

use std::io::Write;

use flate2::write::ZlibEncoder;
use glam::{DAffine3, DVec3};
use rayon::prelude::*;

use super::buffer::{put, put_all};
use super::nodes::Plan;
use super::statistics::Statistics;
use crate::codec::blosc;
use crate::nanovdb::checksum::{self, crc};
use crate::nanovdb::container::{HEADER_BYTES, MAJOR, META_BYTES};
use crate::nanovdb::head::Kind;
use crate::nanovdb::layout::{BLIND_BYTES, NAME_BYTES, grid};
use crate::nanovdb::options::{NanoVdbOptions, NanoVdbValues};
use crate::transform::Affine;
use crate::tree::CoordBox;
use crate::{AnyTree, Codec, Error, Grid, GridClass, VdbFile};

/// The magic number of files and of grids, which all versions read.
const MAGIC: &[u8; 8] = b"NanoVDB0";
/// The version that is written, 32.4.2: that of Debian's tools.
const VERSION: u32 = MAJOR << 21 | 4 << 10 | 2;

/// Flags of grids.
mod flag {
    pub const LONG_NAME: u32 = 1;
    pub const BBOX: u32 = 2;
    /// Minimum, maximum, average and standard deviation.
    pub const STATISTICS: u32 = 4 | 8 | 16;
    pub const BREADTH_FIRST: u32 = 32;
}

/// The class of blind data that is a grid's name.
const GRID_NAME: u32 = 3;

/// Bytes of a Blosc frame at most, and of a block in it, as NanoVDB writes them.
const FRAME_BYTES: usize = 1 << 30;
const BLOCK_BYTES: usize = 1 << 18;

/// A grid that is ready to be written.
struct Written {
    meta: [u8; META_BYTES],
    /// The name, with a zero at its end.
    name: Vec<u8>,
    bytes: Vec<u8>,
}

/// Serialises a file.
pub(crate) fn write(file: &VdbFile, options: &NanoVdbOptions) -> Result<Vec<u8>, Error> {
    let count = u16::try_from(file.grids.len()).map_err(|_| {
        let what = format!("{} grids in one NanoVDB file, of at most 65,535", file.grids.len());
        Error::not_supported(what)
    })?;
    let mut out = Vec::with_capacity(HEADER_BYTES);
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    out.extend(count.to_le_bytes());
    out.extend(codec(options.codec).to_le_bytes());
    let mut grids = Vec::new();
    for grid in &file.grids {
        let written = write_grid(grid, options);
        grids.push(written.map_err(|error| error.in_grid(&grid.unique_name))?);
    }
    for grid in &grids {
        out.extend(grid.meta);
        out.extend(&grid.name);
    }
    for grid in grids {
        out.extend(grid.bytes);
    }
    Ok(out)
}

fn codec(codec: Codec) -> u16 {
    match codec {
        Codec::None => 0,
        Codec::Zip => 1,
        Codec::Blosc => 2,
    }
}

fn write_grid(source: &Grid, options: &NanoVdbOptions) -> Result<Written, Error> {
    let AnyTree::Float(tree) = &source.tree else {
        return Err(Error::not_supported(format!(
            "NanoVDB files are written of float grids alone, and this one has {}",
            source.tree.type_name()
        )));
    };
    let Some(map) = source.transform.linear() else {
        let what = "NanoVDB has no frustums; save the grid with a linear transform";
        return Err(Error::not_supported(what));
    };
    // A NanoVDB file has a matrix, whatever kind of map the grid has.
    if Affine::from_linear(map).is_none() {
        let what =
            "a map whose matrix has no inverse in f64, such as a scale of 1e-200; scale the grid";
        return Err(Error::not_supported(what));
    }
    if source.name.as_bytes().contains(&0) {
        return Err(Error::not_supported("a name with the character U+0000; rename the grid"));
    }
    let plan = Plan::new(tree, options.values);
    let blind = long_name(&source.name);
    let mut bytes = vec![0; plan.bytes()];
    let statistics = plan.write(&mut bytes)?;
    let nodes_end = bytes.len();
    bytes.extend(&blind);
    let name = [source.name.as_bytes(), &[0]].concat();
    let class = match source.class {
        GridClass::Unknown => 0_u32,
        GridClass::LevelSet => 1,
        GridClass::FogVolume => 2,
        GridClass::Staggered => 3,
    };
    let kind = match options.values {
        NanoVdbValues::Float => Kind::FLOAT,
        NanoVdbValues::Fp8 => Kind::FP8,
        NanoVdbValues::Fp16 => Kind::FP16,
    };
    head(&mut bytes, source, map, &statistics);
    put(&mut bytes, grid::CLASS, class.to_le_bytes());
    put(&mut bytes, grid::TYPE, kind.0.to_le_bytes());
    if !blind.is_empty() {
        put(&mut bytes, grid::BLIND_OFFSET, (nodes_end as u64).to_le_bytes());
        put(&mut bytes, grid::BLIND_COUNT, 1_u32.to_le_bytes());
    }
    // Of the head alone: the nodes' checksums differ among versions and platforms.
    let sum = crc(&bytes[grid::VERSION..plan.head_bytes()]);
    put_all(&mut bytes, grid::CHECKSUM, [sum, checksum::MISSING].map(u32::to_le_bytes));
    let meta = metadata(&bytes, &plan, &statistics, &name, tree.active_voxel_count(), options);
    let mut written = Written { meta, name, bytes: pack(bytes, options.codec)? };
    put(&mut written.meta, 8, (written.bytes.len() as u64).to_le_bytes());
    Ok(written)
}

/// Blind data with a name that is too long for the head; otherwise nothing.
fn long_name(name: &str) -> Vec<u8> {
    if name.len() < NAME_BYTES {
        return Vec::new();
    }
    let mut out = vec![0; (BLIND_BYTES + name.len() + 1).next_multiple_of(32)];
    put(&mut out, 0, (BLIND_BYTES as u64).to_le_bytes());
    put(&mut out, 8, (name.len() as u64 + 1).to_le_bytes());
    put(&mut out, 16, 1_u32.to_le_bytes());
    put(&mut out, 24, GRID_NAME.to_le_bytes());
    out[BLIND_BYTES..][..name.len()].copy_from_slice(name.as_bytes());
    out
}

/// Fills in the head, except for what depends on the kind of grid, and the checksum.
fn head(out: &mut [u8], source: &Grid, map: DAffine3, statistics: &Statistics) {
    let mut flags = flag::BREADTH_FIRST | flag::STATISTICS;
    let name = source.name.as_bytes();
    if name.len() >= NAME_BYTES {
        flags |= flag::LONG_NAME;
    }
    if statistics.bbox.is_some() {
        flags |= flag::BBOX;
    }
    out[..8].copy_from_slice(MAGIC);
    put(out, grid::VERSION, VERSION.to_le_bytes());
    put(out, grid::FLAGS, flags.to_le_bytes());
    put(out, grid::COUNT, 1_u32.to_le_bytes());
    let size = out.len() as u64;
    put(out, grid::SIZE, size.to_le_bytes());
    let length = name.len().min(NAME_BYTES - 1);
    out[grid::NAME..][..length].copy_from_slice(&name[..length]);
    let inverse = map.matrix3.inverse();
    // Rows of matrices for column vectors.
    let rows = |matrix: glam::DMat3| matrix.transpose().to_cols_array();
    let doubles = [&rows(map.matrix3)[..], &rows(inverse), &map.translation.to_array(), &[1.0]];
    let doubles = doubles.concat();
    let floats = doubles.iter().map(|number| (*number as f32).to_le_bytes());
    put_all(out, grid::MAP, floats);
    put_all(out, grid::MATRIX, doubles.iter().map(|number| number.to_le_bytes()));
    put_all(out, grid::VOXEL_SIZE, source.transform.voxel_size().to_array().map(f64::to_le_bytes));
    let corners = world_box(map, statistics.bbox);
    put_all(
        out,
        grid::WORLD_BBOX,
        corners.into_iter().flat_map(|c| c.to_array()).map(f64::to_le_bytes),
    );
}

/// The corners of the box of active voxels, each a cube from its index to the next.
fn world_box(map: DAffine3, bbox: Option<CoordBox>) -> [DVec3; 2] {
    let Some(bbox) = bbox else { return [DVec3::MAX, DVec3::MIN] };
    let (low, high) = (bbox.min.as_dvec3(), bbox.max.as_dvec3() + DVec3::ONE);
    let corners = (0..8).map(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 1 { high[axis] } else { low[axis] };
        map.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
    });
    corners.fold([DVec3::MAX, DVec3::MIN], |[low, high], p| [low.min(p), high.max(p)])
}

/// What a segment says of a grid.
fn metadata(
    bytes: &[u8],
    plan: &Plan<'_>,
    statistics: &Statistics,
    name: &[u8],
    voxels: u64,
    options: &NanoVdbOptions,
) -> [u8; META_BYTES] {
    let mut meta = [0; META_BYTES];
    put(&mut meta, 0, (bytes.len() as u64).to_le_bytes());
    put(&mut meta, 16, name_key(name).to_le_bytes());
    put(&mut meta, 24, voxels.to_le_bytes());
    // Type and class, which stand the other way round in the head.
    meta[32..36].copy_from_slice(&bytes[grid::TYPE..][..4]);
    meta[36..40].copy_from_slice(&bytes[grid::CLASS..][..4]);
    meta[40..88].copy_from_slice(&bytes[grid::WORLD_BBOX..][..48]);
    super::buffer::put_bbox(&mut meta, 88, statistics.bbox);
    meta[112..136].copy_from_slice(&bytes[grid::VOXEL_SIZE..][..24]);
    let [leaves, lowers, uppers] = plan.node_counts();
    let counts = [name.len(), leaves, lowers, uppers, 1].into_iter().chain(plan.tile_counts());
    put_all(&mut meta, 136, counts.map(|count| (count as u32).to_le_bytes()));
    put(&mut meta, 168, codec(options.codec).to_le_bytes());
    put(&mut meta, 172, VERSION.to_le_bytes());
    meta
}

/// The hash of a name, without the zero at its end, by which NanoVDB looks grids up.
fn name_key(name: &[u8]) -> u64 {
    name[..name.len() - 1].iter().fold(0, |hash: u64, byte| {
        hash.wrapping_mul(67).wrapping_add(u64::from(*byte) + (hash >> 56))
    })
}

/// Packs a grid.
fn pack(bytes: Vec<u8>, codec: Codec) -> Result<Vec<u8>, Error> {
    let framed = |frame: &[u8]| [&(frame.len() as u64).to_le_bytes(), frame].concat();
    match codec {
        Codec::None => Ok(bytes),
        Codec::Zip => {
            let mut encoder = ZlibEncoder::new(Vec::new(), flate2::Compression::default());
            let packed = encoder.write_all(&bytes).and_then(|()| encoder.finish());
            packed.map(|packed| framed(&packed)).map_err(Error::io)
        }
        Codec::Blosc => {
            let frames: Vec<Vec<u8>> = bytes
                .par_chunks(FRAME_BYTES)
                .map(|chunk| {
                    let (mut frame, mut shuffled) = (Vec::new(), Vec::new());
                    blosc::encode_or_store(chunk, BLOCK_BYTES, &mut frame, &mut shuffled);
                    framed(&frame)
                })
                .collect();
            Ok(frames.concat())
        }
    }
}
