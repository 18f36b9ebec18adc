//! The first pass over the bytes of a grid of points.

use super::arrays::{self, Array, Unit, VOXEL_BYTES};
use super::codecs::Coding;
use super::descriptor::{self, Descriptor};
use crate::Error;
use crate::display::quoted;
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::topology::{Cost, LEAF_MASK, LeafPlace, scan_nodes};
use crate::format::values::Encoding;
use crate::points::Points;
use crate::tree::{IVec3, LeafNode};

/// The version of the format that introduced passes. OpenVDB has written points since then.
const PASSES: u32 = 224;

/// The length of voxels that are not compressed.
pub(super) const NOT_PACKED: u16 = u16::MAX;

/// The flag of attributes that all leaves have.
pub(super) const SHARED: u8 = 1;

/// The offsets of everything that points are made of.
pub(crate) struct Scan<'a> {
    /// The bytes of the file, up to the end of the grid.
    pub(super) cursor: Cursor<'a>,
    pub(super) descriptor: Descriptor,
    pub(super) leaves: Vec<Leaf>,
    pub(super) columns: Vec<Column>,
    /// The place of the positions among the columns.
    pub(super) position: usize,
    pub(super) points: usize,
}

/// A leaf with points.
pub(super) struct Leaf {
    pub origin: IVec3,
    pub points: u32,
    /// The offset of its voxels, their bytes in the file, and whether they are compressed.
    pub at: usize,
    pub bytes: usize,
    pub packed: bool,
}

/// An attribute in all leaves.
#[derive(Default)]
pub(super) struct Column {
    /// `None` if it is not read.
    pub coding: Option<Coding>,
    pub stride: u32,
    /// One for each leaf.
    pub arrays: Vec<Array>,
    pub units: Vec<Unit>,
}

/// Reads past a grid of points.
pub(crate) fn scan<'a>(
    cursor: &mut Cursor<'a>,
    encoding: Encoding,
    budget: &mut Budget<'_>,
) -> Result<Scan<'a>, Error> {
    let at = cursor.at();
    if encoding.version < PASSES {
        let version = encoding.version;
        return Err(Error::not_supported(format!(
            "points in version {version} of the format (OpenVDB writes them since {PASSES})"
        ))
        .at(at));
    }
    let cost = Cost { leaf_bytes: size_of::<Leaf>(), leaf_voxels: 0, are_built: true };
    // The tree is that of 32-bit integers, and only its leaves have points.
    let mut masks = *cursor;
    let (nodes, passes_at) =
        scan_nodes::<LeafNode<i32, 3>>(&mut masks, at, encoding, cost, budget)?;
    *cursor = cursor.moved_to(passes_at)?;
    let passes = u16::from_le_bytes(cursor.array()?);
    let mut places: Vec<LeafPlace> = Vec::new();
    for middle in nodes.middles_in_order()? {
        places.extend(nodes.leaves_of(middle, &mut masks)?);
    }
    let mut scan = Scan {
        cursor: *cursor,
        descriptor: Descriptor::default(),
        leaves: Vec::new(),
        columns: Vec::new(),
        position: 0,
        points: 0,
    };
    if !places.is_empty() {
        // The length of each leaf's voxels, which also stands in front of them.
        cursor.take(2 * places.len())?;
        scan.read_attributes(cursor, places.len(), budget)?;
        scan.check_passes(passes).map_err(|error| error.at(passes_at))?;
        for column in &mut scan.columns {
            column.units = arrays::read_pages(cursor, &column.arrays)?;
        }
        for (leaf, place) in places.iter().enumerate() {
            scan.read_leaf(cursor, leaf, place.origin)?;
        }
        for column in &mut scan.columns {
            arrays::locate(cursor, &mut column.units, &column.arrays)?;
        }
    }
    scan.take_memory(budget).map_err(|error| error.at(at))?;
    scan.cursor = *cursor;
    Ok(scan)
}

impl Scan<'_> {
    /// Reads the attributes of all leaves and the lengths of their arrays.
    fn read_attributes(
        &mut self,
        cursor: &mut Cursor<'_>,
        leaves: usize,
        budget: &mut Budget<'_>,
    ) -> Result<(), Error> {
        /// More data follow, for newer versions of OpenVDB.
        const LONGER: u8 = 2;
        let mut is_shared = false;
        for leaf in 0..leaves {
            let at = cursor.at();
            if !is_shared {
                let flags = cursor.u8()?;
                if flags & !(SHARED | LONGER) != 0 {
                    let what = format!("points with the flags {flags:#x}");
                    return Err(Error::not_supported(what).at(at));
                }
                let descriptor = descriptor::read(cursor, budget)?;
                if flags & LONGER != 0 {
                    let length = u64::from_le_bytes(cursor.array()?);
                    cursor.take(usize::try_from(length).unwrap_or(usize::MAX))?;
                }
                is_shared = flags & SHARED != 0;
                self.add_descriptor(descriptor, leaf).map_err(|error| error.at(at))?;
            }
            for column in &mut self.columns {
                let array = Array::read(cursor)?;
                column.arrays.push(array);
            }
        }
        self.check_arrays().map_err(|error| error.at(cursor.at()))
    }

    /// Takes the first descriptor, and compares others with it.
    fn add_descriptor(&mut self, descriptor: Descriptor, leaf: usize) -> Result<(), Error> {
        if leaf > 0 {
            if descriptor.attributes == self.descriptor.attributes
                && descriptor.groups == self.descriptor.groups
            {
                return Ok(());
            }
            return Err(Error::not_supported(
                "points whose attributes differ from leaf to leaf; give all of them the same \
                 attributes in the program that made them",
            ));
        }
        let position =
            descriptor.attributes.iter().position(|named| named.name == Points::POSITION);
        self.position =
            position.ok_or_else(|| Error::not_supported("points without positions (`P`)"))?;
        let coding = |named: &descriptor::Named| Coding::new(&named.value_type, &named.codec);
        self.columns = descriptor
            .attributes
            .iter()
            .map(|named| Column { coding: coding(named), ..Column::default() })
            .collect();
        let named = &descriptor.attributes[self.position];
        if !matches!(self.columns[self.position].coding, Some(Coding::Vec3s(_) | Coding::Vec3d)) {
            return Err(Error::not_supported(format!(
                "positions of type {} with codec {}",
                quoted(&named.value_type),
                quoted(&named.codec)
            )));
        }
        self.descriptor = descriptor;
        Ok(())
    }

    /// Checks that all arrays have values for the same points, and as many bytes as that takes.
    fn check_arrays(&mut self) -> Result<(), Error> {
        let positions: Vec<u32> =
            self.columns[self.position].arrays.iter().map(|array| array.points).collect();
        for (column, named) in self.columns.iter_mut().zip(&self.descriptor.attributes) {
            column.stride = column.arrays.first().map_or(1, |array| array.stride);
            if column.arrays.iter().any(|array| array.stride != column.stride) {
                column.stride = 0;
            }
            let Some(coding) = column.coding.filter(|_| column.stride > 0) else {
                column.coding = None;
                continue;
            };
            let name = || quoted(&named.name).to_string();
            for (array, &points) in column.arrays.iter().zip(&positions) {
                if array.points != points {
                    let own = array.points;
                    return Err(Error::invalid(format!(
                        "attribute {} has values for {own} of the {points} points of a leaf",
                        name()
                    )));
                }
                let bytes = array.unpacked(&coding);
                if array.paged && array.bytes != bytes {
                    let own = array.bytes;
                    return Err(Error::invalid(format!(
                        "attribute {} takes {own} bytes in a leaf, not {bytes}",
                        name()
                    )));
                }
            }
        }
        if self.columns[self.position].stride != 1 {
            return Err(Error::not_supported("points with more than one position"));
        }
        // Cannot overflow: there is a leaf for each number of 32 bits.
        self.points = positions.iter().map(|&points| points as usize).sum();
        Ok(())
    }

    /// Checks that the file has the passes of all attributes. It may have more, for attributes that
    /// were not saved.
    fn check_passes(&self, passes: u16) -> Result<(), Error> {
        let (attributes, passes) = (self.columns.len(), usize::from(passes));
        if passes < 4 + 2 * attributes {
            let what = format!("{passes} passes are too few for {attributes} attributes of points");
            return Err(Error::invalid(what));
        }
        Ok(())
    }

    /// Reads past the voxels of a leaf.
    fn read_leaf(
        &mut self,
        cursor: &mut Cursor<'_>,
        leaf: usize,
        origin: IVec3,
    ) -> Result<(), Error> {
        let points = self.columns[self.position].arrays[leaf].points;
        // The mask is that of the topology.
        cursor.take(LEAF_MASK)?;
        let length = u16::from_le_bytes(cursor.array()?);
        let packed = length != NOT_PACKED;
        let bytes = if packed { length.into() } else { VOXEL_BYTES };
        let at = cursor.at();
        cursor.take(bytes)?;
        self.leaves.push(Leaf { origin, points, at, bytes, packed });
        Ok(())
    }

    /// Adds the memory that the points will take to the budget, with that of their largest page.
    fn take_memory(&self, budget: &mut Budget<'_>) -> Result<(), Error> {
        let points = self.points as u64;
        let read = self.columns.iter().filter_map(|c| c.coding.map(|coding| (c, coding)));
        let position = self.columns.get(self.position);
        let of_values = read.clone().map(|(column, coding)| {
            // The values of the positions are not kept.
            let is_kept = position.is_none_or(|position| !std::ptr::eq(position, column));
            let each = if is_kept { coding.decoded() as u64 } else { 0 };
            points.saturating_mul(u64::from(column.stride)).saturating_mul(each)
        });
        let positions = points.saturating_mul(size_of::<glam::DVec3>() as u64);
        let units = read.flat_map(|(column, coding)| {
            column.units.iter().map(move |unit| {
                let arrays = &column.arrays[unit.leaves.clone()];
                arrays.iter().fold(0, |sum: usize, a| sum.saturating_add(a.unpacked(&coding)))
            })
        });
        let largest = units.max().unwrap_or(0) as u64;
        let bytes = of_values.fold(positions, u64::saturating_add).saturating_add(largest);
        budget.add_points(points, bytes)
    }
}
