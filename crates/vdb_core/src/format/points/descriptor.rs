//! The attributes of a leaf: their names, types and groups.

use super::codecs::GROUP;
use crate::Error;
use crate::display::quoted;
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::metadata;
use crate::points::PointGroup;

/// The most attributes of a grid: the number of passes has 16 bits, and each attribute has two.
const MOST_ATTRIBUTES: u64 = (u16::MAX as u64 - 4) / 2;

/// Groups whose membership is in one attribute.
const GROUP_BITS: u64 = 8;

/// The attributes of a leaf, in the order of its arrays.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Descriptor {
    pub attributes: Vec<Named>,
    pub groups: Vec<PointGroup>,
}

/// An attribute.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Named {
    pub name: String,
    pub value_type: String,
    pub codec: String,
}

/// Reads a descriptor.
pub(super) fn read(cursor: &mut Cursor<'_>, budget: &mut Budget<'_>) -> Result<Descriptor, Error> {
    let at = cursor.at();
    let count = u64::from_le_bytes(cursor.array()?);
    if count > MOST_ATTRIBUTES {
        let what = format!("the points have {count} attributes, and {MOST_ATTRIBUTES} at most");
        return Err(Error::invalid(what).at(at));
    }
    budget.add_entries(count as u32).map_err(|error| error.at(at))?;
    let mut attributes = Vec::new();
    for _ in 0..count {
        let (value_type, codec) = (text(cursor, budget)?, text(cursor, budget)?);
        attributes.push(Named { name: String::new(), value_type, codec });
    }
    for _ in 0..count {
        let at = cursor.at();
        let name = text(cursor, budget)?;
        let place = u64::from_le_bytes(cursor.array()?);
        let attribute = usize::try_from(place).ok().and_then(|place| attributes.get_mut(place));
        match attribute {
            Some(attribute) if attribute.name.is_empty() && !name.is_empty() => {
                attribute.name = name;
            }
            _ => {
                let name = quoted(&name).to_string();
                let what = format!("{name} cannot be the name of attribute {place} of {count}");
                return Err(Error::invalid(what).at(at));
            }
        }
    }
    let groups = read_groups(cursor, budget, &attributes)?;
    // Default values of attributes, and the texts of those that are strings.
    metadata::read(cursor, budget)?;
    Ok(Descriptor { attributes, groups })
}

fn read_groups(
    cursor: &mut Cursor<'_>,
    budget: &mut Budget<'_>,
    attributes: &[Named],
) -> Result<Vec<PointGroup>, Error> {
    let of_groups: Vec<usize> =
        (0..attributes.len()).filter(|&i| attributes[i].codec == GROUP).collect();
    let at = cursor.at();
    let count = u64::from_le_bytes(cursor.array()?);
    let most = of_groups.len() as u64 * GROUP_BITS;
    if count > most {
        let what = format!("the points have {count} groups, and attributes for {most}");
        return Err(Error::invalid(what).at(at));
    }
    budget.add_entries(count as u32).map_err(|error| error.at(at))?;
    let mut groups = Vec::new();
    for _ in 0..count {
        let at = cursor.at();
        let name = text(cursor, budget)?;
        let place = u64::from_le_bytes(cursor.array()?);
        if place >= most {
            let what = format!("group {place} of points, which have attributes for {most}");
            return Err(Error::invalid(what).at(at));
        }
        let attribute = of_groups[(place / GROUP_BITS) as usize];
        groups.push(PointGroup { name, attribute, bit: (place % GROUP_BITS) as u8 });
    }
    Ok(groups)
}

fn text(cursor: &mut Cursor<'_>, budget: &mut Budget<'_>) -> Result<String, Error> {
    let at = cursor.at();
    let bytes = cursor.sized_bytes(budget.limits)?;
    budget.add_text(bytes.len()).map_err(|error| error.at(at))?;
    Ok(String::from_utf8_lossy(bytes).into_owned())
}
