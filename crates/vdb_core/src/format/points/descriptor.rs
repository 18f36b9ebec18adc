//! The attributes of a leaf: their names, types and groups.

use std::collections::HashSet;

use super::codecs::GROUP;
use crate::display::quoted;
use crate::format::budget::Budget;
use crate::format::cursor::Cursor;
use crate::format::metadata::{self, write_sized};
use crate::points::PointGroup;
use crate::{Error, Metadata};

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
    let mut names = HashSet::new();
    for _ in 0..count {
        let at = cursor.at();
        let name = text(cursor, budget)?;
        let place = u64::from_le_bytes(cursor.array()?);
        let is_new = !name.is_empty() && names.insert(name.clone());
        let attribute = usize::try_from(place).ok().and_then(|place| attributes.get_mut(place));
        match attribute {
            Some(attribute) if attribute.name.is_empty() && is_new => {
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

/// Writes a descriptor, without default values of attributes.
pub(super) fn write(out: &mut Vec<u8>, descriptor: &Descriptor) -> Result<(), Error> {
    let Descriptor { attributes, groups } = descriptor;
    let number = |count: usize| (count as u64).to_le_bytes();
    if attributes.len() as u64 > MOST_ATTRIBUTES {
        let what =
            format!("{} attributes of points, and not up to {MOST_ATTRIBUTES}", attributes.len());
        return Err(Error::not_supported(what));
    }
    out.extend(number(attributes.len()));
    for attribute in attributes {
        write_sized(out, attribute.value_type.as_bytes())?;
        write_sized(out, attribute.codec.as_bytes())?;
    }
    for (place, attribute) in attributes.iter().enumerate() {
        write_sized(out, attribute.name.as_bytes())?;
        out.extend(number(place));
    }
    out.extend(number(groups.len()));
    for group in groups {
        let before = attributes[..group.attribute].iter().filter(|named| named.codec == GROUP);
        write_sized(out, group.name.as_bytes())?;
        let place = before.count() as u64 * GROUP_BITS + u64::from(group.bit);
        out.extend(place.to_le_bytes());
    }
    metadata::write(out, &Metadata::default())
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
