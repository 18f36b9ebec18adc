//! The values of leaves and tiles, of each kind of grid.

use std::marker::PhantomData;

use super::blind::Blind;
use super::layout::{Sizes, leaf};
use crate::Error;
use crate::format::cursor::Cursor;
use crate::format::masks::read_mask;
use crate::format::value_types::FileValue;
use crate::tree::{Active, BitLeaf, IVec3, LeafNode, Mask, Node};

/// How the values of a kind of grid are stored.
pub(super) trait Decode: Sync {
    /// The leaf that is built.
    type Leaf: Node<Leaf = Self::Leaf>;

    /// The sizes of the values in nodes.
    fn sizes(&self) -> Sizes;
    /// The value where the cursor is: of the background or a tile.
    fn value(&self, cursor: Cursor<'_>) -> Result<<Self::Leaf as Node>::Value, Error>;
    /// Bytes of the leaf that begins where the cursor is.
    fn leaf_bytes(&self, cursor: Cursor<'_>) -> Result<usize, Error>;
    /// Reads the leaf that begins where the cursor is.
    fn leaf(&self, cursor: Cursor<'_>, origin: IVec3) -> Result<Box<Self::Leaf>, Error>;
}

/// The number of voxels of a leaf.
const VOXELS: usize = 512;

/// The active voxels of the leaf that begins where the cursor is.
fn active(cursor: &Cursor<'_>) -> Result<Mask<3>, Error> {
    read_mask(&mut after(cursor, leaf::VALUE_MASK)?)
}

fn after<'a>(cursor: &Cursor<'a>, bytes: usize) -> Result<Cursor<'a>, Error> {
    cursor.moved_to(cursor.at() + bytes)
}

/// Numbers and vectors of `bytes` bytes each, converted by `convert`.
pub(super) struct Plain<T> {
    pub sizes: Sizes,
    pub convert: fn(&[u8], &mut [T]),
}

impl<T: FileValue> Plain<T> {
    /// Values as they are in a `.vdb` file, too.
    pub fn new(align: usize, statistic: usize) -> Self {
        Self { sizes: Sizes { value: T::BYTES, align, statistic }, convert: T::from_bytes }
    }
}

impl<T: FileValue> Decode for Plain<T> {
    type Leaf = LeafNode<T, 3>;

    fn sizes(&self) -> Sizes {
        self.sizes
    }

    fn value(&self, mut cursor: Cursor<'_>) -> Result<T, Error> {
        let mut value = T::default();
        (self.convert)(cursor.take(self.sizes.value)?, std::slice::from_mut(&mut value));
        Ok(value)
    }

    fn leaf_bytes(&self, _: Cursor<'_>) -> Result<usize, Error> {
        // A multiple of the alignment, as there are 512 values.
        Ok(self.sizes.leaf_values() + VOXELS * self.sizes.value)
    }

    fn leaf(&self, cursor: Cursor<'_>, origin: IVec3) -> Result<Box<Self::Leaf>, Error> {
        let mut made = Self::Leaf::filled(origin, T::default(), false);
        *made.value_mask_mut() = active(&cursor)?;
        let mut values = after(&cursor, self.sizes.leaf_values())?;
        (self.convert)(values.take(VOXELS * self.sizes.value)?, made.values_slice_mut());
        Ok(made)
    }
}

/// Floats as multiples of a leaf's quantum, above its minimum. Codes have a fixed number of bits, or
/// one that each leaf gives (`FpN`).
pub(super) struct Quantized {
    /// log₂ of the bits of a code; `None` if each leaf has its own.
    pub log2_bits: Option<u8>,
}

impl Quantized {
    fn log2_bits(&self, cursor: &Cursor<'_>) -> Result<u8, Error> {
        match self.log2_bits {
            Some(log2_bits) => Ok(log2_bits),
            None => match after(cursor, leaf::FLAGS)?.u8()? >> 5 {
                log2_bits @ 0..=4 => Ok(log2_bits),
                other => {
                    let what = format!("a leaf with codes of 2^{other} bits, more than 16");
                    Err(Error::invalid(what).at(cursor.at() + leaf::FLAGS))
                }
            },
        }
    }
}

impl Decode for Quantized {
    type Leaf = LeafNode<f32, 3>;

    fn sizes(&self) -> Sizes {
        Sizes::FLOAT
    }

    fn value(&self, mut cursor: Cursor<'_>) -> Result<f32, Error> {
        f32::read(&mut cursor)
    }

    fn leaf_bytes(&self, cursor: Cursor<'_>) -> Result<usize, Error> {
        Ok(leaf::CODES + ((VOXELS / 8) << self.log2_bits(&cursor)?))
    }

    fn leaf(&self, cursor: Cursor<'_>, origin: IVec3) -> Result<Box<Self::Leaf>, Error> {
        let log2_bits = self.log2_bits(&cursor)?;
        let mut made = Self::Leaf::filled(origin, 0.0, false);
        *made.value_mask_mut() = active(&cursor)?;
        let mut range = after(&cursor, leaf::AFTER_MASK)?;
        let (minimum, quantum) = (f32::read(&mut range)?, f32::read(&mut range)?);
        let codes = after(&cursor, leaf::CODES)?.take((VOXELS / 8) << log2_bits)?;
        let values = made.values_slice_mut();
        // In f32, as NanoVDB computes it.
        let value = |code: u16| f32::from(code) * quantum + minimum;
        if log2_bits == 4 {
            for (value_at, code) in values.iter_mut().zip(codes.as_chunks().0) {
                *value_at = value(u16::from_le_bytes(*code));
            }
        } else {
            // Codes of less than a byte are packed from the lowest bit on.
            let bits = 1 << log2_bits;
            let per_byte = 8 / bits;
            let mask = ((1_u16 << bits) - 1) as u8;
            for (index, value_at) in values.iter_mut().enumerate() {
                let code = codes[index / per_byte] >> (bits * (index % per_byte)) & mask;
                *value_at = value(code.into());
            }
        }
        Ok(made)
    }
}

/// Bits: one for each value, and one for each state.
pub(super) struct Bits;

/// The sizes of grids of bits, whose tiles take a byte.
const BIT_SIZES: Sizes = Sizes { value: 1, align: 1, statistic: 1 };

/// Bytes of a leaf of values and states; and of states or indices alone.
const BIT_LEAF: usize = 160;
const SPECIAL_LEAF: usize = 96;

impl Decode for Bits {
    type Leaf = BitLeaf<Mask<3>, 3>;

    fn sizes(&self) -> Sizes {
        BIT_SIZES
    }

    fn value(&self, mut cursor: Cursor<'_>) -> Result<bool, Error> {
        bool::read(&mut cursor)
    }

    fn leaf_bytes(&self, _: Cursor<'_>) -> Result<usize, Error> {
        Ok(BIT_LEAF)
    }

    fn leaf(&self, cursor: Cursor<'_>, origin: IVec3) -> Result<Box<Self::Leaf>, Error> {
        let values = read_mask(&mut after(&cursor, leaf::AFTER_MASK)?)?;
        Ok(BitLeaf::from_parts(origin, active(&cursor)?, values))
    }
}

/// States without values.
pub(super) struct States;

impl Decode for States {
    type Leaf = BitLeaf<Active, 3>;

    fn sizes(&self) -> Sizes {
        BIT_SIZES
    }

    fn value(&self, mut cursor: Cursor<'_>) -> Result<bool, Error> {
        bool::read(&mut cursor)
    }

    fn leaf_bytes(&self, _: Cursor<'_>) -> Result<usize, Error> {
        Ok(SPECIAL_LEAF)
    }

    fn leaf(&self, cursor: Cursor<'_>, origin: IVec3) -> Result<Box<Self::Leaf>, Error> {
        Ok(BitLeaf::from_parts(origin, active(&cursor)?, Active))
    }
}

/// How the leaves of an index grid number their voxels.
#[derive(Clone, Copy, Debug)]
pub(super) enum Numbering {
    /// All voxels of a leaf in a row.
    All,
    /// The active voxels of a leaf in a row; inactive ones have the number 0, the background's.
    Active,
    /// As each leaf says (up to version 32.4).
    PerLeaf,
}

/// Numbers of values in an array, which is blind data.
pub(super) struct Indexed<'a, T> {
    pub numbering: Numbering,
    pub values: Blind<'a>,
    pub value_type: PhantomData<fn() -> T>,
}

impl<T: FileValue> Indexed<'_, T> {
    /// Reads `count` values from the number `first` on.
    fn get(&self, first: u64, out: &mut [T], at: usize) -> Result<(), Error> {
        let bytes = self.values.bytes;
        let start = usize::try_from(first).ok().and_then(|first| first.checked_mul(T::BYTES));
        let range = start
            .and_then(|start| Some(start..start.checked_add(out.len().checked_mul(T::BYTES)?)?));
        let Some(found) = range.and_then(|range| bytes.get(range)) else {
            let (count, all) = (out.len(), bytes.len() / T::BYTES);
            let what = format!("{count} values from number {first} on, of which there are {all}");
            return Err(Error::invalid(what).at(at));
        };
        T::from_bytes(found, out);
        Ok(())
    }
}

/// The flag of leaves up to version 32.4 that number active voxels only.
const SPARSE: u8 = 16;

impl<T: FileValue> Decode for Indexed<'_, T> {
    type Leaf = LeafNode<T, 3>;

    fn sizes(&self) -> Sizes {
        Sizes { value: 8, align: 8, statistic: 8 }
    }

    fn value(&self, mut cursor: Cursor<'_>) -> Result<T, Error> {
        let at = cursor.at();
        let mut value = T::default();
        self.get(cursor.i64()?.cast_unsigned(), std::slice::from_mut(&mut value), at)?;
        Ok(value)
    }

    fn leaf_bytes(&self, _: Cursor<'_>) -> Result<usize, Error> {
        Ok(SPECIAL_LEAF)
    }

    fn leaf(&self, cursor: Cursor<'_>, origin: IVec3) -> Result<Box<Self::Leaf>, Error> {
        let at = cursor.at();
        let mask = active(&cursor)?;
        let mut numbers = after(&cursor, leaf::AFTER_MASK)?;
        let (first, second) = (numbers.i64()?.cast_unsigned(), numbers.i64()?.cast_unsigned());
        let (sparse, first) = match self.numbering {
            Numbering::All => (false, first),
            Numbering::Active => (true, first),
            // Here the statistics' number comes first.
            Numbering::PerLeaf => (after(&cursor, leaf::FLAGS)?.u8()? & SPARSE != 0, second),
        };
        let mut made = Self::Leaf::filled(origin, T::default(), false);
        if sparse {
            let mut background = T::default();
            self.get(0, std::slice::from_mut(&mut background), at)?;
            let mut values = vec![T::default(); mask.count()];
            self.get(first, &mut values, at)?;
            let out = made.values_slice_mut();
            out.fill(background);
            for (slot, value) in mask.iter_on().zip(values) {
                out[slot] = value;
            }
        } else {
            self.get(first, made.values_slice_mut(), at)?;
        }
        *made.value_mask_mut() = mask;
        Ok(made)
    }
}
