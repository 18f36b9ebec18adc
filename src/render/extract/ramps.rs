//! The ramps of volumes, integrated for the shaders.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use bevy::prelude::*;
use vdb_core::{Ramp, RampStop, RampTable};

use crate::VdbRamp;

/// The largest extinction and the largest value of a ramp: products with lengths stay within f32.
const MAX_EXTINCTION: f32 = 1e15;
/// The largest albedo and emission coefficient.
const MAX_ALBEDO: f32 = 1e6;
const MAX_EMISSION: f32 = 1e15;
/// The most ramps at once: as many as fit below WebGPU's default limit of a texture's height.
const MOST: usize = 8192 / RampTable::ROWS as usize;

/// A ramp for the shaders.
#[derive(Debug)]
pub(crate) struct ExtractedRamp {
    source: VdbRamp,
    pub table: RampTable,
    pub ramp: Ramp,
    /// Whether a number was replaced.
    pub is_changed: bool,
    /// Identifies the ramp by what it is.
    pub content: u64,
}

impl ExtractedRamp {
    fn new(source: &VdbRamp) -> Option<Self> {
        let mut is_changed = false;
        let mut sound = |x: f32, least: f32, most: f32| {
            let valid = if x.is_nan() { 0.0 } else { x.clamp(least, most) };
            is_changed |= valid != x;
            valid
        };
        let mut stops = Vec::with_capacity(source.stops.len());
        for stop in &source.stops {
            let colors = |color: LinearRgba| [color.red, color.green, color.blue];
            stops.push(RampStop {
                value: sound(stop.value, -MAX_EXTINCTION, MAX_EXTINCTION),
                extinction: sound(stop.extinction, 0.0, MAX_EXTINCTION),
                albedo: colors(stop.color.to_linear()).map(|c| sound(c, 0.0, MAX_ALBEDO)),
                emission: colors(stop.emission).map(|c| sound(c, 0.0, MAX_EMISSION)),
            });
        }
        let ramp = Ramp::new(stops)?;
        let table = RampTable::new(&ramp);
        let mut hasher = DefaultHasher::new();
        bytemuck::cast_slice::<_, u8>(table.rows()).hash(&mut hasher);
        [table.low, table.entries_per_value].map(f32::to_bits).hash(&mut hasher);
        Some(Self { source: source.clone(), ramp, table, is_changed, content: hasher.finish() })
    }
}

/// A ramp of a volume, and its place among all.
#[derive(Clone, Debug)]
pub(crate) struct VolumeRamp {
    pub ramp: Arc<ExtractedRamp>,
    /// From 1.
    pub number: u32,
}

/// All different ramps of fogs that are not hidden.
#[derive(Debug, Default, Resource)]
pub(crate) struct ExtractedRamps {
    pub all: Vec<Arc<ExtractedRamp>>,
    /// Those of the previous frame.
    before: Vec<Arc<ExtractedRamp>>,
}

impl ExtractedRamps {
    pub fn begin_frame(&mut self) {
        self.before = std::mem::take(&mut self.all);
    }

    /// Adds the ramp of a volume. `None` if it has no stops, or if there are too many ramps.
    pub fn add(&mut self, source: &VdbRamp) -> Option<VolumeRamp> {
        let is_same = |own: &Arc<ExtractedRamp>| own.source == *source;
        let place = self.all.iter().position(is_same);
        let place = match place {
            Some(place) => place,
            None if self.all.len() == MOST => {
                warn_once!(
                    "fogs have more than {MOST} different ramps: the others are shown without"
                );
                return None;
            }
            None => {
                let known = self.before.iter().find(|own| is_same(own)).cloned();
                let ramp = known.or_else(|| ExtractedRamp::new(source).map(Arc::new))?;
                self.all.push(ramp);
                self.all.len() - 1
            }
        };
        Some(VolumeRamp { ramp: self.all[place].clone(), number: place as u32 + 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::VdbRampStop;

    #[test]
    fn equal_ramps_are_integrated_once() {
        let mut ramps = ExtractedRamps::default();
        let other = VdbRamp::new([VdbRampStop { extinction: 3.0, ..default() }]);
        let frame = |ramps: &mut ExtractedRamps| {
            ramps.begin_frame();
            let all = [VdbRamp::default(), other.clone(), VdbRamp::default()];
            all.map(|ramp| ramps.add(&ramp).unwrap())
        };
        let first = frame(&mut ramps);
        assert_eq!(first.each_ref().map(|own| own.number), [1, 2, 1]);
        let second = frame(&mut ramps);
        assert!(Arc::ptr_eq(&first[1].ramp, &second[1].ramp));
        assert_ne!(first[0].ramp.content, first[1].ramp.content);
        assert!(ramps.add(&VdbRamp::new([])).is_none());
    }

    #[test]
    fn numbers_that_make_no_sense_are_replaced() {
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            let stop = VdbRampStop { extinction: bad, ..default() };
            let ramp = ExtractedRamp::new(&VdbRamp::new([stop])).unwrap();
            assert!(ramp.is_changed && ramp.ramp.largest_extinction(1.0) >= 0.0, "{bad}");
            assert!(ramp.table.rows().iter().flatten().all(|number| number.is_finite()), "{bad}");
        }
        assert!(!ExtractedRamp::new(&VdbRamp::default()).unwrap().is_changed);
    }
}
