//! Tests with simulated apps and adapters, for which the cost of each mark is known.

use super::*;

/// The cost of frames in milliseconds: the part that no mark changes, the time of the first mark,
/// and the times of all marks relative to it.
#[derive(Clone, Copy)]
struct Scene {
    overhead: f32,
    ms: f32,
    ratios: [f32; MARKS],
}

impl Scene {
    fn cost(&self, mark: usize) -> f32 {
        self.overhead + self.ms * self.ratios[mark]
    }
}

/// Uniform random numbers in [0, 1): the high bits of a linear congruential generator.
fn random(state: &mut u64) -> f32 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 40) as f32 / (1_u64 << 24) as f32
}

/// The marks chosen over a number of frames whose times are delayed and noisy.
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
            controller.next(scene.cost(drawn) * noise, budget)
        })
        .collect()
}

const FOG: [f32; MARKS] = [1.0, 0.35, 0.3, 0.15, 0.08, 0.04, 0.02, 0.01];
/// Only the marks with fewer rays than pixels save time.
const SURFACE: [f32; MARKS] = [1.0, 1.0, 1.0, 1.0, 0.5, 0.26, 0.14, 0.08];
const NOTHING: [f32; MARKS] = [1.0; MARKS];

/// A camera cuts from scene to scene: within 30 frames after each cut, the dial settles at the best
/// mark that the budget allows, and stays there.
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
            // Only cuts that change the time noticeably.
            let mut cost = |of: [f32; MARKS]| {
                let ms = 0.5 * 200_f32.powf(random(&mut seed));
                (ms, ms * of[controller.mark()])
            };
            let is_told = |now: f32| now > 1.5 * last || last > 1.5 * now;
            let ms = std::iter::repeat_with(|| cost(*ratios)).find(|(_, now)| is_told(*now));
            let ms = ms.unwrap().0;
            let scene = Scene { overhead: 0.0, ms, ratios: *ratios };
            let cost = |mark: usize| scene.cost(mark);
            let marks = run(&mut controller, &scene, 330, (BUDGET, noise), &mut seed);
            let end = marks[329];
            if cost(QUICKEST) > FITS * BUDGET * (1.0 - noise) {
                // The budget is out of reach, and may be tried again at any time.
                last = cost(end);
                assert!(cost(end) <= 1.4 * BUDGET.max(cost(QUICKEST)), "{ms}: {end}");
                continue;
            }
            let settled = marks.iter().rposition(|mark| *mark != end).map_or(0, |at| at + 1);
            assert!(
                settled <= SETTLED,
                "cut {i}, {ms} ms, noise {noise}: {settled} frames, {marks:?}"
            );
            assert!(cost(end) <= BUDGET * 1.08, "{ms}: {} ms", cost(end));
            // No better mark, except for the next one, would fit with a large margin.
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
    let scene = Scene { overhead: 0.0, ms: 0.2, ratios: FOG };
    for (budget, mark) in [(1e-4, MARKS - 1), (1e6, 0), (0.1, 1), (1e-4, MARKS - 1), (0.1, 1)] {
        let marks = run(&mut controller, &scene, 60, (budget, 0.0), &mut 1);
        assert!(marks[30..].iter().all(|now| *now == mark), "{budget} ms: {marks:?}");
    }
}

/// Run lengths: each mark, with the number of consecutive frames.
fn runs(marks: &[usize]) -> Vec<(usize, usize)> {
    marks.chunk_by(|a, b| a == b).map(|run| (run[0], run.len())).collect()
}

/// The number of frames with a visible loss of quality.
fn sacrificed(marks: &[usize]) -> usize {
    marks.iter().filter(|mark| **mark > BEST_OVER_BUDGET).count()
}

/// Frames that exceed the budget with any mark, because of a slow CPU or vertical sync: quality is
/// not sacrificed.
#[test]
fn time_that_no_mark_saves_costs_no_picture() {
    const BUDGET: f32 = 50.0;
    let mut seed = 7;
    for ratios in [FOG, SURFACE, NOTHING] {
        for noise in [0.0, 0.1, 0.3] {
            for (overhead, start) in [(67.0, 1), (67.0, QUICKEST), (247.0, 1), (247.0, 3)] {
                let mut controller = Controller::at(start);
                let scene = Scene { overhead, ms: 5.0, ratios };
                let marks = run(&mut controller, &scene, 6000, (BUDGET, noise), &mut seed);
                let what = format!(
                    "{overhead} ms from mark {start}, noise {noise}, {ratios:?}: {:?}",
                    runs(&marks)
                );
                let found = sacrificed(&marks[60..]);
                assert!(found < 300, "{what}: {found} of 5940 frames");
                // Retries become ever rarer.
                let late = sacrificed(&marks[4000..]);
                assert!(late <= 50, "{what}: {late} of the last 2000 frames");
                if noise == 0.0 {
                    assert_eq!(sacrificed(&marks[60..120]), 0, "{what}");
                    let worst = marks[60..].iter().max();
                    assert!(worst <= Some(&TELLING), "{what}: tried again with {worst:?}");
                }
            }
        }
    }
}

/// Times as noisy as on a busy machine, varying up to fourfold.
#[test]
fn noise_above_the_budget_costs_no_picture() {
    for of in 1..=20 {
        let mut seed = of;
        let mut controller = Controller::default();
        let frames = 4000;
        let marks: Vec<_> =
            (0..frames).map(|_| controller.next(67.0 + 180.0 * random(&mut seed), 50.0)).collect();
        let fewer_rays = marks[60..].iter().filter(|mark| **mark >= TELLING).count();
        let found = (sacrificed(&marks[60..]), fewer_rays, sacrificed(&marks[frames - 1000..]));
        let fits = found.0 < frames / 6 && found.1 < frames / 10 && found.2 < 200;
        assert!(fits, "seed {of}: {found:?} of {frames} frames: {:?}", runs(&marks));
    }
}

/// Where the budget is out of reach, but the marks save most of a frame, the dial takes the saving:
/// the frame takes at most `ALLOWANCE` times as long as with the fastest mark.
#[test]
fn what_can_be_won_above_the_budget_is() {
    for ratios in [FOG, SURFACE] {
        let mut controller = Controller::default();
        let scene = Scene { overhead: 60.0, ms: 400.0, ratios };
        let marks = run(&mut controller, &scene, 120, (50.0, 0.0), &mut 1);
        let end = marks[119];
        assert!(marks[60..].iter().all(|mark| *mark == end), "{marks:?}");
        assert!(scene.cost(end) <= ALLOWANCE * scene.cost(QUICKEST), "{end}: {marks:?}");
        let better = scene.cost(end - 1) > 0.9 * ALLOWANCE * scene.cost(QUICKEST);
        assert!(better, "{end} is worse than need be: {marks:?}");
    }
}

/// When other work stops taking time, quality is restored: at once if the frame times show it,
/// otherwise when the budget is tried again.
#[test]
fn the_dial_recovers_when_the_time_is_its_own_again() {
    const BUDGET: f32 = 50.0;
    let mut seed = 3;
    for (noise, ratios) in
        [0.0, 0.1].into_iter().flat_map(|noise| [FOG, SURFACE].map(|of| (noise, of)))
    {
        for ms in [5.0, 100.0, 400.0] {
            let mut controller = Controller::default();
            let busy = Scene { overhead: 120.0, ms, ratios };
            let free = Scene { overhead: 1.0, ..busy };
            for round in 0..4 {
                run(&mut controller, &busy, 700, (BUDGET, noise), &mut seed);
                let marks = run(&mut controller, &free, 60, (BUDGET, noise), &mut seed);
                let end = marks[59];
                let what = format!("round {round}, {ms} ms, noise {noise}: {marks:?}");
                assert!(free.cost(end) <= 1.1 * BUDGET, "{} ms, {what}", free.cost(end));
                let better = (1..end).find(|mark| free.cost(*mark) < 0.45 * BUDGET);
                assert!(better.is_none(), "{better:?} would do, {what}");
            }
        }
    }
    // The budget comes within reach of other marks, but no frame time drops enough to show it.
    let mut controller = Controller::default();
    let busy = Scene { overhead: 60.0, ms: 100.0, ratios: SURFACE };
    run(&mut controller, &busy, 120, (BUDGET, 0.0), &mut seed);
    let free = Scene { overhead: 30.0, ms: 90.0, ..busy };
    let marks = run(&mut controller, &free, 300, (BUDGET, 0.0), &mut seed);
    assert!(free.cost(marks[299]) <= BUDGET, "{marks:?}");
}

/// Frames drawn with the pipelines of another mark do not count for this one.
#[test]
fn frames_while_pipelines_are_compiled_do_not_count() {
    let mut controller = Controller::default();
    let scene = Scene { overhead: 0.0, ms: 400.0, ratios: FOG };
    let (mut drawn, mut compiling) = (controller.mark(), 0);
    let marks: Vec<_> = (0..150)
        .map(|_| {
            if controller.mark() != drawn && compiling < 20 {
                compiling += 1;
                controller.wait();
            } else {
                (drawn, compiling) = (controller.mark(), 0);
                controller.next(scene.cost(drawn), 50.0);
            }
            controller.mark()
        })
        .collect();
    assert!(marks[149] == 4 && scene.cost(4) <= 50.0 && scene.cost(3) > 50.0, "{marks:?}");
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
