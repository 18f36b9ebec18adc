//! One grid: from its buffer to a tree.

use std::marker::PhantomData;
use std::sync::Arc;

use super::blind::{self, Blind};
use super::checksum::{self, LAST_OLD};
use super::container::minor;
use super::head::{self, Head, Kind};
use super::layout::{Sizes, leaf};
use super::leaves::{Bits, Decode, Indexed, Numbering, Plain, Quantized, States};
use super::scan;
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::topology::Upper;
use crate::tree::Tree;
use crate::work::Progress;
use crate::{AnyTree, Error, GridClass, MetaValue, Metadata, Transform};

/// A grid that has been read.
pub(super) struct Parts {
    /// The name, if the buffer has one that is longer than the head can hold.
    pub long_name: Option<String>,
    pub kind: Kind,
    pub class: GridClass,
    pub transform: Transform,
    /// What has no other place: the kind of grid, and what is wrong with it.
    pub metadata: Metadata,
    /// The tree, or why it is not read.
    pub tree: Result<AnyTree, Error>,
}

/// Names of metadata.
mod entry {
    /// The kind of grid, as NanoVDB spells it.
    pub const KIND: &str = "nanovdb_type";
    /// Present if a checksum of the grid does not match.
    pub const CHECKSUM: &str = "nanovdb_checksum";
}

/// The first version whose index grids have one number per leaf, instead of a second for its
/// statistics.
const ONE_NUMBER: u32 = 5;

/// Reads the grid that begins where the cursor is, and ends where its bytes do.
pub(super) fn read(
    cursor: &Cursor<'_>,
    budget: &mut Budget<'_>,
    progress: &Progress<'_>,
) -> Result<Parts, Error> {
    let head = head::read(cursor)?;
    let blind = blind::list(cursor, &head)?;
    let mut metadata = Metadata::default();
    metadata.insert(entry::KIND, MetaValue::String(head.kind.name()));
    let channel = blind::channel(&blind)?;
    let class = match channel {
        Some(channel) if is_index(head.kind) => channel.grid_class(),
        _ => head.class,
    };
    let mut reader = Reader { cursor, head: &head, budget, progress, sound: true };
    let tree = match reader.tree(channel) {
        Ok(tree) => Ok(tree),
        Err(error @ Error::NotSupported { .. }) => Err(error),
        Err(error) => return Err(error),
    };
    if !reader.sound {
        let what = "does not match: the grid was changed after it was computed, or is damaged";
        metadata.insert(entry::CHECKSUM, MetaValue::String(what.into()));
    }
    Ok(Parts {
        long_name: blind::long_name(&blind),
        kind: head.kind,
        class: head::class(class),
        transform: head.transform,
        metadata,
        tree,
    })
}

fn is_index(kind: Kind) -> bool {
    matches!(kind, Kind::INDEX | Kind::ON_INDEX)
}

struct Reader<'a, 'b, 'c> {
    cursor: &'a Cursor<'b>,
    head: &'a Head,
    budget: &'a mut Budget<'c>,
    progress: &'a Progress<'a>,
    /// Whether no checksum is wrong.
    sound: bool,
}

impl Reader<'_, '_, '_> {
    /// Reads a tree of whatever kind.
    fn tree(&mut self, channel: Option<Blind<'_>>) -> Result<AnyTree, Error> {
        let kind = self.head.kind;
        if self.head.has_points() {
            return Err(Error::not_supported("grids of points are not supported"));
        }
        macro_rules! any {
            ($variant:ident, $decode:expr) => {
                self.read($decode).map(|tree| AnyTree::$variant(Arc::new(tree)))
            };
        }
        /// Small numbers in a type that holds all of them.
        macro_rules! widened {
            ($variant:ident, $narrow:ty, $wide:ty, $statistic:literal) => {{
                const BYTES: usize = size_of::<$narrow>();
                let sizes = Sizes { value: BYTES, align: BYTES, statistic: $statistic };
                let convert = |bytes: &[u8], out: &mut [$wide]| {
                    for (number, bytes) in out.iter_mut().zip(bytes.as_chunks::<BYTES>().0) {
                        *number = <$narrow>::from_le_bytes(*bytes).into();
                    }
                };
                any!($variant, Plain { sizes, convert })
            }};
        }
        match kind {
            Kind::FLOAT => any!(Float, Plain::<f32>::new(4, 4)),
            Kind::DOUBLE => any!(Double, Plain::<f64>::new(8, 8)),
            Kind::INT16 => widened!(Int32, i16, i32, 4),
            Kind::INT32 => any!(Int32, Plain::<i32>::new(4, 4)),
            Kind::INT64 => any!(Int64, Plain::<i64>::new(8, 8)),
            Kind::VEC3F => any!(Vec3s, Plain::<[f32; 3]>::new(4, 4)),
            Kind::VEC3D => any!(Vec3d, Plain::<[f64; 3]>::new(8, 8)),
            Kind::MASK => any!(Mask, States),
            Kind::UINT32 => widened!(Int64, u32, i64, 4),
            Kind::BOOLEAN => any!(Bool, Bits),
            Kind::FP4 => any!(Float, Quantized { log2_bits: Some(2) }),
            Kind::FP8 => any!(Float, Quantized { log2_bits: Some(3) }),
            Kind::FP16 => any!(Float, Quantized { log2_bits: Some(4) }),
            Kind::FPN => any!(Float, Quantized { log2_bits: None }),
            Kind::UINT8 => widened!(Int32, u8, i32, 4),
            Kind::INDEX | Kind::ON_INDEX => self.indexed(channel),
            other => Err(Error::not_supported(format!(
                "NanoVDB grids of type {} are not supported",
                other.name()
            ))),
        }
    }

    /// Reads an index grid, whose values are blind data.
    fn indexed(&mut self, channel: Option<Blind<'_>>) -> Result<AnyTree, Error> {
        let numbering = match self.head.kind {
            Kind::ON_INDEX => Numbering::Active,
            _ if minor(self.head.version) < ONE_NUMBER => Numbering::PerLeaf,
            _ => Numbering::All,
        };
        let Some(values) = channel else {
            return Err(Error::not_supported(
                "an index grid without values of its own; save it with its values as blind data",
            ));
        };
        macro_rules! any {
            ($variant:ident, $value:ty) => {{
                let decode = Indexed::<$value> { numbering, values, value_type: PhantomData };
                self.read(decode).map(|tree| AnyTree::$variant(Arc::new(tree)))
            }};
        }
        match values.kind {
            Kind::FLOAT => any!(Float, f32),
            Kind::DOUBLE => any!(Double, f64),
            Kind::INT32 => any!(Int32, i32),
            Kind::INT64 => any!(Int64, i64),
            Kind::VEC3F => any!(Vec3s, [f32; 3]),
            _ => any!(Vec3d, [f64; 3]),
        }
    }

    fn read<D: Decode>(&mut self, decode: D) -> Result<Tree<Upper<D::Leaf>>, Error> {
        let scan = scan::scan(self.cursor, self.head, decode, self.budget)?;
        let Head { version, checksums: [head, nodes], at, kind, .. } = *self.head;
        let bytes = self.cursor.moved_to(at)?.take(self.cursor.end() - at)?;
        // Before version 32.5, only the fixed part of leaves of variable size was covered.
        let old_leaf = (kind == Kind::FPN && minor(version) < ONE_NUMBER).then_some(leaf::CODES);
        let node_checksums = if version <= LAST_OLD && nodes != checksum::MISSING {
            scan.node_checksums(old_leaf)?
        } else {
            Vec::new()
        };
        self.sound = checksum::head_matches(bytes, version, head, scan.nodes_at - at)
            && checksum::nodes_match(bytes, version, nodes, &node_checksums);
        scan.build(self.progress)
    }
}
