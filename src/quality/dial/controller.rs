//! From measured times to a mark on the dial: no clock, no GPU, so that a test can be both.

/// Marks on the dial.
pub(super) const MARKS: usize = 8;

/// What each mark costs beside the first, before anything has been measured: of lit fog, for which the
/// marks are the furthest apart.
const PRIOR: [f32; MARKS] = [1.0, 0.3, 0.2, 0.1, 0.06, 0.03, 0.018, 0.01];

/// The last mark, with which frames are as quick as the dial can make them.
const QUICKEST: usize = MARKS - 1;
/// The first mark with fewer rays than pixels: if that gains nothing, none does.
const TELLING: usize = 4;
/// The best mark while the budget cannot be kept: the eye finds no difference to the first.
const BEST_OVER_BUDGET: usize = 1;

/// Frames after a turn whose times are of frames before it.
const LATENCY: usize = 4;
/// Frames whose median counts, after a turn and of those that tell of a cut.
const WINDOW: usize = 3;
const CUT_WINDOW: usize = 5;
/// Frames after a cut in which the dial may be turned to better marks, and in which it is turned at all.
const UPWARDS: usize = 18;
const SEARCH: usize = 24;
/// The part of the budget that a mark may be expected to take for the dial to be turned to it.
const AIM: f32 = 0.85;
/// The part of the budget that it may be found to take.
const FITS: f32 = 0.97;
/// The part of the budget below which the next better mark is tried once, whatever is expected of it.
const SPARE: f32 = 0.5;
/// How much longer frames take after a cut, at least, where they come near the budget; and how much shorter.
const LONGER: f32 = 1.15;
const SHORTER: f32 = 1.3;
/// What creeps up on the budget is seen to by the mean of so many frames, if it is so much above the budget
/// and above what it was.
const CREEP_WINDOW: usize = 16;
const CREEP: (f32, f32) = (1.1, 1.06);
/// A turn to a quicker mark that leaves more of the time than this has gained nothing.
const GAIN: f32 = 0.9;
/// Where the budget cannot be kept: how many times as long as with the quickest mark a frame may take. A
/// mark that saves no more than a quarter of the frame is not worth what it takes from the picture.
const ALLOWANCE: f32 = 1.35;
/// Frames after which a budget that could not be kept is tried again, at first and at most: each time that
/// it is in vain, twice as many.
const RETRY: (u32, u32) = (128, 4096);
/// How many times as long as allowed a better mark may have been found to take to be measured once more, when
/// the picture is given back.
const DOUBT: f32 = 1.2;
/// Times after a turn are taken until they differ by no more than this times the root of how many they are:
/// what jumps about takes longer to be compared.
const STEADY: f32 = 0.15;

/// Keeps the time of a frame within a budget: after a cut it looks for the best mark that fits, and then
/// holds that until the next. Where none fits, because most of the time is nothing that the marks have to
/// do with, it holds the best of those that are hardly slower than the quickest.
#[derive(Clone, Debug)]
pub(super) struct Controller {
    mark: usize,
    /// The time of each mark that has been measured since the cut.
    measured: [Option<f32>; MARKS],
    /// The last times, all of this mark.
    times: Vec<f32>,
    ignored: usize,
    /// The mark before the last turn, while it has not been measured what that was worth.
    before: Option<usize>,
    /// Frames since the cut, while it looks for the best mark.
    age: usize,
    /// The mean of so many frames, while it holds one.
    held: Option<(f32, usize)>,
    /// What it was last asked to keep.
    budget: f32,
    /// The time of the quickest mark, where that was above the budget.
    floor: Option<f32>,
    /// Frames until the budget is tried again then, and how many there are to be the next time.
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

    /// Tells that frames are not drawn with the mark for now, as while its pipelines are being compiled.
    pub fn wait(&mut self) {
        self.ignored = LATENCY;
        self.times.clear();
    }

    /// Takes the time of another frame, in milliseconds, and the budget; gives the mark for the next.
    pub fn next(&mut self, ms: f32, budget: f32) -> usize {
        if !(ms.is_finite() && ms >= 0.0 && budget > 0.0) {
            return self.mark;
        }
        // Another budget is a cut, whatever the times say.
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
                // It takes longer, and fits by far.
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

    /// The median of the last times, once they are enough to tell.
    fn steady(&self) -> Option<f32> {
        let median = self.median(self.times.len().max(WINDOW))?;
        let count = self.times.len() as f32;
        let [least, most] = self.range(0..self.times.len());
        // A few of many numbers lie closer together than all of them.
        let spread = (most - least) * (count + 1.0) / (count - 1.0);
        let is_steady = spread <= STEADY * median * count.sqrt();
        (is_steady || self.times.len() == CREEP_WINDOW).then_some(median)
    }

    /// The least and the largest of some times.
    fn range(&self, of: std::ops::Range<usize>) -> [f32; 2] {
        let of = &self.times[of];
        let least = of.iter().copied().fold(f32::INFINITY, f32::min);
        [least, of.iter().copied().fold(0.0, f32::max)]
    }

    /// The median of the last times.
    fn median(&self, of: usize) -> Option<f32> {
        let mut last = self.times[self.times.len().checked_sub(of)?..].to_vec();
        last.sort_by(f32::total_cmp);
        Some(last[of / 2])
    }

    /// The budget, or what can be kept instead.
    fn goal(&self) -> f32 {
        self.floor.map_or(self.budget, |floor| self.budget.max(ALLOWANCE * floor))
    }

    /// Whether what is held is of another scene.
    fn is_cut(&self, mean: f32) -> bool {
        let goal = self.goal();
        let is_far = self.median(CUT_WINDOW).is_some_and(|now| {
            now > LONGER * mean && now > AIM * goal || now * SHORTER < mean && self.mark > 0
        });
        if self.floor.is_some() {
            // It is known that there is little to be won: to look again, noise is not enough.
            return is_far && self.is_apart();
        }
        let lately = self.times.iter().sum::<f32>() / self.times.len() as f32;
        let creeps = lately > CREEP.0 * goal && lately > CREEP.1 * mean;
        is_far || creeps && self.times.len() == CREEP_WINDOW
    }

    /// Whether the last times are all longer, or all shorter, than those before.
    fn is_apart(&self) -> bool {
        let all = self.times.len();
        if all < CUT_WINDOW + WINDOW {
            return false;
        }
        let ([before, most], [least, now]) =
            (self.range(0..all - CUT_WINDOW), self.range(all - CUT_WINDOW..all));
        least > most || now < before
    }

    /// Begins a search with the last times.
    fn start_over(&mut self) {
        let times = self.times.split_off(self.times.len().saturating_sub(WINDOW));
        let Self { budget, retry, .. } = *self;
        *self = Self { times, ignored: 0, budget, retry, ..Self::at(self.mark) };
    }

    /// Where the budget cannot be kept, tries the next better mark again.
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
        } else if self.age <= UPWARDS || self.floor.is_some() {
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

    /// The best mark that takes no more than so many times as long as one that fits.
    fn best_within(&self, times: f32) -> usize {
        let goal = times * self.goal();
        // What has been measured needs no room to spare.
        let is_known = |mark: usize| self.measured[mark].is_some() || self.floor.is_some();
        let part = |mark: usize| if is_known(mark) { FITS } else { AIM };
        let first = if self.floor.is_some() { BEST_OVER_BUDGET } else { 0 };
        let fits = |mark: &usize| self.expected(*mark) <= goal * part(*mark);
        (first..MARKS).find(fits).unwrap_or(QUICKEST)
    }

    /// The time that a mark likely takes, by what has been measured.
    fn expected(&self, mark: usize) -> f32 {
        let time = |at: usize| self.measured[at].map(|ms| (at, ms));
        if let Some(ms) = self.measured[mark] {
            return ms;
        }
        let (mut better, mut quicker) =
            ((0..mark).rev().filter_map(time), (mark + 1..MARKS).filter_map(time));
        match (better.next(), quicker.next()) {
            // Of the time between two, a part is the same for all marks.
            (Some((a, slow)), Some((b, fast))) => {
                let part = (PRIOR[mark] - PRIOR[b]) / (PRIOR[a] - PRIOR[b]);
                fast + part * (slow - fast)
            }
            // Beyond them, turns are worth what they have been. Downwards there is always something to be
            // gained.
            (Some(last), None) => beyond(mark, last, better.next(), 0.25),
            (None, Some(first)) => beyond(mark, first, quicker.next(), 0.0),
            (None, None) => f32::INFINITY,
        }
    }
}

/// What is expected of a mark beyond the last that has been measured, and the one before that.
fn beyond(mark: usize, (last, ms): (usize, f32), before: Option<(usize, f32)>, least: f32) -> f32 {
    let worth = before.map_or(1.0, |(before, then)| {
        ((ms / then).ln() / (PRIOR[last] / PRIOR[before]).ln()).clamp(least, 2.0)
    });
    ms * (PRIOR[mark] / PRIOR[last]).powf(worth)
}

#[cfg(test)]
mod tests;
