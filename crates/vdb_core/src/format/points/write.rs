//! Writing a grid of points.

use std::cell::RefCell;
use std::ops::Range;

use rayon::prelude::*;

use super::arrays::Array;
use super::build::PADDED;
use super::codecs::Coding;
use super::descriptor::{self, Descriptor, Named};
use super::place::Layout;
use super::scan::{NOT_PACKED, SHARED};
use crate::codec::{PackScratch, blosc};
use crate::display::quoted;
use crate::format::masks::write_mask;
use crate::format::topology;
use crate::format::values::Encoding;
use crate::points::{PointAttribute, PointGroup, PointValues, Points};
use crate::{Codec, Error};

thread_local! {
    static SCRATCH: RefCell<PackScratch> = RefCell::default();
}

/// Bytes after which a page ends, as in OpenVDB.
const PAGE: usize = 1 << 20;

/// Writes points, given their voxels. Returns the offset of everything after the tree.
pub(crate) fn write(
    out: &mut Vec<u8>,
    points: &Points,
    layout: &Layout,
    encoding: Encoding,
) -> Result<usize, Error> {
    topology::write_nodes(out, &layout.tree, encoding)?;
    let values_at = out.len();
    if layout.leaves.is_empty() {
        out.extend(0_u16.to_le_bytes());
        return Ok(values_at);
    }
    let (descriptor, columns) = columns(points, layout, encoding.compression.codec)?;
    // Checks the number of attributes, which the number of passes follows from.
    let mut attributes = vec![SHARED];
    descriptor::write(&mut attributes, &descriptor)?;
    out.extend((4 + 2 * columns.len() as u16).to_le_bytes());
    let leaves: Vec<_> = layout.tree.leaves().collect();
    let voxels: Vec<Voxels> =
        leaves.par_iter().map(|leaf| Voxels::of(leaf.values_slice())).collect();
    voxels.iter().for_each(|voxels| out.extend(voxels.length.to_le_bytes()));
    out.extend(attributes);
    for leaf in 0..leaves.len() {
        columns.iter().for_each(|column| column.arrays[leaf].write(out));
    }
    for unit in columns.iter().flat_map(|column| &column.units) {
        out.extend(&unit.length);
    }
    for (leaf, voxels) in leaves.iter().zip(&voxels) {
        write_mask(out, leaf.value_mask().words());
        out.extend(voxels.length.to_le_bytes());
        out.extend(&voxels.bytes);
    }
    for unit in columns.iter().flat_map(|column| &column.units) {
        out.extend(&unit.bytes);
    }
    Ok(values_at)
}

/// The voxels of a leaf, compressed whatever the compression of the grid.
struct Voxels {
    length: u16,
    bytes: Vec<u8>,
}

impl Voxels {
    fn of(ends: &[i32]) -> Self {
        let raw: Vec<u8> = ends.iter().flat_map(|end| end.to_le_bytes()).collect();
        SCRATCH.with_borrow_mut(|PackScratch { packed, shuffled, .. }| {
            let smaller = blosc::encode(&raw, packed, shuffled);
            match u16::try_from(packed.len()) {
                Ok(length) if smaller => Self { length, bytes: packed.clone() },
                _ => Self { length: NOT_PACKED, bytes: raw },
            }
        })
    }
}

/// An attribute, encoded and compressed.
struct Column {
    /// One for each leaf.
    arrays: Vec<Array>,
    units: Vec<Unit>,
}

/// A page of arrays, or one array that is in no page.
struct Unit {
    /// The lengths of a page, which stand in front of all pages.
    length: Vec<u8>,
    bytes: Vec<u8>,
}

/// The attributes that are written: the positions, and all whose values have been read.
fn columns(
    points: &Points,
    layout: &Layout,
    codec: Codec,
) -> Result<(Descriptor, Vec<Column>), Error> {
    let attributes = points.attributes();
    let position = attributes.iter().position(|named| named.name == Points::POSITION);
    let (mut descriptor, mut columns) = (Descriptor::default(), Vec::new());
    let mut add = |attribute: &PointAttribute, values: &PointValues| {
        let (named, column) = Column::of(attribute, values, layout, codec)?;
        descriptor.attributes.push(named);
        columns.push(column);
        Ok::<usize, Error>(columns.len() - 1)
    };
    if position.is_none() {
        add(&PointAttribute::position(), &layout.offsets)?;
    }
    // The place of each attribute among those that are written.
    let mut places = Vec::new();
    for (index, attribute) in attributes.iter().enumerate() {
        let values = match position {
            Some(position) if position == index => Some(&layout.offsets),
            _ => attribute.values.as_ref(),
        };
        places.push(values.map(|values| add(attribute, values)).transpose()?);
    }
    descriptor.groups = points
        .groups()
        .iter()
        .filter_map(|group| {
            let attribute = *places.get(group.attribute)?;
            Some(PointGroup { attribute: attribute?, ..group.clone() })
        })
        .collect();
    Ok((descriptor, columns))
}

impl Column {
    /// Encodes an attribute with its own codec, or in full if that would change a value.
    fn of(
        attribute: &PointAttribute,
        values: &PointValues,
        layout: &Layout,
        codec: Codec,
    ) -> Result<(Named, Self), Error> {
        let stride = attribute.values_per_point;
        let encoded = |coding: Coding| {
            let of_leaf = |leaf: &Range<usize>| {
                coding.encode(values, &layout.order[leaf.clone()], stride as usize)
            };
            let leaves = layout.leaves.par_iter().map(of_leaf);
            Some((coding, leaves.collect::<Option<Vec<_>>>()?))
        };
        let name = attribute.name.clone();
        let (value_type, value_codec) = (&*attribute.value_type, &*attribute.codec);
        let own = Coding::new(value_type, value_codec).map(|own| (value_type, value_codec, own));
        let (value_type, value_codec, (coding, mut leaves)) = own
            .into_iter()
            .chain([Coding::in_full(values)])
            .find_map(|(value_type, codec, coding)| Some((value_type, codec, encoded(coding)?)))
            .ok_or_else(|| {
                Error::not_supported(format!("values of attribute {}", quoted(&attribute.name)))
            })?;
        let named = Named { name, value_type: value_type.into(), codec: value_codec.into() };
        let paged = codec == Codec::Blosc;
        let arrays = leaves
            .iter_mut()
            .zip(&layout.leaves)
            .map(|(bytes, leaf)| {
                let mut values = bytes.chunks_exact(coding.stored());
                let first = values.next();
                let uniform = values.all(|value| Some(value) == first);
                if uniform {
                    bytes.truncate(coding.stored());
                }
                // The layout has checked the number.
                Array { bytes: bytes.len(), points: leaf.len() as u32, stride, uniform, paged }
            })
            .collect::<Vec<_>>();
        let units = if paged { pages(&leaves)? } else { apart(leaves, &arrays) };
        Ok((named, Self { arrays, units }))
    }
}

/// Arrays that are not in pages: they are not compressed.
fn apart(leaves: Vec<Vec<u8>>, arrays: &[Array]) -> Vec<Unit> {
    let unit = |(mut bytes, array): (Vec<u8>, &Array)| {
        if !array.uniform {
            bytes.insert(0, 0);
        }
        Unit { length: Vec::new(), bytes }
    };
    leaves.into_iter().zip(arrays).map(unit).collect()
}

/// Puts arrays into pages.
fn pages(leaves: &[Vec<u8>]) -> Result<Vec<Unit>, Error> {
    let mut pages = Vec::new();
    let (mut start, mut bytes) = (0, 0);
    for (leaf, array) in leaves.iter().enumerate() {
        bytes += array.len();
        if bytes >= PAGE || leaf + 1 == leaves.len() {
            pages.push(&leaves[start..=leaf]);
            (start, bytes) = (leaf + 1, 0);
        }
    }
    pages.into_par_iter().map(|arrays| page(&arrays.concat())).collect()
}

/// A page, compressed if that makes it smaller. OpenVDB fills up short pages before it compresses
/// them, which is not worth it.
fn page(raw: &[u8]) -> Result<Unit, Error> {
    let unpacked = i32::try_from(raw.len()).map_err(|_| {
        Error::not_supported(format!("{} bytes of one attribute in a leaf", raw.len()))
    })?;
    SCRATCH.with_borrow_mut(|PackScratch { packed, shuffled, .. }| {
        if raw.len() >= PADDED && blosc::encode(raw, packed, shuffled) {
            // Less than `unpacked`.
            let lengths = [packed.len() as i32, unpacked];
            let length = lengths.into_iter().flat_map(i32::to_le_bytes).collect();
            return Ok(Unit { length, bytes: packed.clone() });
        }
        Ok(Unit { length: (-unpacked).to_le_bytes().into(), bytes: raw.to_vec() })
    })
}
