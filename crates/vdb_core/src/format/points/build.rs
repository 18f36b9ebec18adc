//! The second pass over a grid of points: decompresses pages and decodes values, on all cores.

use std::cell::RefCell;

use glam::DVec3;
use rayon::prelude::*;

use super::arrays::{Place, Unit, VOXEL_BYTES, VOXELS};
use super::codecs::{Coding, ReadValues, vec3d, vec3s};
use super::scan::{Leaf, Scan};
use crate::Error;
use crate::codec::{Scratch, blosc};
use crate::points::{PointAttribute, Points};
use crate::work::Progress;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// OpenVDB fills up shorter data with zeros to this length before it compresses them.
pub(super) const PADDED: usize = 128;

impl Scan<'_> {
    /// Builds the points.
    pub(crate) fn build(self, progress: &Progress<'_>) -> Result<Points, Error> {
        self.check_coincident()?;
        let positions = self.positions()?;
        let mut attributes = Vec::new();
        progress.add(self.leaves.iter().map(|leaf| leaf.bytes).sum())?;
        for (index, named) in self.descriptor.attributes.iter().enumerate() {
            let column = &self.columns[index];
            let values = match column.coding {
                Some(coding) if index != self.position => {
                    let read = OfColumn { scan: &self, index, stored: coding.stored() };
                    Some(coding.values(read)?)
                }
                _ => None,
            };
            attributes.push(PointAttribute {
                name: named.name.clone(),
                value_type: named.value_type.clone(),
                codec: named.codec.clone(),
                values_per_point: column.stride,
                values,
            });
            progress.add(column_bytes(&column.units))?;
        }
        let mut groups = self.descriptor.groups;
        groups.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(Points { positions, attributes, groups })
    }

    /// Checks leaves in which more points than voxels share one stored position. They are rare, and
    /// their number of points is not bounded by the bytes of the file: their voxels must confirm it
    /// before memory is taken.
    fn check_coincident(&self) -> Result<(), Error> {
        let Some(column) = self.columns.get(self.position) else { return Ok(()) };
        self.leaves.par_iter().zip(&column.arrays).try_for_each(|(leaf, array)| {
            let is_suspect = array.uniform && leaf.points as usize > VOXELS;
            if is_suspect && self.voxels(leaf)?[VOXELS - 1] != leaf.points {
                return Err(disordered(leaf));
            }
            Ok(())
        })
    }

    fn positions(&self) -> Result<Vec<DVec3>, Error> {
        let Some(column) = self.columns.get(self.position) else { return Ok(Vec::new()) };
        match column.coding {
            Some(Coding::Vec3s(stored)) => {
                let decode = vec3s(stored);
                let vector = |bytes: &[u8]| DVec3::from(decode(bytes).map(f64::from));
                self.place(Coding::Vec3s(stored).stored(), vector)
            }
            Some(coding @ Coding::Vec3d) => self.place(coding.stored(), |b| vec3d(b).into()),
            _ => Ok(Vec::new()),
        }
    }

    /// The positions, given how to decode the offset of one from the centre of its voxel.
    fn place(
        &self,
        stored: usize,
        decode: impl Fn(&[u8]) -> DVec3 + Sync,
    ) -> Result<Vec<DVec3>, Error> {
        self.read_column(self.position, |leaf, bytes, out| {
            let leaf = &self.leaves[leaf];
            let ends = self.voxels(leaf)?;
            let uniform = bytes.len() == stored;
            let mut start = 0;
            for (voxel, &end) in ends.iter().enumerate() {
                let end = end as usize;
                if end < start || end > out.len() {
                    return Err(disordered(leaf));
                }
                let local = [voxel >> 6, voxel >> 3 & 7, voxel & 7].map(|c| c as f64);
                let center = leaf.origin.as_dvec3() + DVec3::from(local);
                for (point, out) in (start..end).zip(&mut out[start..end]) {
                    let place = if uniform { 0 } else { point * stored };
                    *out = center + decode(&bytes[place..][..stored]);
                }
                start = end;
            }
            if start == out.len() { Ok(()) } else { Err(disordered(leaf)) }
        })
    }

    /// The number of points of a leaf up to and including each voxel.
    fn voxels(&self, leaf: &Leaf) -> Result<[u32; VOXELS], Error> {
        let stored = self.cursor.moved_to(leaf.at)?.take(leaf.bytes)?;
        let mut bytes = [0; VOXEL_BYTES];
        if leaf.packed {
            let decoded =
                VOXEL_SCRATCH.with_borrow_mut(|scratch| blosc::decode(stored, &mut bytes, scratch));
            decoded.map_err(|error| error.at(leaf.at))?;
        } else {
            bytes.copy_from_slice(stored);
        }
        let mut ends = [0; VOXELS];
        for (end, bytes) in ends.iter_mut().zip(bytes.as_chunks().0) {
            *end = u32::from_le_bytes(*bytes);
        }
        Ok(ends)
    }

    /// Reads an attribute. `decode` gets the index of a leaf, the bytes of its values and the place
    /// for them.
    fn read_column<T: Copy + Default + Send>(
        &self,
        index: usize,
        decode: impl Fn(usize, &[u8], &mut [T]) -> Result<(), Error> + Sync,
    ) -> Result<Vec<T>, Error> {
        let column = &self.columns[index];
        let stride = column.stride as usize;
        let mut values = vec![T::default(); self.points * stride];
        let mut rest = &mut values[..];
        let mut parts = Vec::new();
        for unit in &column.units {
            let arrays = &column.arrays[unit.leaves.clone()];
            let count = arrays.iter().map(|array| array.points as usize * stride).sum();
            let (own, after) = std::mem::take(&mut rest).split_at_mut(count);
            rest = after;
            parts.push((unit, own));
        }
        parts.into_par_iter().try_for_each(|(unit, mut out)| {
            self.with_bytes(index, unit, |mut bytes| {
                for leaf in unit.leaves.clone() {
                    let array = &column.arrays[leaf];
                    let length = match (&unit.place, column.coding) {
                        (Place::Array { .. }, Some(coding)) => array.unpacked(&coding),
                        _ => array.bytes,
                    };
                    let (own, after) = bytes.split_at_checked(length).ok_or_else(too_short)?;
                    let (to, later) =
                        std::mem::take(&mut out).split_at_mut(array.points as usize * stride);
                    (bytes, out) = (after, later);
                    decode(leaf, own, to)?;
                }
                Ok(())
            })
        })?;
        Ok(values)
    }

    /// Decompresses the bytes of a unit.
    fn with_bytes<R>(
        &self,
        index: usize,
        unit: &Unit,
        then: impl FnOnce(&[u8]) -> Result<R, Error>,
    ) -> Result<R, Error> {
        let column = &self.columns[index];
        let (at, bytes, unpacked, packed) = match unit.place {
            Place::Nowhere => return then(&[]),
            Place::Page { at, bytes, unpacked, packed } => (at, bytes, unpacked, packed),
            Place::Array { at, bytes, packed } => {
                let array = &column.arrays[unit.leaves.start];
                let unpacked = column.coding.map_or(bytes, |coding| array.unpacked(&coding));
                (at, bytes, unpacked, packed)
            }
        };
        let stored = self.cursor.moved_to(at)?.take(bytes)?;
        let named = |error: Error| error.at(at);
        if !packed {
            let own = stored.get(..unpacked).filter(|own| own.len() == stored.len());
            return then(own.ok_or_else(|| named(too_short()))?).map_err(named);
        }
        SCRATCH.with_borrow_mut(|scratch| {
            let declared =
                stored.get(4..).and_then(|b| b.first_chunk()).map(|b| u32::from_le_bytes(*b));
            let padded = declared == Some(PADDED as u32) && unpacked < PADDED;
            let length = if padded { PADDED } else { unpacked };
            let mut room = std::mem::take(&mut scratch.bytes);
            let out = Scratch::room(&mut room, length);
            let result = blosc::decode(stored, out, scratch).and_then(|()| then(&out[..unpacked]));
            scratch.bytes = room;
            result.map_err(named)
        })
    }
}

thread_local! {
    /// Voxels are decompressed while a page is in use.
    static VOXEL_SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// The bytes of an attribute in the file.
fn column_bytes(units: &[Unit]) -> usize {
    let bytes = |unit: &Unit| match unit.place {
        Place::Nowhere => 0,
        Place::Page { bytes, .. } | Place::Array { bytes, .. } => bytes,
    };
    units.iter().map(bytes).sum()
}

fn too_short() -> Error {
    Error::invalid("an array of points has another length than its values")
}

fn disordered(leaf: &Leaf) -> Error {
    let (origin, points) = (leaf.origin, leaf.points);
    let what = format!("the voxels of the leaf at {origin} do not share out its {points} points");
    Error::invalid(what).at(leaf.at)
}

/// Reads an attribute.
struct OfColumn<'a, 'b> {
    scan: &'a Scan<'b>,
    index: usize,
    stored: usize,
}

impl ReadValues<Error> for OfColumn<'_, '_> {
    fn read<T: Copy + Default + Send>(
        self,
        decode: impl Fn(&[u8]) -> T + Sync,
    ) -> Result<Vec<T>, Error> {
        let arrays = &self.scan.columns[self.index].arrays;
        self.scan.read_column(self.index, |leaf, bytes, out| {
            if arrays[leaf].uniform {
                out.fill(decode(bytes));
            } else {
                for (out, bytes) in out.iter_mut().zip(bytes.chunks_exact(self.stored)) {
                    *out = decode(bytes);
                }
            }
            Ok(())
        })
    }
}
