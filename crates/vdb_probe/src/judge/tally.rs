//! Totals over many rays, in little memory: a long run has a billion.

/// Numbers from 0 up, kept as a histogram of 32 bins an octave, and their exact maximum.
#[derive(Clone, Debug)]
pub struct Errors {
    bins: Vec<u64>,
    count: u64,
    max: f64,
}

/// log₂ of the smallest number that is told from zero.
const LOWEST: i32 = -100;
/// Octaves of the histogram.
const OCTAVES: usize = 160;
const BINS_PER_OCTAVE: usize = 32;

impl Default for Errors {
    fn default() -> Self {
        Self { bins: vec![0; OCTAVES * BINS_PER_OCTAVE], count: 0, max: 0.0 }
    }
}

impl Errors {
    /// Adds a number; one that is not a number counts as infinite.
    pub fn add(&mut self, x: f64) {
        let x = if x.is_nan() { f64::INFINITY } else { x };
        self.count += 1;
        self.max = self.max.max(x);
        // The exponent and the first five bits of the mantissa number the bins.
        let first = (1023 + LOWEST as i64) << 5;
        let bin = (x.to_bits() >> 47) as i64 - first;
        self.bins[bin.clamp(0, (OCTAVES * BINS_PER_OCTAVE - 1) as i64) as usize] += 1;
    }

    /// Adds those of another.
    pub fn merge(&mut self, other: &Self) {
        self.bins.iter_mut().zip(&other.bins).for_each(|(own, other)| *own += other);
        self.count += other.count;
        self.max = self.max.max(other.max);
    }

    /// How many there are.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The greatest; 0, if there are none.
    pub fn max(&self) -> f64 {
        self.max
    }

    /// The number that a share (0 to 1) of all numbers does not exceed, rounded up by at most 1/32.
    pub fn quantile(&self, share: f64) -> f64 {
        let rank = (self.count as f64 * share).ceil().max(1.0) as u64;
        let mut below = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            below += count;
            if below >= rank {
                let octave = LOWEST + (bin / BINS_PER_OCTAVE) as i32;
                let part = (bin % BINS_PER_OCTAVE + 1) as f64 / BINS_PER_OCTAVE as f64;
                // The first bin holds the zeros.
                let top = if bin == 0 { 0.0 } else { (1.0 + part) * 2.0_f64.powi(octave) };
                return top.min(self.max);
            }
        }
        self.max
    }
}

/// What the rays of a case have come to.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Rays that were sent.
    pub rays: u64,
    /// Rays that met something, or should have.
    pub met: u64,
    /// Answers that are wrong: another voxel, a root missed or invented, beyond the bound.
    pub wrong: u64,
    /// Of these, the right voxel with a wrong face.
    pub wrong_faces: u64,
    /// Roots missed or invented within the stated noise of a double root.
    pub near_double: u64,
    /// Roots met or missed as close to an end of a ray as a position is good.
    pub at_end: u64,
    /// Rays that used up the steps of the nudged traversal.
    pub stuck: u64,
    /// Rays through so many cells that llvmpipe ends their shader: not judged.
    pub cut: u64,
    /// Of what is asked: `t`, voxels or transmittance.
    pub errors: Errors,
    /// Of normals, in degrees; of smooth surfaces only.
    pub angles: Errors,
    /// Normals that are right only close by, and edges of dense fog: excused by a stated rule.
    pub steep: u64,
    /// Normals that are wrong, which makes their rays wrong, too.
    pub wrong_normals: u64,
    /// The first few wrong rays.
    pub examples: Vec<String>,
}

/// Wrong rays that are shown of each case.
const EXAMPLES: usize = 4;

impl Tally {
    /// Adds what the rays of another case have come to.
    pub fn merge(mut self, other: Self) -> Self {
        self.rays += other.rays;
        self.met += other.met;
        self.wrong += other.wrong;
        self.wrong_faces += other.wrong_faces;
        self.near_double += other.near_double;
        self.at_end += other.at_end;
        self.stuck += other.stuck;
        self.cut += other.cut;
        self.steep += other.steep;
        self.wrong_normals += other.wrong_normals;
        self.errors.merge(&other.errors);
        self.angles.merge(&other.angles);
        self.examples.extend(other.examples);
        self.examples.truncate(EXAMPLES);
        self
    }

    /// Keeps an example, if there are few.
    pub fn show(&mut self, example: impl FnOnce() -> String) {
        if self.examples.len() < EXAMPLES {
            self.examples.push(example());
        }
    }
}
