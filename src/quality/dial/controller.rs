//! The controller that turns measured times into a mark on the dial. Independent of clocks and
//! GPUs, so that tests can simulate both.

/// Marks on the dial.
pub(super) const MARKS: usize = 8;

/// The assumed cost of each mark relative to the first before any measurement: the cost for lit fog,
/// for which the marks differ most.
const PRIOR: [f32; MARKS] = [1.0, 0.3, 0.2, 0.1, 0.06, 0.03, 0.018, 0.01];

/// The last mark, which is the fastest.
const QUICKEST: usize = MARKS - 1;
/// The first mark with fewer rays than pixels: if that saves nothing, no mark does.
const TELLING: usize = 4;
/// The best mark while the budget cannot be kept: visually equal to the first.
const BEST_OVER_BUDGET: usize = 1;

/// The number of frames after a change whose times belong to earlier frames.
const LATENCY: usize = 4;
/// The number of frames whose median is used after a change and to detect a cut.
const WINDOW: usize = 3;
const CUT_WINDOW: usize = 5;
/// The number of frames after a cut during which the dial may move to better marks, and during which
/// it may move in either direction.
const UPWARDS: usize = 18;
const SEARCH: usize = 24;
/// The largest expected fraction of the budget at which a mark is chosen.
const AIM: f32 = 0.85;
/// The largest measured fraction of the budget at which a chosen mark is kept.
const FITS: f32 = 0.97;
/// The fraction of the budget below which the next better mark is tried once, whatever its expected
/// time.
const SPARE: f32 = 0.5;
/// The ratios by which frames near the budget must slow down, or any frames speed up, to count as a
/// cut.
const LONGER: f32 = 1.15;
const SHORTER: f32 = 1.3;
/// Slow growth is detected from the mean of this many frames, if it exceeds the budget and the
/// earlier mean by these factors.
const CREEP_WINDOW: usize = 16;
const CREEP: (f32, f32) = (1.1, 1.06);
/// A change to a faster mark is futile if more than this fraction of the time remains.
const GAIN: f32 = 0.9;
/// If the budget cannot be kept: the time that a frame may take relative to the fastest mark. A
/// saving of no more than a quarter of the frame is not worth the loss of quality.
const ALLOWANCE: f32 = 1.35;
/// Frames until an unreachable budget is tried again, initially and at most, doubling with each
/// failure.
const RETRY: (u32, u32) = (128, 4096);
/// The factor by which a better mark may have exceeded the allowance and still be remeasured when
/// quality is restored.
const DOUBT: f32 = 1.2;
/// Times after a change are collected until their relative spread is at most this times the square
/// root of their number, so noisy times are averaged over more frames.
const STEADY: f32 = 0.15;

/// Keeps frame times within a budget: after a cut, the controller searches for the best mark that
/// fits, and holds it until the next cut. If no mark fits, because most of the time does not depend
/// on the mark, it holds the best of those that are hardly slower than the fastest.
#[derive(Clone, Debug)]
pub(super) struct Controller {
    mark: usize,
    /// The time of each mark measured since the cut.
    measured: [Option<f32>; MARKS],
    /// The latest times, all measured with this mark.
    times: Vec<f32>,
    ignored: usize,
    /// The mark before the last change, until the gain has been measured.
    before: Option<usize>,
    /// Frames since the cut, while searching.
    age: usize,
    /// The mean and the number of frames, while holding a mark.
    held: Option<(f32, usize)>,
    /// The budget of the last frame.
    budget: f32,
    /// The time of the fastest mark, if it exceeded the budget.
    floor: Option<f32>,
    /// While the budget cannot be kept: the number of frames until it is tried again, and the next
    /// interval.
    retry: (u32, u32),
}

impl Default for Controller {
    fn default() -> Self {
        Self::at(1)
    }
}

impl Controller {
    pub fn at(mark: usize) -> Self {
        Self {
            mark: mark.min(QUICKEST),
            measured: [None; MARKS],
            times: Vec::new(),
            ignored: LATENCY,
            before: None,
            age: 0,
            held: None,
            budget: 0.0,
            floor: None,
            retry: (0, RETRY.0),
        }
    }

    pub fn mark(&self) -> usize {
        self.mark
    }

    /// Reports that the mark does not affect frames yet, for example while its pipelines are being
    /// compiled.
    pub fn wait(&mut self) {
        self.ignored = LATENCY;
        self.times.clear();
    }

    /// Takes the time of a frame in milliseconds and the budget; returns the mark for the next
    /// frame.
    pub fn next(&mut self, ms: f32, budget: f32) -> usize {
        if !(ms.is_finite() && ms >= 0.0 && budget > 0.0) {
            return self.mark;
        }
        // A new budget is a cut, regardless of the times.
        if budget != self.budget {
            *self = Self { budget, ..Self::at(self.mark) };
        }
        self.age += 1;
        self.retry.0 = self.retry.0.saturating_sub(1);
        if self.ignored > 0 {
            self.ignored -= 1;
            return self.mark;
        }
        self.times.push(ms.max(1e-4));
        if self.times.len() > CREEP_WINDOW {
            self.times.remove(0);
        }
        if let Some((mean, frames)) = self.held {
            let tries = self.floor.is_some() && self.retry.0 == 0;
            if self.is_cut(mean) || tries && self.mark <= BEST_OVER_BUDGET {
                self.start_over();
            } else if tries {
                self.give_back();
                return self.mark;
            } else if let Some(now) = self.median(CUT_WINDOW)
                && (LONGER * mean..AIM * self.goal()).contains(&now)
            {
                // Slower than before, but still well within the budget.
                self.held = Some((now, CUT_WINDOW));
                return self.mark;
            } else {
                let frames = (frames + 1).min(CREEP_WINDOW);
                if frames < CREEP_WINDOW {
                    self.held = Some((mean + (ms - mean) / frames as f32, frames));
                }
                return self.mark;
            }
        }
        if let Some(now) = self.steady() {
            self.search(now);
        }
        self.mark
    }

    /// The median of the latest times, once there are enough to average out their noise.
    fn steady(&self) -> Option<f32> {
        let median = self.median(self.times.len().max(WINDOW))?;
        let count = self.times.len() as f32;
        let [least, most] = self.range(0..self.times.len());
        // The expected range of a small sample is smaller than that of the distribution.
        let spread = (most - least) * (count + 1.0) / (count - 1.0);
        let is_steady = spread <= STEADY * median * count.sqrt();
        (is_steady || self.times.len() == CREEP_WINDOW).then_some(median)
    }

    /// The minimum and the maximum of some of the times.
    fn range(&self, of: std::ops::Range<usize>) -> [f32; 2] {
        let of = &self.times[of];
        let least = of.iter().copied().fold(f32::INFINITY, f32::min);
        [least, of.iter().copied().fold(0.0, f32::max)]
    }

    /// The median of the latest times.
    fn median(&self, of: usize) -> Option<f32> {
        let mut last = self.times[self.times.len().checked_sub(of)?..].to_vec();
        last.sort_by(f32::total_cmp);
        Some(last[of / 2])
    }

    /// The budget, or the time that can be kept instead.
    fn goal(&self) -> f32 {
        self.floor.map_or(self.budget, |floor| self.budget.max(ALLOWANCE * floor))
    }

    /// Whether the scene has changed since the mean time of the held mark was measured.
    fn is_cut(&self, mean: f32) -> bool {
        let goal = self.goal();
        let is_far = self.median(CUT_WINDOW).is_some_and(|now| {
            now > LONGER * mean && now > AIM * goal || now * SHORTER < mean && self.mark > 0
        });
        if self.floor.is_some() {
            // A new search is unlikely to gain much, so noise must not trigger it.
            return is_far && self.is_apart();
        }
        let lately = self.times.iter().sum::<f32>() / self.times.len() as f32;
        let creeps = lately > CREEP.0 * goal && lately > CREEP.1 * mean;
        is_far || creeps && self.times.len() == CREEP_WINDOW
    }

    /// Whether the latest times are all longer, or all shorter, than the earlier ones.
    fn is_apart(&self) -> bool {
        let all = self.times.len();
        if all < CUT_WINDOW + WINDOW {
            return false;
        }
        let ([before, most], [least, now]) =
            (self.range(0..all - CUT_WINDOW), self.range(all - CUT_WINDOW..all));
        least > most || now < before
    }

    /// Starts a search from the latest times.
    fn start_over(&mut self) {
        let times = self.times.split_off(self.times.len().saturating_sub(WINDOW));
        let Self { budget, retry, .. } = *self;
        *self = Self { times, ignored: 0, budget, retry, ..Self::at(self.mark) };
    }

    /// Tries the next better mark again while the budget cannot be kept.
    fn give_back(&mut self) {
        (self.held, self.retry.0) = (None, RETRY.0);
        self.turn(self.mark - 1);
        self.measured[self.mark] = None;
    }

    fn turn(&mut self, mark: usize) {
        self.before = (mark > self.mark).then_some(self.mark);
        self.mark = mark;
        self.times.clear();
        self.ignored = LATENCY;
    }

    fn search(&mut self, now: f32) {
        self.measured[self.mark] = Some(now);
        // Noise may delay the first measurement beyond `UPWARDS`; a better mark is still tried then.
        let is_first = self.measured.iter().flatten().count() == 1;
        let then = self.before.take().and_then(|before| self.measured[before]);
        let is_futile = then.is_some_and(|then| now > GAIN * then);
        if now <= FITS * self.budget {
            (self.floor, self.retry) = (None, (0, RETRY.0));
        }
        let mut wanted = self.mark;
        if now > FITS * self.goal() {
            let was_in_vain = self.retry.1 > RETRY.0;
            wanted = if self.mark == QUICKEST || is_futile && self.mark >= TELLING {
                if self.floor.replace(now).is_none() {
                    self.retry = (self.retry.1, (2 * self.retry.1).min(RETRY.1));
                }
                let knows_better = self.measured[..self.mark].iter().any(Option::is_some);
                if knows_better { self.best_within(DOUBT) } else { TELLING }
            } else if self.floor.is_none() && (is_futile || was_in_vain) {
                TELLING.max(self.mark + 1)
            } else {
                self.best().max(self.mark + 1)
            };
        } else if self.age <= UPWARDS || self.floor.is_some() || is_first {
            wanted = self.best().min(self.mark);
            let may_try = wanted == self.mark && now <= SPARE * self.budget;
            if may_try && wanted > 0 && self.measured[wanted - 1].is_none() {
                wanted -= 1;
            }
        }
        if wanted != self.mark {
            self.turn(wanted);
        } else if self.age >= SEARCH {
            let mean = self.times.iter().sum::<f32>() / self.times.len() as f32;
            self.held = Some((mean, self.times.len()));
            if self.mark > BEST_OVER_BUDGET {
                self.retry.0 = self.retry.0.min(RETRY.0);
            }
        }
    }

    /// The best mark that fits.
    fn best(&self) -> usize {
        self.best_within(1.0)
    }

    /// The best mark that takes at most this multiple of the time that fits.
    fn best_within(&self, times: f32) -> usize {
        let goal = times * self.goal();
        // Measured times need no safety margin.
        let is_known = |mark: usize| self.measured[mark].is_some() || self.floor.is_some();
        let part = |mark: usize| if is_known(mark) { FITS } else { AIM };
        let first = if self.floor.is_some() { BEST_OVER_BUDGET } else { 0 };
        let fits = |mark: &usize| self.expected(*mark) <= goal * part(*mark);
        (first..MARKS).find(fits).unwrap_or(QUICKEST)
    }

    /// The expected time of a mark, from the measurements.
    fn expected(&self, mark: usize) -> f32 {
        let time = |at: usize| self.measured[at].map(|ms| (at, ms));
        if let Some(ms) = self.measured[mark] {
            return ms;
        }
        let (mut better, mut quicker) =
            ((0..mark).rev().filter_map(time), (mark + 1..MARKS).filter_map(time));
        match (better.next(), quicker.next()) {
            // Interpolates linearly, because part of the time is the same for all marks.
            (Some((a, slow)), Some((b, fast))) => {
                let part = (PRIOR[mark] - PRIOR[b]) / (PRIOR[a] - PRIOR[b]);
                fast + part * (slow - fast)
            }
            // Extrapolates the saving of the last two measured marks. Towards faster marks, some
            // saving is always assumed.
            (Some(last), None) => beyond(mark, last, better.next(), 0.25),
            (None, Some(first)) => beyond(mark, first, quicker.next(), 0.0),
            (None, None) => f32::INFINITY,
        }
    }
}

/// The expected time of a mark beyond the last measured one, extrapolated from that and the
/// measured one before it. `least` is the smallest assumed saving.
fn beyond(mark: usize, (last, ms): (usize, f32), before: Option<(usize, f32)>, least: f32) -> f32 {
    let worth = before.map_or(1.0, |(before, then)| {
        ((ms / then).ln() / (PRIOR[last] / PRIOR[before]).ln()).clamp(least, 2.0)
    });
    ms * (PRIOR[mark] / PRIOR[last]).powf(worth)
}

#[cfg(test)]
mod tests;
