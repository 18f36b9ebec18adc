//! Leaf values: a second copy of the leaf's mask, then its values.

use super::cursor::Cursor;
use super::header::NODE_MASK_COMPRESSION;
use super::masks::{TreeContext, read_mask, write_mask, write_origin};
use super::value_types::FileValue;
use super::values::{self, NodeValues};
use crate::Error;
use crate::codec::{PackScratch, Scratch};
use crate::tree::{Active, BitLeaf, IVec3, LeafNode, Mask, Node};

/// A leaf of 8³ voxels that can be read from and written to a file.
pub(crate) trait FileLeaf: Node<Leaf = Self, Value: FileValue> {
    /// Skips the values of a leaf.
    fn pass(
        cursor: &mut Cursor<'_>,
        context: &TreeContext<Self::Value>,
        origin: IVec3,
        mask: &Mask<3>,
    ) -> Result<(), Error>;

    /// Reads the values of a leaf.
    fn read(
        cursor: &mut Cursor<'_>,
        context: &TreeContext<Self::Value>,
        origin: IVec3,
        mask: Mask<3>,
        scratch: &mut Scratch,
    ) -> Result<Box<Self>, Error>;

    /// The active voxels.
    fn mask(&self) -> &Mask<3>;

    /// Writes the values of a leaf.
    fn write(
        &self,
        out: &mut Vec<u8>,
        context: &TreeContext<Self::Value>,
        scratch: &mut PackScratch,
    );
}

/// Locates the values of a leaf. Returns the mask that applies to them, and the values.
fn locate<'a, T: FileValue>(
    cursor: &mut Cursor<'a>,
    context: &TreeContext<T>,
    origin: IVec3,
    topology: &Mask<3>,
) -> Result<(Mask<3>, NodeValues<'a, T>), Error> {
    let encoding = &context.encoding;
    let own = read_mask(cursor)?;
    // The two masks are equal in a sound file. OpenVDB uses the first if the file has offsets, and
    // the second in a stream.
    let mask = if encoding.has_offsets { topology.clone() } else { own };
    let mut buffers = 1;
    if encoding.version < NODE_MASK_COMPRESSION {
        check_origin(cursor, origin)?;
        buffers = cursor.u8()? as i8;
    }
    let all = Mask::<3>::SIZE;
    let values = NodeValues::locate(cursor, encoding, context.background, all, || mask.count())?;
    // Very old programs also wrote copies for multi-threaded filters.
    for _ in 1..buffers {
        NodeValues::<T>::locate_packed(cursor, encoding, all)?;
    }
    Ok((mask, values))
}

/// Some leaf types repeat their origin, which is already known from the topology.
fn check_origin(cursor: &mut Cursor<'_>, origin: IVec3) -> Result<(), Error> {
    let at = cursor.at();
    let own = cursor.ivec3()?;
    if own != origin {
        let what = format!("the leaf at {origin} gives its origin as {own}");
        return Err(Error::invalid(what).at(at));
    }
    Ok(())
}

impl<T: FileValue> FileLeaf for LeafNode<T, 3> {
    fn pass(
        cursor: &mut Cursor<'_>,
        context: &TreeContext<T>,
        origin: IVec3,
        mask: &Mask<3>,
    ) -> Result<(), Error> {
        locate(cursor, context, origin, mask).map(|_| ())
    }

    fn read(
        cursor: &mut Cursor<'_>,
        context: &TreeContext<T>,
        origin: IVec3,
        mask: Mask<3>,
        scratch: &mut Scratch,
    ) -> Result<Box<Self>, Error> {
        let (mask, values) = locate(cursor, context, origin, &mask)?;
        let mut leaf = Self::filled(origin, context.background, false);
        values.decode(&context.encoding, mask.words(), leaf.values_slice_mut(), scratch)?;
        *leaf.value_mask_mut() = mask;
        Ok(leaf)
    }

    fn mask(&self) -> &Mask<3> {
        self.value_mask()
    }

    fn write(&self, out: &mut Vec<u8>, context: &TreeContext<T>, scratch: &mut PackScratch) {
        let (active, values) = (self.value_mask().words(), self.values_slice());
        write_mask(out, active);
        let (encoding, background) = (&context.encoding, context.background);
        values::write(out, encoding, background, values, active, &[0; 8], scratch);
    }
}

impl FileLeaf for BitLeaf<Mask<3>, 3> {
    fn pass(
        cursor: &mut Cursor<'_>,
        _: &TreeContext<bool>,
        origin: IVec3,
        _: &Mask<3>,
    ) -> Result<(), Error> {
        read_mask::<3>(cursor)?;
        check_origin(cursor, origin)?;
        read_mask::<3>(cursor).map(|_| ())
    }

    fn read(
        cursor: &mut Cursor<'_>,
        _: &TreeContext<bool>,
        origin: IVec3,
        _: Mask<3>,
        _: &mut Scratch,
    ) -> Result<Box<Self>, Error> {
        let mask = read_mask(cursor)?;
        check_origin(cursor, origin)?;
        Ok(Self::from_parts(origin, mask, read_mask(cursor)?))
    }

    fn mask(&self) -> &Mask<3> {
        self.value_mask()
    }

    fn write(&self, out: &mut Vec<u8>, _: &TreeContext<bool>, _: &mut PackScratch) {
        write_mask(out, self.value_mask().words());
        write_origin(out, self.origin());
        write_mask(out, self.values_mask().words());
    }
}

impl FileLeaf for BitLeaf<Active, 3> {
    fn pass(
        cursor: &mut Cursor<'_>,
        _: &TreeContext<bool>,
        origin: IVec3,
        _: &Mask<3>,
    ) -> Result<(), Error> {
        read_mask::<3>(cursor)?;
        check_origin(cursor, origin)
    }

    fn read(
        cursor: &mut Cursor<'_>,
        _: &TreeContext<bool>,
        origin: IVec3,
        _: Mask<3>,
        _: &mut Scratch,
    ) -> Result<Box<Self>, Error> {
        let mask = read_mask(cursor)?;
        check_origin(cursor, origin)?;
        Ok(Self::from_parts(origin, mask, Active))
    }

    fn mask(&self) -> &Mask<3> {
        self.value_mask()
    }

    fn write(&self, out: &mut Vec<u8>, _: &TreeContext<bool>, _: &mut PackScratch) {
        write_mask(out, self.value_mask().words());
        write_origin(out, self.origin());
    }
}
