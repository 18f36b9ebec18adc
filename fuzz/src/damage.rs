//! Damage to the bytes of a file, aimed at those that control a reader.

use arbitrary::{Result, Unstructured};

/// Damages a few places of a file: numbers, pieces or names.
pub(super) fn damage(bytes: &mut Vec<u8>, choices: &mut Unstructured) -> Result<()> {
    for _ in 0..choices.int_in_range(1..=6)? {
        if bytes.is_empty() {
            return Ok(());
        }
        let at = place(bytes, choices)?;
        match choices.int_in_range(0..=7)? {
            0..=2 => {
                let length = 1 << choices.int_in_range(0..=3)?;
                let Some(place) = bytes.get_mut(at..at + length) else { continue };
                let mut old = [0; 8];
                old[..length].copy_from_slice(place);
                let new = nasty(choices, u64::from_le_bytes(old))?;
                place.copy_from_slice(&new.to_le_bytes()[..length]);
            }
            3 => bytes[at] ^= 1 << choices.int_in_range(0..=7)?,
            4 => {
                let end = (at + choices.int_in_range(1..=600)?).min(bytes.len());
                bytes.drain(at..end);
            }
            5 => {
                let from = place(bytes, choices)?;
                let end = (from + choices.int_in_range(1..=600)?).min(bytes.len());
                let piece = bytes[from..end].to_vec();
                bytes.splice(at..at, piece);
            }
            _ => rename(bytes, choices)?,
        }
    }
    Ok(())
}

/// A position near the start, near the end, or anywhere: most bytes in the middle are masks.
fn place(bytes: &[u8], choices: &mut Unstructured) -> Result<usize> {
    let last = bytes.len() - 1;
    Ok(match choices.int_in_range(0..=2)? {
        0 => choices.int_in_range(0..=2047)?.min(last),
        1 => last - choices.int_in_range(0..=1023)?.min(last),
        _ => choices.int_in_range(0..=last)?,
    })
}

/// A number of the kind that breaks readers.
pub(super) fn nasty(choices: &mut Unstructured, old: u64) -> Result<u64> {
    Ok(match choices.int_in_range(0..=9)? {
        0 => 0,
        1 => u64::MAX,
        2 => i64::MIN as u64,
        3 => i64::MAX as u64,
        4 => u64::from(u32::MAX),
        5 => old.wrapping_add(1),
        6 => old.wrapping_sub(1),
        7 => old.wrapping_neg(),
        8 => 1 << choices.int_in_range(0..=63)?,
        _ => choices.arbitrary()?,
    })
}

/// Replaces a string of the file by another of the same length: an instance gets another parent, a
/// parent becomes an instance, or a tree gets another type.
fn rename(bytes: &mut [u8], choices: &mut Unstructured) -> Result<()> {
    let texts: Vec<(usize, usize)> = (0..bytes.len().saturating_sub(4).min(4096))
        .filter_map(|at| {
            let length = u32::from_le_bytes(bytes[at..at + 4].try_into().ok()?) as usize;
            let text = bytes.get(at + 4..at + 4 + length)?;
            let is_text =
                (1..32).contains(&length) && text.iter().all(|b| (0x1e..0x7f).contains(b));
            is_text.then_some((at + 4, length))
        })
        .collect();
    if texts.is_empty() {
        return Ok(());
    }
    let (to, length) = *choices.choose(&texts)?;
    let alike: Vec<_> = texts.iter().filter(|text| text.1 == length).collect();
    let (from, _) = **choices.choose(&alike)?;
    bytes.copy_within(from..from + length, to);
    Ok(())
}
