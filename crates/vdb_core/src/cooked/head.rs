//! The description of a grid in a cooked file.

use glam::IVec3;

use super::error::CookedError;
use super::grid::CookedGrid;
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::metadata::write_sized;
use crate::format::{metadata, transform};
use crate::pack::PackKind;
use crate::pack::checked;
use crate::pack::sections::Outline;
use crate::tree::CoordBox;
use crate::{Error, GridClass, Metadata, Transform};

/// The version of VDB files whose transforms cooked files have.
const TRANSFORM_VERSION: u32 = 224;

/// The classes by number.
const CLASSES: [GridClass; 4] =
    [GridClass::Unknown, GridClass::LevelSet, GridClass::FogVolume, GridClass::Staggered];

/// The description of a grid.
pub(super) struct Head {
    pub name: String,
    pub class: GridClass,
    pub transform: Transform,
    pub metadata: Metadata,
    pub outline: Outline,
    /// Whether samples are stored as bricks' own leaves.
    pub is_leaves: bool,
}

/// Appends the description of a grid.
pub(super) fn write(
    grid: &CookedGrid,
    outline: &Outline,
    is_leaves: bool,
    out: &mut Vec<u8>,
) -> Result<(), Error> {
    write_sized(out, grid.name.as_bytes())?;
    let class = CLASSES.iter().position(|class| *class == grid.class).unwrap_or(0);
    let (kind, iso) = match outline.kind {
        PackKind::Surface { iso } => (0, iso),
        PackKind::Smooth { iso } => (1, iso),
        PackKind::Fog => (2, 0.0),
    };
    out.extend([class as u8, kind, u8::from(is_leaves), u8::from(outline.occupied.is_some())]);
    transform::write(out, &grid.transform)?;
    metadata::write(out, &grid.metadata)?;
    for float in [iso, outline.majorant, outline.scale] {
        out.extend(float.to_le_bytes());
    }
    let occupied = outline.occupied.unwrap_or(CoordBox::voxel(IVec3::ZERO));
    for vector in [outline.base, outline.top_origin, occupied.min, occupied.max] {
        out.extend(vector.to_array().map(i32::to_le_bytes).as_flattened());
    }
    let Outline { top_levels, format, top_nodes, lower_nodes, leaves, records, .. } = *outline;
    let Outline { sample_words, palette, .. } = *outline;
    let numbers =
        [top_levels, format, top_nodes, lower_nodes, leaves, records, sample_words, palette];
    out.extend(numbers.map(u32::to_le_bytes).as_flattened());
    Ok(())
}

/// Reads the description of a grid and checks all that does not depend on its words.
pub(super) fn read(cursor: &mut Cursor, budget: &mut Budget) -> Result<Head, CookedError> {
    let name = cursor.string(budget.limits)?;
    budget.add_text(name.len())?;
    read_named(cursor, budget, &name).map_err(|error| error.in_grid(&name))
}

fn read_named(cursor: &mut Cursor, budget: &mut Budget, name: &str) -> Result<Head, CookedError> {
    let [class, kind, is_leaves, is_occupied] = cursor.array()?;
    if is_leaves > 1 || is_occupied > 1 {
        return Err(CookedError::damaged("a flag is neither 0 nor 1"));
    }
    let class = CLASSES.get(usize::from(class));
    let class = *class.ok_or_else(|| CookedError::damaged("the class is not known"))?;
    let transform = transform::read(cursor, TRANSFORM_VERSION, budget.limits)?;
    let metadata = metadata::read(cursor, budget)?;
    let mut float = || cursor.u32().map(f32::from_bits);
    let [iso, majorant, scale] = [float()?, float()?, float()?];
    let kind = match kind {
        0 => PackKind::Surface { iso },
        1 => PackKind::Smooth { iso },
        2 => PackKind::Fog,
        _ => return Err(CookedError::damaged("the kind is not known")),
    };
    let (base, top_origin) = (cursor.ivec3()?, cursor.ivec3()?);
    let occupied = CoordBox { min: cursor.ivec3()?, max: cursor.ivec3()? };
    let outline = Outline {
        kind,
        base,
        occupied: (is_occupied == 1).then_some(occupied),
        majorant,
        top_origin,
        top_levels: cursor.u32()?,
        format: cursor.u32()?,
        scale,
        top_nodes: cursor.u32()?,
        lower_nodes: cursor.u32()?,
        leaves: cursor.u32()?,
        records: cursor.u32()?,
        sample_words: cursor.u32()?,
        palette: cursor.u32()?,
    };
    checked::check_outline(&outline).map_err(CookedError::damaged)?;
    let (name, is_leaves) = (name.to_owned(), is_leaves == 1);
    Ok(Head { name, class, transform, metadata, outline, is_leaves })
}
