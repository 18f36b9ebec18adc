//! What stands in front of a grid's tree.

use glam::{DAffine3, DMat3, DVec3};

use super::container::{self, is_nanovdb};
use super::layout::{ALIGN, GRID_BYTES, TREE_BYTES, grid, tree};
use crate::format::cursor::Cursor;
use crate::format::transform::simplify;
use crate::transform::Affine;
use crate::{Error, GridClass, Transform};

/// The type of a grid's values, as its number in `NanoVDB`'s enumeration of grid types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Kind(pub u32);

impl Kind {
    pub const FLOAT: Self = Self(1);
    pub const DOUBLE: Self = Self(2);
    pub const INT16: Self = Self(3);
    pub const INT32: Self = Self(4);
    pub const INT64: Self = Self(5);
    pub const VEC3F: Self = Self(6);
    pub const VEC3D: Self = Self(7);
    pub const MASK: Self = Self(8);
    pub const UINT32: Self = Self(10);
    pub const BOOLEAN: Self = Self(11);
    pub const FP4: Self = Self(13);
    pub const FP8: Self = Self(14);
    pub const FP16: Self = Self(15);
    pub const FPN: Self = Self(16);
    pub const INDEX: Self = Self(19);
    pub const ON_INDEX: Self = Self(20);
    pub const UINT8: Self = Self(26);

    /// The name, as `NanoVDB` spells it.
    pub fn name(self) -> String {
        const NAMES: [&str; 27] = [
            "Unknown",
            "Float",
            "Double",
            "Int16",
            "Int32",
            "Int64",
            "Vec3f",
            "Vec3d",
            "Mask",
            "Half",
            "UInt32",
            "Boolean",
            "RGBA8",
            "Fp4",
            "Fp8",
            "Fp16",
            "FpN",
            "Vec4f",
            "Vec4d",
            "Index",
            "OnIndex",
            "IndexMask",
            "OnIndexMask",
            "PointIndex",
            "Vec3u8",
            "Vec3u16",
            "UInt8",
        ];
        match NAMES.get(self.0 as usize) {
            Some(name) => (*name).to_owned(),
            None => format!("type {}", self.0),
        }
    }
}

/// The classes of grids that have points instead of values: point indices, and point data.
const POINT_CLASSES: [u32; 2] = [4, 5];

/// The class of a grid, by its number in `NanoVDB`'s enumeration of grid classes.
pub(super) fn class(number: u32) -> GridClass {
    match number {
        1 => GridClass::LevelSet,
        2 => GridClass::FogVolume,
        3 => GridClass::Staggered,
        _ => GridClass::Unknown,
    }
}

/// The head of a grid.
#[derive(Debug)]
pub(super) struct Head {
    pub kind: Kind,
    pub class: u32,
    pub version: u32,
    /// The two checksums: of the head, and of the nodes.
    pub checksums: [u32; 2],
    pub transform: Transform,
    /// Where the grid, its tree and its root begin in the cursor's bytes.
    pub at: usize,
    pub root_at: usize,
    /// The metadata of blind data: where they begin, and how many there are.
    pub blind_at: usize,
    pub blind_count: u32,
}

impl Head {
    /// Whether the grid holds points.
    pub fn has_points(&self) -> bool {
        POINT_CLASSES.contains(&self.class) || self.kind.name() == "PointIndex"
    }
}

/// Reads the head of the grid that begins where the cursor is, and ends where its bytes do.
pub(super) fn read(cursor: &Cursor<'_>) -> Result<Head, Error> {
    let at = cursor.at();
    let field = |offset: usize| cursor.moved_to(at + offset);
    let magic = field(0)?.array::<8>()?;
    if !is_nanovdb(&magic) {
        return Err(Error::invalid("the grid does not begin with NanoVDB's magic number").at(at));
    }
    let version = field(grid::VERSION)?.u32()?;
    container::check_version(version, at + grid::VERSION)?;
    let size = field(grid::SIZE)?.i64()?;
    if usize::try_from(size).ok() != Some(cursor.remaining()) {
        let what = format!("the grid gives its size as {size} bytes, not {}", cursor.remaining());
        return Err(Error::invalid(what).at(at + grid::SIZE));
    }
    let mut checksums = field(grid::CHECKSUM)?;
    let root = field(GRID_BYTES + tree::ROOT)?.i64()?;
    let root_at = usize::try_from(root)
        .ok()
        .filter(|root| *root >= TREE_BYTES && root.is_multiple_of(ALIGN))
        .and_then(|root| root.checked_add(at + GRID_BYTES))
        .filter(|root| *root <= cursor.end())
        .ok_or_else(|| {
            let what = format!("the root cannot be {root} bytes after the tree");
            Error::invalid(what).at(at + GRID_BYTES + tree::ROOT)
        })?;
    let blind = field(grid::BLIND_OFFSET)?.i64()?;
    let blind_count = field(grid::BLIND_COUNT)?.u32()?;
    let blind_at = usize::try_from(blind).ok().and_then(|blind| blind.checked_add(at));
    let blind_at = blind_at.filter(|blind| blind_count == 0 || *blind <= cursor.end());
    Ok(Head {
        kind: Kind(field(grid::TYPE)?.u32()?),
        class: field(grid::CLASS)?.u32()?,
        version,
        checksums: [checksums.u32()?, checksums.u32()?],
        transform: transform(cursor, at)?,
        at,
        root_at,
        blind_at: blind_at.ok_or_else(|| {
            let what = format!("blind data {blind} bytes after the start of the grid");
            Error::invalid(what).at(at + grid::BLIND_OFFSET)
        })?,
        blind_count,
    })
}

/// The map from index to world space: a matrix for column vectors, and a translation.
fn transform(cursor: &Cursor<'_>, at: usize) -> Result<Transform, Error> {
    let mut rows = cursor.moved_to(at + grid::MATRIX)?;
    let rows = [rows.dvec3()?, rows.dvec3()?, rows.dvec3()?];
    let translation: DVec3 = cursor.moved_to(at + grid::TRANSLATION)?.dvec3()?;
    let taper = cursor.moved_to(at + grid::TAPER)?.f64()?;
    if taper != 1.0 {
        let what = format!("a map with a taper of {taper}; save the grid with a linear map");
        return Err(Error::not_supported(what).at(at + grid::TAPER));
    }
    let matrix3 = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
    let invalid = || Error::invalid("the map is singular or not finite").at(at + grid::MATRIX);
    let affine = DAffine3 { matrix3, translation };
    let affine = Affine::from_linear(affine).ok_or_else(invalid)?;
    Transform { map: simplify(affine) }.checked().map_err(|error| error.at(at + grid::MATRIX))
}
