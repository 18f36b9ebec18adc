//! Times of many runs.

use vdb_probe::{Gpu, Step};

/// With fewer, a median says little.
pub const LEAST_RUNS: u32 = 30;
/// Milliseconds of work before what counts: a GPU that was idle is slow at first.
const WARM_UP: f64 = 500.0;

/// What runs took, in milliseconds.
pub struct Times {
    pub median: f64,
    pub min: f64,
    pub max: f64,
    /// From the first to the third quartile, in parts of the median.
    pub spread: f64,
    pub runs: u32,
}

impl Times {
    /// Runs passes until the GPU is warm, then counts. For fewer runs than make a figure it need not be.
    pub fn measure(gpu: &Gpu, passes: &[Step], runs: u32) -> Self {
        let mut warm = if runs < LEAST_RUNS { WARM_UP } else { 0.0 };
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
