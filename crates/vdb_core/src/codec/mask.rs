//! Omission and restoration of inactive values (OpenVDB's `COMPRESS_ACTIVE_MASK`).

use crate::tree::Value;

/// The byte before a node's values that says which inactive values are stored.
///
/// "Background" is the background of the tree. Its negation is the interior value of a level set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum InactiveCase {
    /// None: there are no inactive values, or all are the background.
    Background = 0,
    /// None: all are the negated background.
    MinusBackground = 1,
    /// One, shared by all inactive slots.
    One = 2,
    /// None, but a selection mask: background where its bit is set, else negated background.
    MaskOfBackgrounds = 3,
    /// One and a selection mask: background where its bit is set, else the stored value.
    MaskOfBackgroundAndOne = 4,
    /// Two and a selection mask: the second value where its bit is set, else the first.
    MaskOfTwo = 5,
    /// All, in slot order among the active ones.
    All = 6,
}

impl InactiveCase {
    pub(crate) fn from_byte(byte: u8) -> Option<Self> {
        use InactiveCase::*;
        [
            Background,
            MinusBackground,
            One,
            MaskOfBackgrounds,
            MaskOfBackgroundAndOne,
            MaskOfTwo,
            All,
        ]
        .into_iter()
        .find(|case| *case as u8 == byte)
    }

    /// The number of inactive values stored after the byte.
    pub(crate) fn stored_values(self) -> usize {
        match self {
            Self::One | Self::MaskOfBackgroundAndOne => 1,
            Self::MaskOfTwo => 2,
            _ => 0,
        }
    }

    /// Whether a selection mask follows.
    pub(crate) fn has_mask(self) -> bool {
        matches!(self, Self::MaskOfBackgrounds | Self::MaskOfBackgroundAndOne | Self::MaskOfTwo)
    }
}

/// Moves the active values from the start of `values` to their slots, and fills the inactive slots:
/// with `inactive[1]` where `selection` has a bit set, else with `inactive[0]`.
///
/// `active` and `selection` have one bit per slot; `packed` is the number of bits set in `active`.
pub(crate) fn spread<T: Value>(
    values: &mut [T],
    packed: usize,
    active: &[u64],
    selection: impl Fn(usize) -> u64,
    inactive: [T; 2],
) {
    // From the last slot to the first: a value never moves to a lower slot, so none is overwritten
    // before it has moved.
    let mut next = packed;
    for (word, &bits) in active.iter().enumerate().rev() {
        let first = word * 64;
        let slots = 64.min(values.len() - first);
        let chosen = selection(word);
        if bits == 0 && chosen == 0 {
            values[first..first + slots].fill(inactive[0]);
        } else if bits == u64::MAX {
            next -= 64;
            values.copy_within(next..next + 64, first);
        } else {
            for slot in (0..slots).rev() {
                values[first + slot] = if bits >> slot & 1 == 1 {
                    next -= 1;
                    values[next]
                } else {
                    inactive[(chosen >> slot & 1) as usize]
                };
            }
        }
    }
}

/// Chooses the smallest case for a node, and returns it with the two values that it selects
/// between.
///
/// `inactive` yields the values of the inactive slots without children. Values are compared bit for
/// bit, so that `-0.0` and every NaN are restored exactly.
pub(crate) fn classify<T: Value>(
    inactive: impl IntoIterator<Item = T>,
    background: T,
    minus_background: T,
) -> (InactiveCase, [T; 2]) {
    let mut seen: [Option<T>; 2] = [None, None];
    for value in inactive {
        match seen {
            [Some(first), _] if first.same(value) => {}
            [_, Some(second)] if second.same(value) => {}
            [None, _] => seen[0] = Some(value),
            [_, None] => seen[1] = Some(value),
            _ => return (InactiveCase::All, [background; 2]),
        }
    }
    match seen {
        [Some(one), None] if one.same(minus_background) && !one.same(background) => {
            (InactiveCase::MinusBackground, [one, background])
        }
        [Some(one), None] if !one.same(background) => (InactiveCase::One, [one, background]),
        [Some(first), Some(second)] => {
            // The background comes second: set bits of the selection mask stand for it.
            let pair = if first.same(background) { [second, first] } else { [first, second] };
            let case = match pair {
                [_, second] if !second.same(background) => InactiveCase::MaskOfTwo,
                [first, _] if first.same(minus_background) => InactiveCase::MaskOfBackgrounds,
                _ => InactiveCase::MaskOfBackgroundAndOne,
            };
            (case, pair)
        }
        _ => (InactiveCase::Background, [background; 2]),
    }
}
