//! Transfer functions from the values of a grid to the optical properties of fog, and their
//! integrals for shaders.

/// The optical properties of fog at a value of a [`Ramp`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RampPoint {
    /// The extinction coefficient, per unit of length.
    pub extinction: f64,
    /// The scattering coefficient, which is the product of extinction and albedo, per unit of length.
    pub scattering: [f64; 3],
    /// The emission coefficient, in radiance per unit of length.
    pub emission: [f64; 3],
}

/// A point of a [`Ramp`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RampStop {
    /// The value of the grid.
    pub value: f32,
    /// The extinction coefficient, per unit of length.
    pub extinction: f32,
    /// The single-scattering albedo.
    pub albedo: [f32; 3],
    /// The emission coefficient, in radiance per unit of length.
    pub emission: [f32; 3],
}

/// A transfer function: extinction, albedo and emission are each linear between stops, and constant
/// beyond the first and last stops. Where two stops have the same value, the function jumps.
#[derive(Clone, Debug, PartialEq)]
pub struct Ramp {
    stops: Vec<RampStop>,
}

impl Ramp {
    /// A ramp with these stops, in any order; `None` if there are none, or if a number is not finite.
    pub fn new(mut stops: Vec<RampStop>) -> Option<Self> {
        let is_finite = |stop: &RampStop| {
            let colors = stop.albedo.iter().chain(&stop.emission);
            colors.chain([&stop.value, &stop.extinction]).all(|number| number.is_finite())
        };
        // Stable, so that two stops with the same value keep their order.
        stops.sort_by(|a, b| a.value.total_cmp(&b.value));
        (!stops.is_empty() && stops.iter().all(is_finite)).then_some(Self { stops })
    }

    /// The stops, by ascending value.
    pub fn stops(&self) -> &[RampStop] {
        &self.stops
    }

    /// The properties at a value; at a jump, the properties after it.
    pub fn at(&self, value: f64) -> RampPoint {
        let after = self.stops.partition_point(|stop| f64::from(stop.value) <= value);
        let high = self.stops[after.min(self.stops.len() - 1)];
        let low = self.stops[after.saturating_sub(1)];
        let width = f64::from(high.value) - f64::from(low.value);
        let part = if width > 0.0 { (value - f64::from(low.value)) / width } else { 0.0 };
        between(&low, &high, part.clamp(0.0, 1.0))
    }

    /// The largest extinction that values from 0 to `largest` have.
    pub fn largest_extinction(&self, largest: f32) -> f32 {
        let ends = self.pieces(largest).into_iter().flatten();
        ends.map(|(_, at)| at.extinction).fold(0.0, f64::max) as f32
    }

    /// Whether any value emits light.
    pub fn emits(&self) -> bool {
        self.stops.iter().flat_map(|stop| stop.emission).any(|emission| emission > 0.0)
    }

    /// The steepness of the ramp for values from 0 to `largest`: the greatest slope of extinction,
    /// scattering or emission, relative to the slope of a straight line from 0 to the greatest value of
    /// that property. At least 1; 50 for a peak that rises within a fiftieth of the values; infinite for
    /// a jump.
    pub fn steepness(&self, largest: f32) -> f32 {
        let pieces = self.pieces(largest);
        let mut most = [0.0_f64; 2];
        for (k, number) in
            pieces.iter().flatten().flat_map(|(_, at)| numbers(at).into_iter().enumerate())
        {
            most[usize::from(k > 3)] = most[usize::from(k > 3)].max(number);
        }
        let mut steepest = 1.0_f64;
        for [(low, begin), (high, end)] in pieces {
            let ends = numbers(&begin).into_iter().zip(numbers(&end));
            for (k, (begin, end)) in ends.enumerate().filter(|(_, (begin, end))| begin != end) {
                let part = (end - begin).abs() / most[usize::from(k > 3)];
                steepest = steepest.max(part * f64::from(largest) / (high - low));
            }
        }
        steepest as f32
    }

    /// The ends of all intervals between stops, for values from 0 to `largest`.
    fn pieces(&self, largest: f32) -> Vec<[(f64, RampPoint); 2]> {
        let (first, last) = (self.stops[0], self.stops[self.stops.len() - 1]);
        let beyond = [RampStop { value: f32::MIN, ..first }, RampStop { value: f32::MAX, ..last }];
        let all = [&beyond[..1], &self.stops, &beyond[1..]].concat();
        let pairs =
            all.array_windows().filter(|[low, high]| low.value <= largest && high.value >= 0.0);
        pairs
            .map(|[low, high]| {
                let [from, to] = [low.value, high.value].map(f64::from);
                [(from, 0.0), (to, 1.0)].map(|(end, part)| {
                    let at = end.clamp(0.0, f64::from(largest.max(0.0)));
                    let part = if from < to { (at - from) / (to - from) } else { part };
                    (at, between(low, high, part))
                })
            })
            .collect()
    }

    /// The differences of the properties between the ends of an interval in which they are linear; 0 if
    /// the interval contains a stop. Around the mean in the middle, no property becomes negative.
    fn slope(&self, low: f64, high: f64, mean: &[f64; 7]) -> [f64; 7] {
        if self.stops.iter().any(|stop| low < f64::from(stop.value) && f64::from(stop.value) < high)
        {
            return [0.0; 7];
        }
        // Just inside, because the properties may jump at the ends.
        let nearly = |end: f64| end + 1e-9 * (0.5 * (low + high) - end);
        let [begin, end] = [low, high].map(|end| numbers(&self.at(nearly(end))));
        [0, 1, 2, 3, 4, 5, 6].map(|k| (end[k] - begin[k]).clamp(-2.0 * mean[k], 2.0 * mean[k]))
    }

    /// The integral of the properties over an interval of values. Simpson's rule is exact for the
    /// product of two linear functions.
    fn integral(&self, low: f64, high: f64) -> [f64; 7] {
        let cuts = self.stops.iter().map(|stop| f64::from(stop.value));
        let cuts = cuts.filter(|cut| low < *cut && *cut < high);
        let ends: Vec<f64> = std::iter::once(low).chain(cuts).chain([high]).collect();
        let mut sum = [0.0; 7];
        for pair in ends.windows(2).filter(|pair| pair[0] < pair[1]) {
            let width = pair[1] - pair[0];
            // Just inside, because the properties may jump at the ends.
            let nearly = |end: f64| end + 1e-12 * (0.5 * (pair[0] + pair[1]) - end);
            let points = [nearly(pair[0]), 0.5 * (pair[0] + pair[1]), nearly(pair[1])];
            for (at, weight) in points.into_iter().zip([1.0, 4.0, 1.0]) {
                let numbers = numbers(&self.at(at));
                for (sum, number) in sum.iter_mut().zip(numbers) {
                    *sum += weight * width / 6.0 * number;
                }
            }
        }
        sum
    }
}

/// The properties between two stops.
fn between(low: &RampStop, high: &RampStop, part: f64) -> RampPoint {
    let mix = |a: f32, b: f32| f64::from(a) + part * (f64::from(b) - f64::from(a));
    let extinction = mix(low.extinction, high.extinction);
    let colors = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|i| mix(a[i], b[i]));
    RampPoint {
        extinction,
        scattering: colors(low.albedo, high.albedo).map(|albedo| extinction * albedo),
        emission: colors(low.emission, high.emission),
    }
}

/// Scattering, extinction and emission, as in a [`RampTable`].
fn numbers(optics: &RampPoint) -> [f64; 7] {
    let ([r, g, b], [x, y, z]) = (optics.scattering, optics.emission);
    [r, g, b, optics.extinction, x, y, z]
}

/// A [`Ramp`] integrated in advance, for shaders.
///
/// Between two points of a ray, the value of a grid is nearly linear, so the mean of a property over
/// the stretch is its mean over the values in between: a difference of two integrals, however narrow
/// the peaks that the stretch crosses. (K. Engel, M. Kraus and T. Ertl, "High-quality pre-integrated
/// volume rendering using hardware-accelerated pixel shading", 2001, section 4.2.) The range of the
/// stops is divided into [`ENTRIES`](Self::ENTRIES) equal entries, each of which has the exact means
/// of its properties. Within an entry, they are assumed to be linear or, if there is a stop inside,
/// constant. One more entry on each side stands for all values beyond.
///
/// Twin: `assets/shaders/traversal/ramps.wgsl`.
#[derive(Clone, Debug, PartialEq)]
pub struct RampTable {
    /// The value at which the first entry begins.
    pub low: f32,
    /// Entries per unit of value.
    pub entries_per_value: f32,
    rows: Vec<[f32; 4]>,
}

impl RampTable {
    /// The number of entries between the first and the last stop.
    pub const ENTRIES: u32 = 1024;
    /// The number of texels in a row: all entries.
    pub const WIDTH: u32 = Self::ENTRIES + 2;
    /// The number of rows.
    pub const ROWS: u32 = 6;

    /// Integrates a ramp.
    pub fn new(ramp: &Ramp) -> Self {
        let (first, last) = (ramp.stops[0], ramp.stops[ramp.stops.len() - 1]);
        let low = f64::from(first.value);
        // Stops that all have one value are a jump, in a range of some width.
        let least = (low.abs() * 1e-3).max(1e-6);
        let step = (f64::from(last.value) - low).max(least) / f64::from(Self::ENTRIES);
        let point = |stop: &RampStop| numbers(&between(stop, stop, 0.0));
        let inner = (0..Self::ENTRIES).map(|i| {
            let begin = low + f64::from(i) * step;
            ramp.integral(begin, begin + step).map(|integral| integral / step)
        });
        let means: Vec<[f64; 7]> =
            std::iter::once(point(&first)).chain(inner).chain([point(&last)]).collect();
        let slopes: Vec<[f64; 7]> = (0..Self::WIDTH)
            .zip(&means)
            .map(|(entry, mean)| {
                let begin = low + (f64::from(entry) - 1.0) * step;
                ramp.slope(begin, begin + step, mean)
            })
            .collect();
        let mut sums = vec![[0.0; 7]];
        for (i, mean) in means.iter().enumerate() {
            let before = sums[i];
            // The entry below the range ends where the first one begins: at 0.
            let mean = if i == 0 { [0.0; 7] } else { *mean };
            sums.push([0, 1, 2, 3, 4, 5, 6].map(|k| before[k] + mean[k]));
        }
        let scattering = |n: &[f64; 7]| [n[0], n[1], n[2], n[3]].map(|n| n as f32);
        let emission = |n: &[f64; 7]| [n[4], n[5], n[6], 0.0].map(|n| n as f32);
        let sums = &sums[..means.len()];
        let all = [&means[..], sums, &slopes[..]];
        let rows = all
            .iter()
            .flat_map(|row| row.iter().map(scattering))
            .chain(all.iter().flat_map(|row| row.iter().map(emission)))
            .collect();
        Self { low: first.value, entries_per_value: (1.0 / step) as f32, rows }
    }

    /// [`ROWS`](Self::ROWS) rows of [`WIDTH`](Self::WIDTH) texels: means of scattering and extinction
    /// over each entry, sums of the means of all entries before it, and differences between the end
    /// and the beginning of each entry; then the same for emission.
    pub fn rows(&self) -> &[[f32; 4]] {
        &self.rows
    }

    /// Means of scattering (red, green, blue), extinction and emission over the values between two,
    /// as shaders compute them.
    pub fn means(&self, from: f32, to: f32) -> [f32; 7] {
        let position = |value: f32| {
            ((value - self.low) * self.entries_per_value).clamp(-1e7, Self::ENTRIES as f32 + 1e7)
        };
        let (a, b) = (position(from), position(to));
        let (low, high) = (a.min(b), a.max(b));
        let entry = |x: f32| (x.floor() + 1.0).clamp(0.0, Self::ENTRIES as f32 + 1.0) as usize;
        let (first, last) = (entry(low), entry(high));
        // The mean over a part of an entry whose middle is at `at`, from -0.5 to 0.5.
        let mean = |entry: usize, at: f32| {
            let (mean, slope) = (self.numbers(0, entry), self.numbers(2, entry));
            [0, 1, 2, 3, 4, 5, 6].map(|k| mean[k] + at * slope[k])
        };
        if first == last {
            return mean(first, 0.5 * (low + high) - (first as f32 - 0.5));
        }
        let (before, after) = (first as f32 - low, high - (last as f32 - 1.0));
        let (near, far) = (mean(first, 0.5 - 0.5 * before), mean(last, 0.5 * after - 0.5));
        let (begin, end) = (self.numbers(1, first + 1), self.numbers(1, last));
        [0, 1, 2, 3, 4, 5, 6]
            .map(|k| (before * near[k] + (end[k] - begin[k]) + after * far[k]) / (high - low))
    }

    fn numbers(&self, row: usize, entry: usize) -> [f32; 7] {
        let at = |row: usize| self.rows[row * Self::WIDTH as usize + entry];
        let ([r, g, b, extinction], [x, y, z, _]) = (at(row), at(row + 3));
        [r, g, b, extinction, x, y, z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop(value: f32, extinction: f32, albedo: [f32; 3], red: f32) -> RampStop {
        RampStop { value, extinction, albedo, emission: [red, 0.0, 0.0] }
    }

    /// Thin shells of two colours, a jump, and a slope that stays.
    fn shells() -> Ramp {
        let [red, blue] = [[1.0, 0.0, 0.1], [0.0, 0.2, 1.0]];
        let stops = vec![
            stop(2.0, 0.5, red, 0.0),
            stop(-1.0, 0.0, red, 0.0),
            stop(0.1, 0.0, red, 0.0),
            stop(0.1003, 90.0, red, 7.0),
            stop(0.1006, 0.0, blue, 0.0),
            stop(1.5, 0.0, blue, 0.0),
            stop(1.5, 3.0, blue, 1.0),
        ];
        Ramp::new(stops).unwrap()
    }

    #[test]
    fn a_ramp_is_linear_between_its_stops() {
        let ramp = shells();
        assert_eq!(ramp.at(-9.0), ramp.at(-1.0));
        assert_eq!(ramp.at(99.0).extinction, 0.5);
        let middle = ramp.at(1.75);
        assert!((middle.extinction - 1.75).abs() < 1e-6, "{middle:?}");
        assert!((middle.scattering[0] - 1.75 * 0.5).abs() < 1e-6, "{middle:?}");
        assert!((middle.emission[0] - 0.5).abs() < 1e-6, "{middle:?}");
        assert_eq!((ramp.at(1.499_999).extinction, ramp.at(1.5).extinction), (0.0, 3.0));
        assert!(Ramp::new(Vec::new()).is_none());
        assert!(Ramp::new(vec![stop(0.0, f32::NAN, [1.0; 3], 0.0)]).is_none());
    }

    #[test]
    fn means_of_the_table_are_those_of_the_ramp_over_whatever_it_crosses() {
        let ramp = shells();
        let table = RampTable::new(&ramp);
        let step = 3.0 / f64::from(RampTable::ENTRIES);
        let largest = numbers(&RampPoint { extinction: 90.0, ..ramp.at(0.1003) });
        for (from, to) in [
            (-1.0, 2.0),
            (0.0, 0.5),
            (0.5, 0.0),
            (0.05, 0.15),
            (-5.0, 0.05),
            (1.2, 40.0),
            (-300.0, 300.0),
            (1.0, 1.4),
            (1.6, 1.6002),
        ] {
            let exact = ramp.integral(f64::min(from, to), f64::max(from, to));
            let width = f64::abs(to - from);
            let found = table.means(from as f32, to as f32);
            for (k, (exact, found)) in exact.iter().zip(found).enumerate() {
                // Within the entries of both ends, properties may be taken for constant: each may be
                // wrong by at most what an entry has of the tallest peak, in an entry's width.
                let peak = largest[k].max(3.0).min(90.0 * 0.000_3 / step);
                let bound = (2.0 * step * peak).min(width * peak) / width + 1e-5 * peak;
                let off = (exact / width - f64::from(found)).abs();
                assert!(off <= bound, "{k} from {from} to {to}: {found}, {}", exact / width);
            }
        }
        // The whole of the shell: half of its height times its width.
        let shell = f64::from(table.means(0.05, 0.15)[3]) * 0.1;
        assert!((shell / (0.5 * 90.0 * 0.000_6) - 1.0).abs() < 1e-3, "{shell}");
        let all = [f32::MIN, -1e30, 0.0, 1e30, f32::MAX];
        for from in all {
            assert!(all.iter().all(|to| table.means(from, *to).iter().all(|n| n.is_finite())));
        }
    }

    /// Empty space with the value of the first stop stays empty.
    #[test]
    fn between_stops_a_mean_is_exact() {
        let ramp = Ramp::new(vec![
            stop(0.0, 0.0, [0.5; 3], 0.0),
            stop(0.35, 0.6, [0.5; 3], 4.0),
            stop(1.0, 3.0, [1.0, 0.0, 0.0], 0.0),
        ]);
        let ramp = ramp.unwrap();
        let table = RampTable::new(&ramp);
        assert_eq!(table.means(0.0, 0.0), [0.0; 7]);
        for i in 0..1000_u16 {
            let value = (f32::from(i) + 0.5) / 1000.0;
            let (found, exact) = (table.means(value, value), numbers(&ramp.at(f64::from(value))));
            for (found, exact) in found.into_iter().zip(exact) {
                // The product with an albedo is a parabola, 3·0.65⁻² (v - v₀)² at most, and an entry with
                // a stop is constant, with slopes up to 4/0.35.
                let bound = if (value - 0.35).abs() < 0.001 { 0.012 } else { 2e-5 };
                assert!((f64::from(found) - exact).abs() < bound, "{value}: {found}, not {exact}");
            }
        }
    }

    #[test]
    fn steepness_and_extinction_are_those_of_the_values_that_there_are() {
        let line = Ramp::new(vec![stop(0.0, 0.0, [1.0; 3], 0.0), stop(1.0, 1.0, [1.0; 3], 0.0)]);
        let line = line.unwrap();
        for (largest, extinction) in [(1.0, 1.0), (0.25, 0.25), (0.0, 0.0)] {
            assert_eq!(line.steepness(largest), 1.0, "{largest}");
            assert_eq!(line.largest_extinction(largest), extinction);
        }
        // Beyond the last stop, the line is constant: it takes a quarter of the values.
        assert_eq!((line.steepness(4.0), line.largest_extinction(4.0)), (4.0, 1.0));

        let shells = shells();
        let steepest = 1.0 / 0.000_3;
        assert!((shells.steepness(1.0) / steepest - 1.0).abs() < 1e-3, "{}", shells.steepness(1.0));
        assert!((shells.largest_extinction(1.0) - 90.0).abs() < 1e-4);
        assert_eq!((shells.steepness(0.09), shells.largest_extinction(0.09)), (1.0, 0.0));
        assert_eq!(shells.steepness(1.6), f32::INFINITY, "a jump");
        let glow =
            |red| Ramp::new(vec![stop(0.0, 1.0, [1.0; 3], 0.0), stop(0.1, 1.0, [1.0; 3], red)]);
        assert_eq!(glow(0.0).unwrap().steepness(1.0), 1.0);
        assert!((glow(5.0).unwrap().steepness(1.0) - 10.0).abs() < 1e-3);
    }

    #[test]
    fn stops_at_one_value_are_a_jump() {
        let ramp = Ramp::new(vec![stop(5.0, 1.0, [0.5; 3], 0.0), stop(5.0, 3.0, [0.5; 3], 0.0)]);
        let table = RampTable::new(&ramp.unwrap());
        assert_eq!((table.means(0.0, 4.0)[3], table.means(6.0, 9.0)[3]), (1.0, 3.0));
        let mean = table.means(0.0, 10.0)[3];
        assert!((mean - 2.0).abs() < 1e-3, "{mean}");
    }
}
