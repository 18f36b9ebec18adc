//! Leaves: floats, or codes between the least and the greatest value of a leaf.

use super::buffer::{put, put_all};
use super::statistics::Statistics;
use crate::Error;
use crate::nanovdb::layout::{Sizes, leaf, node};
use crate::nanovdb::options::NanoVdbValues;
use crate::tree::{CoordBox, LeafNode, Node};

type Leaf = LeafNode<f32, 3>;

/// The flag of a leaf with active values.
const HAS_BBOX: u8 = 2;

/// Bytes of a leaf.
pub(super) fn bytes(values: NanoVdbValues) -> usize {
    match values {
        NanoVdbValues::Float => Sizes::FLOAT.leaf_values() + Leaf::SIZE * 4,
        NanoVdbValues::Fp8 => leaf::CODES + Leaf::SIZE,
        NanoVdbValues::Fp16 => leaf::CODES + Leaf::SIZE * 2,
    }
}

/// Writes a leaf into its bytes, which are zeros, and returns what its active values are as they
/// are read again.
pub(super) fn write(
    out: &mut [u8],
    source: &Leaf,
    values: NanoVdbValues,
) -> Result<Statistics, Error> {
    let mut statistics = Statistics::NONE;
    // Faster than by way of the nodes' common interface, as a box is needed for every leaf.
    statistics.bbox = source.active_bbox();
    let bbox = statistics.bbox.unwrap_or(CoordBox::voxel(source.origin()));
    put_all(out, node::BBOX, bbox.min.to_array().map(i32::to_le_bytes));
    put(out, leaf::BBOX_SIZE, (bbox.max - bbox.min).to_array().map(|size| size as u8));
    put(out, leaf::FLAGS, [if statistics.bbox.is_some() { HAS_BBOX } else { 0 }]);
    let mask = source.value_mask();
    put_all(out, leaf::VALUE_MASK, mask.words().iter().map(|word| word.to_le_bytes()));
    let stored = source.values_slice();
    if values == NanoVdbValues::Float {
        mask.iter_on().for_each(|slot| statistics.add(stored[slot]));
        put_all(out, Sizes::FLOAT.leaf_values(), stored.iter().map(|value| value.to_le_bytes()));
        if !mask.is_empty() {
            put_all(out, leaf::AFTER_MASK, numbers(&statistics).map(f32::to_le_bytes));
        }
        return Ok(statistics);
    }
    let codes = Codes::of(stored, values).ok_or_else(|| {
        let at = source.origin();
        Error::not_supported(format!(
            "values around voxel {at} that are not finite or too far apart to be quantised; write \
             floats"
        ))
    })?;
    let code: Vec<u16> = stored.iter().map(|value| codes.code(*value)).collect();
    mask.iter_on().for_each(|slot| statistics.add(codes.value(code[slot])));
    put_all(out, leaf::AFTER_MASK, [codes.minimum, codes.quantum].map(f32::to_le_bytes));
    if !mask.is_empty() {
        let [min, max, average, deviation] = numbers(&statistics);
        // A deviation is no position in the range, but a length.
        let lengths = [min, max, average].map(|value| value - codes.minimum);
        let [min, max, average] = lengths.map(|length| codes.steps(length));
        let all = [min, max, average, codes.steps(deviation)];
        put_all(out, leaf::AFTER_MASK + 8, all.map(u16::to_le_bytes));
    }
    if values == NanoVdbValues::Fp8 {
        put_all(out, leaf::CODES, code.iter().map(|code| [*code as u8]));
    } else {
        put_all(out, leaf::CODES, code.iter().map(|code| code.to_le_bytes()));
    }
    Ok(statistics)
}

fn numbers(statistics: &Statistics) -> [f32; 4] {
    [statistics.min, statistics.max, statistics.average(), statistics.deviation()]
}

/// The codes of a leaf: multiples of a quantum above a minimum.
struct Codes {
    minimum: f32,
    quantum: f32,
    /// Codes per unit. In f64, as 16 bits leave f32 no room for rounding.
    encode: f64,
    most: f64,
}

impl Codes {
    /// `None` if the values have no finite range.
    fn of(values: &[f32], kind: NanoVdbValues) -> Option<Self> {
        let most: u16 = if kind == NanoVdbValues::Fp8 { 255 } else { u16::MAX };
        let mut range = (f32::INFINITY, f32::NEG_INFINITY);
        for &value in values {
            if !value.is_finite() {
                return None;
            }
            range = (range.0.min(value), range.1.max(value));
        }
        let (minimum, span) = (range.0, range.1 - range.0);
        let most = f64::from(most);
        let encode = if span > 0.0 { most / f64::from(span) } else { 0.0 };
        let quantum = span / most as f32;
        span.is_finite().then_some(Self { minimum, quantum, encode, most })
    }

    fn code(&self, value: f32) -> u16 {
        let length = f64::from(value) - f64::from(self.minimum);
        (length * self.encode + 0.5).min(self.most) as u16
    }

    /// The value of a code, in f32 as readers compute it.
    fn value(&self, code: u16) -> f32 {
        f32::from(code) * self.quantum + self.minimum
    }

    /// A length in quanta, rounded; 0 if the quantum is.
    fn steps(&self, length: f32) -> u16 {
        (length / self.quantum + 0.5) as u16
    }
}
