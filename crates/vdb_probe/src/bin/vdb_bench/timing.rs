//! Statistics of timed runs.

use vdb_probe::{Gpu, Step};

/// The fewest runs for a meaningful median.
pub const MIN_RUNS: u32 = 30;
/// Milliseconds of work before timing begins, because an idle GPU is slow at first.
const WARM_UP: f64 = 500.0;

/// Statistics of the run times, in milliseconds.
pub struct Times {
    pub median: f64,
    pub min: f64,
    pub max: f64,
    /// The interquartile range relative to the median.
    pub spread: f64,
    pub runs: u32,
}

impl Times {
    /// Runs the passes until the GPU is warm, and then times them. With fewer than [`MIN_RUNS`],
    /// when times are not reported, it does not warm up.
    pub fn measure(gpu: &Gpu, passes: &[Step], runs: u32) -> Self {
        let mut warm = if runs < MIN_RUNS { WARM_UP } else { 0.0 };
        while warm < WARM_UP {
            warm += gpu.time(passes, 5).iter().sum::<f64>();
        }
        let mut times = gpu.time(passes, runs);
        times.sort_by(f64::total_cmp);
        let part = |quarters: usize| times[(times.len() - 1) * quarters / 4];
        let median = part(2);
        let spread = (part(3) - part(1)) / median;
        Self { median, min: part(0), max: part(4), spread, runs }
    }
}
