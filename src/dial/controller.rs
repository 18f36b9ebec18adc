//! From measured times to a mark on the dial: no clock, no GPU, so that a test can be both.

/// Marks on the dial.
pub(super) const MARKS: usize = 8;

/// What each mark costs beside the first, before anything has been measured: of lit fog, for which the
/// marks are the furthest apart.
const PRIOR: [f32; MARKS] = [1.0, 0.3, 0.2, 0.1, 0.06, 0.03, 0.018, 0.01];

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

/// Keeps the time of a frame within a budget: after a cut it looks for the best mark that fits, and then
/// holds that until the next.
#[derive(Clone, Debug)]
pub(super) struct Controller {
    mark: usize,
    /// What each mark costs beside the first, as far as it is known.
    ratios: [f32; MARKS],
    /// Which have been measured since the cut.
    known: [bool; MARKS],
    /// The last times, all of this mark.
    times: Vec<f32>,
    ignored: usize,
    /// The mark before the last turn, and its time then.
    before: Option<(usize, f32)>,
    /// Frames since the cut, while it looks for the best mark.
    age: usize,
    /// The mean of so many frames, while it holds one.
    held: Option<(f32, usize)>,
    /// What it was last asked to keep.
    budget: f32,
}

impl Default for Controller {
    fn default() -> Self {
        Self::at(1)
    }
}

impl Controller {
    pub fn at(mark: usize) -> Self {
        Self {
            mark: mark.min(MARKS - 1),
            ratios: PRIOR,
            known: [false; MARKS],
            times: Vec::new(),
            ignored: LATENCY,
            before: None,
            age: 0,
            held: None,
            budget: 0.0,
        }
    }

    pub fn mark(&self) -> usize {
        self.mark
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
        if self.ignored > 0 {
            self.ignored -= 1;
            return self.mark;
        }
        self.times.push(ms.max(1e-4));
        if self.times.len() > CREEP_WINDOW {
            self.times.remove(0);
        }
        if let Some((mean, frames)) = self.held {
            if self.is_cut(mean, budget) {
                let last = self.times.len() - WINDOW;
                let times = self.times.split_off(last);
                *self = Self { times, ignored: 0, budget, ..Self::at(self.mark) };
            } else if let Some(now) = self.median(CUT_WINDOW).filter(|now| *now > LONGER * mean) {
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
        if let Some(now) = self.median(WINDOW) {
            self.search(now, budget);
        }
        self.mark
    }

    /// The median of the last times.
    fn median(&self, of: usize) -> Option<f32> {
        let mut last = self.times[self.times.len().checked_sub(of)?..].to_vec();
        last.sort_by(f32::total_cmp);
        Some(last[of / 2])
    }

    /// Whether what is held is of another scene.
    fn is_cut(&self, mean: f32, budget: f32) -> bool {
        let is_far = self.median(CUT_WINDOW).is_some_and(|now| {
            now > LONGER * mean && now > AIM * budget || now * SHORTER < mean && self.mark > 0
        });
        let lately = self.times.iter().sum::<f32>() / self.times.len() as f32;
        let creeps = lately > CREEP.0 * budget && lately > CREEP.1 * mean;
        is_far || creeps && self.times.len() == CREEP_WINDOW
    }

    fn search(&mut self, now: f32, budget: f32) {
        self.learn(now);
        let expected = |mark: usize| now * self.ratios[mark] / self.ratios[self.mark];
        // What has been measured needs no room to spare.
        let fits =
            |mark: &usize| expected(*mark) <= budget * if self.known[*mark] { FITS } else { AIM };
        let best = (0..MARKS).find(fits).unwrap_or(MARKS - 1);
        let mut wanted = self.mark;
        if now > FITS * budget {
            wanted = best.max(self.mark + 1).min(MARKS - 1);
        } else if self.age <= UPWARDS {
            wanted = best.min(self.mark);
            let may_try = wanted == self.mark && wanted > 0 && now <= SPARE * budget;
            if may_try && !self.known[wanted - 1] {
                wanted -= 1;
            }
        }
        if wanted != self.mark {
            self.before = Some((self.mark, now));
            self.mark = wanted;
            self.times.clear();
            self.ignored = LATENCY;
        } else if self.age >= SEARCH {
            let mean = self.times.iter().sum::<f32>() / self.times.len() as f32;
            self.held = Some((mean, self.times.len()));
        }
    }

    /// What the first times after a turn tell: what the turn was worth, of what was expected. That is likely
    /// true of other turns, too.
    fn learn(&mut self, now: f32) {
        self.known[self.mark] = true;
        let Some((mark, then)) = self.before.take() else { return };
        let own = self.mark;
        self.ratios[own] = self.ratios[mark] * now / then;
        let worth = (now / then).ln() / (PRIOR[own] / PRIOR[mark]).ln();
        // Downwards there is always something to be gained.
        let worth = worth.clamp(if own > mark { 0.25 } else { 0.0 }, 2.0);
        for other in (0..MARKS).filter(|other| !self.known[*other]) {
            if (other < mark) != (own > mark) {
                self.ratios[other] = self.ratios[own] * (PRIOR[other] / PRIOR[own]).powf(worth);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What frames cost: the first mark's time, and what the others have of it.
    struct Scene {
        ms: f32,
        ratios: [f32; MARKS],
    }

    /// In [0, 1), evenly: the high bits of a linear congruence.
    fn random(state: &mut u64) -> f32 {
        *state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 40) as f32 / (1_u64 << 24) as f32
    }

    /// The marks of so many frames, whose times come late and are noisy.
    fn run(
        controller: &mut Controller,
        scene: &Scene,
        frames: usize,
        (budget, noise): (f32, f32),
        seed: &mut u64,
    ) -> Vec<usize> {
        let mut pending = std::collections::VecDeque::from([controller.mark(); 3]);
        (0..frames)
            .map(|_| {
                pending.push_back(controller.mark());
                let drawn = pending.pop_front().unwrap_or(0);
                let noise = 1.0 + noise * (2.0 * random(seed) - 1.0);
                controller.next(scene.ms * scene.ratios[drawn] * noise, budget)
            })
            .collect()
    }

    const FOG: [f32; MARKS] = [1.0, 0.35, 0.3, 0.15, 0.08, 0.04, 0.02, 0.01];
    /// Only the marks with fewer rays than pixels save anything.
    const SURFACE: [f32; MARKS] = [1.0, 1.0, 1.0, 1.0, 0.5, 0.26, 0.14, 0.08];
    const NOTHING: [f32; MARKS] = [1.0; MARKS];

    /// A camera that cuts from scene to scene: within 30 frames after each cut the dial stands still, as far
    /// up as the budget allows, and goes on standing still.
    #[test]
    fn the_dial_settles_after_every_cut_and_stays() {
        const BUDGET: f32 = 4.0;
        const SETTLED: usize = 30;
        let mut seed = 1;
        for noise in [0.0, 0.05, 0.1] {
            let mut controller = Controller::default();
            let (mut cuts, mut last) = (0, 0.0);
            for (i, ratios) in
                [FOG, SURFACE, FOG, NOTHING, SURFACE, FOG].iter().cycle().take(60).enumerate()
            {
                // Cuts that times tell of.
                let mut cost = |of: [f32; MARKS]| {
                    let ms = 0.5 * 200_f32.powf(random(&mut seed));
                    (ms, ms * of[controller.mark()])
                };
                let is_told = |now: f32| now > 1.5 * last || last > 1.5 * now;
                let ms = std::iter::repeat_with(|| cost(*ratios)).find(|(_, now)| is_told(*now));
                let ms = ms.unwrap().0;
                let scene = Scene { ms, ratios: *ratios };
                let cost = |mark: usize| ms * ratios[mark];
                let marks = run(&mut controller, &scene, 330, (BUDGET, noise), &mut seed);
                let end = marks[329];
                let settled = marks.iter().rposition(|mark| *mark != end).map_or(0, |at| at + 1);
                assert!(
                    settled <= SETTLED,
                    "cut {i}, {ms} ms, noise {noise}: {settled} frames, {marks:?}"
                );
                assert!(cost(end) <= BUDGET * 1.08 || end == MARKS - 1, "{ms}: {} ms", cost(end));
                // Of the better ones, but for the next, none would fit by far.
                let better = (1..end).map(|mark| mark - 1).find(|mark| cost(*mark) < 0.45 * BUDGET);
                assert!(better.is_none(), "cut {i}, {ms} ms: {end}, not {better:?}: {ratios:?}");
                cuts += usize::from(end != marks[0]);
                last = cost(end);
            }
            assert!(cuts > 10, "{cuts} cuts turned the dial");
        }
    }

    #[test]
    fn another_budget_is_a_cut() {
        let mut controller = Controller::default();
        let scene = Scene { ms: 0.2, ratios: FOG };
        for (budget, mark) in [(1e-4, MARKS - 1), (1e6, 0), (0.1, 1), (1e-4, MARKS - 1), (0.1, 1)] {
            let marks = run(&mut controller, &scene, 60, (budget, 0.0), &mut 1);
            assert!(marks[30..].iter().all(|now| *now == mark), "{budget} ms: {marks:?}");
        }
    }

    #[test]
    fn what_is_no_time_turns_nothing() {
        let mut controller = Controller::at(3);
        for ms in [f32::NAN, f32::INFINITY, -1.0] {
            (0..100).for_each(|_| assert_eq!(controller.next(ms, 1.0), 3));
        }
        for budget in [f32::NAN, 0.0, -1.0] {
            (0..100).for_each(|_| assert_eq!(controller.next(1.0, budget), 3));
        }
    }
}
