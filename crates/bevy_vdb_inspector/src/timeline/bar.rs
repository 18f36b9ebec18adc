//! The bar of a timeline.

use bevy_egui::egui;
use bevy_vdb::{VdbFrame, VdbPlayerStatus, VdbSequence};

/// The height of the bar, and of the numbers below it, in points.
const HEIGHT: f32 = 16.0;
const NUMBERS: f32 = 13.0;
/// The smallest distance between two numbers, in points.
const BETWEEN: f32 = 56.0;
/// The smallest width of a frame that has failed, and of one in memory, in points.
const LEAST: f32 = 1.0;

/// The colours of the position, and of a frame that is still wanted.
const HEAD: egui::Color32 = egui::Color32::from_rgb(255, 190, 60);

/// What the user does with the bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scrub {
    No,
    /// Goes back or forwards by frames.
    Step(isize),
    /// Goes to a frame.
    To(u64),
    /// Holds the position, at another frame than before if one is given.
    Hold(Option<u64>),
    /// Lets go of the position of a player that was playing.
    Release,
    /// Pauses or plays.
    Toggle,
}

pub(super) struct Bar<'a> {
    /// The numbers of the first and the last frame.
    pub range: (u64, u64),
    pub status: &'a VdbPlayerStatus,
    pub sequence: &'a VdbSequence,
}

impl Bar<'_> {
    /// Shows the bar.
    pub fn show(&self, ui: &mut egui::Ui, plays: bool) -> Scrub {
        let size = egui::vec2(ui.available_width(), HEIGHT + NUMBERS);
        let (area, response) = ui.allocate_exact_size(size, egui::Sense::click_and_drag());
        let now = self.status.wanted().or(self.status.frame()).unwrap_or(self.range.0);
        response.widget_info(|| egui::WidgetInfo::slider(true, now as f64, "frame"));
        ui.ctx().accesskit_node_builder(response.id, |node| {
            node.set_min_numeric_value(self.range.0 as f64);
            node.set_max_numeric_value(self.range.1 as f64);
            node.add_action(egui::accesskit::Action::SetValue);
        });
        let scale = Scale::new(self.range, area.x_range());
        self.draw(ui, area, &scale, now, &response);
        let scrub = self.scrub(ui, &response, &scale, now, plays);
        if let Some(at) = response.hover_pos() {
            let frame = scale.frame(at.x);
            let text = match (self.status.failed(), self.status.loaded()) {
                (failed, _) if failed.binary_search(&frame).is_ok() => {
                    "cannot be shown; the reason is logged"
                }
                (_, loaded) if loaded.binary_search(&frame).is_ok() => "in memory",
                _ if self.index(frame).is_err() => "is not in the sequence",
                _ => "is not in memory",
            };
            response.on_hover_text_at_pointer(format!("frame {frame} {text}"));
        }
        scrub
    }

    fn index(&self, frame: u64) -> Result<usize, usize> {
        self.sequence.frames().binary_search_by_key(&frame, |own| own.number)
    }

    fn scrub(
        &self,
        ui: &egui::Ui,
        response: &egui::Response,
        scale: &Scale,
        now: u64,
        plays: bool,
    ) -> Scrub {
        // Whether the player was playing when the user took hold of the position.
        let before: Option<bool> = ui.data(|data| data.get_temp(response.id));
        let pointed = response.interact_pointer_pos().map(|at| scale.frame(at.x));
        if response.is_pointer_button_down_on() {
            if before.is_none() {
                ui.data_mut(|data| data.insert_temp(response.id, plays));
            }
            return Scrub::Hold(pointed.filter(|frame| *frame != now));
        }
        if let Some(played) = before {
            ui.data_mut(|data| data.remove::<bool>(response.id));
            return if played { Scrub::Release } else { Scrub::No };
        }
        if response.clicked() {
            // Without a pointer, the click is a key.
            return pointed.map_or(Scrub::Toggle, Scrub::To);
        }
        self.keys(ui, response)
    }

    fn keys(&self, ui: &egui::Ui, response: &egui::Response) -> Scrub {
        use egui::accesskit::{Action, ActionData};
        let asked = ui.input(|input| {
            let requests = input.accesskit_action_requests(response.id, Action::SetValue);
            let value = requests.last()?.data.clone();
            value.and_then(
                |data| if let ActionData::NumericValue(to) = data { Some(to) } else { None },
            )
        });
        if let Some(to) = asked.filter(|to| to.is_finite()) {
            return Scrub::To((to.round().max(0.0) as u64).clamp(self.range.0, self.range.1));
        }
        if !response.has_focus() {
            return Scrub::No;
        }
        let filter = egui::EventFilter { horizontal_arrows: true, ..Default::default() };
        ui.memory_mut(|memory| memory.set_focus_lock_filter(response.id, filter));
        let pressed = |key| ui.input(|input| input.num_presses(key)) as isize;
        let step = pressed(egui::Key::ArrowRight) - pressed(egui::Key::ArrowLeft);
        match (step, pressed(egui::Key::Home), pressed(egui::Key::End)) {
            (0, 0, 0) => Scrub::No,
            (0, 0, _) => Scrub::To(self.range.1),
            (0, ..) => Scrub::To(self.range.0),
            _ => Scrub::Step(step),
        }
    }

    fn draw(
        &self,
        ui: &egui::Ui,
        area: egui::Rect,
        scale: &Scale,
        now: u64,
        response: &egui::Response,
    ) {
        let painter = ui.painter_at(area.expand(1.0));
        let track = area.with_max_y(area.top() + HEIGHT);
        let visuals = ui.visuals();
        painter.rect_filled(track, 2.0, visuals.extreme_bg_color);
        let frames = self.sequence.frames();
        let (loaded, failed) = (loaded_color(visuals), visuals.error_fg_color);
        for (numbers, color) in [(self.status.loaded(), loaded), (self.status.failed(), failed)] {
            for run in runs(numbers, frames, scale) {
                let run = egui::Rect::from_x_y_ranges(run, track.y_range().shrink(3.0));
                painter.rect_filled(run, 0.0, color);
            }
        }
        let font = egui::TextStyle::Small.resolve(ui.style());
        for number in numbers(self.range, scale.slot) {
            let x = scale.middle(number);
            painter.vline(x, track.bottom()..=track.bottom() + 2.0, visuals.window_stroke);
            let text =
                painter.layout_no_wrap(number.to_string(), font.clone(), visuals.weak_text_color());
            // The numbers at the ends stay on the bar.
            let half = text.size().x / 2.0;
            let left = (x - half).min(area.right() - 2.0 * half).max(area.left());
            painter.galley(egui::pos2(left, track.bottom() + 1.0), text, visuals.text_color());
        }
        if let Some(shown) = self.status.frame().filter(|shown| *shown != now) {
            let stroke = egui::Stroke::new(1.0_f32, HEAD.gamma_multiply(0.5));
            painter.vline(scale.middle(shown), track.y_range(), stroke);
        }
        let head = scale.slot_of(now);
        let middle = head.center();
        if head.span() > 4.0 {
            let rect = egui::Rect::from_x_y_ranges(head, track.y_range());
            painter.rect_filled(rect, 2.0, HEAD.gamma_multiply(0.35));
        }
        painter.vline(middle, track.y_range(), egui::Stroke::new(2.0_f32, HEAD));
        let tip = [
            egui::pos2(middle - 5.0, track.top()),
            egui::pos2(middle + 5.0, track.top()),
            egui::pos2(middle, track.top() + 6.0),
        ];
        painter.add(egui::Shape::convex_polygon(tip.into(), HEAD, egui::Stroke::NONE));
        if response.has_focus() {
            let stroke = visuals.selection.stroke;
            painter.rect_stroke(track, 2.0, stroke, egui::StrokeKind::Inside);
        }
    }
}

/// The colour of frames in memory.
fn loaded_color(visuals: &egui::Visuals) -> egui::Color32 {
    visuals.extreme_bg_color.lerp_to_gamma(visuals.text_color(), 0.45)
}

/// Where numbers are on the bar: each has a slot of the same width.
#[derive(Clone, Copy, Debug)]
struct Scale {
    range: (u64, u64),
    left: f32,
    slot: f32,
}

impl Scale {
    fn new(range: (u64, u64), x: egui::Rangef) -> Self {
        let count = (range.1.saturating_sub(range.0) as f64 + 1.0) as f32;
        Self { range, left: x.min, slot: x.span().max(1.0) / count }
    }

    /// The left edge of a number's slot.
    fn left(&self, number: u64) -> f32 {
        self.left + (number.saturating_sub(self.range.0) as f64 * f64::from(self.slot)) as f32
    }

    fn slot_of(&self, number: u64) -> egui::Rangef {
        let left = self.left(number);
        egui::Rangef::new(left, left + self.slot)
    }

    fn middle(&self, number: u64) -> f32 {
        self.slot_of(number).center()
    }

    /// The number at a place; the nearest one for places beside the bar.
    fn frame(&self, x: f32) -> u64 {
        let slots = f64::from((x - self.left).max(0.0)) / f64::from(self.slot);
        self.range.0.saturating_add(slots as u64).min(self.range.1)
    }
}

/// The places of frames, given by ascending number, each from its slot to that of the next frame of
/// the sequence. Places that touch, or are less than a pixel apart, are one, so that there are
/// never more of them than pixels.
fn runs(numbers: &[u64], frames: &[VdbFrame], scale: &Scale) -> Vec<egui::Rangef> {
    let mut runs: Vec<egui::Rangef> = Vec::new();
    for number in numbers {
        let next = frames.partition_point(|frame| frame.number <= *number);
        let end = frames.get(next).map_or(scale.range.1.saturating_add(1), |frame| frame.number);
        let left = scale.left(*number);
        let right = scale.left(end).max(left + LEAST);
        match runs.last_mut() {
            Some(last) if left - last.max < 1.0 => last.max = last.max.max(right),
            _ => runs.push(egui::Rangef::new(left, right)),
        }
    }
    runs
}

/// The numbers to write below the bar: multiples of 1, 2 or 5 times a power of ten.
fn numbers((first, last): (u64, u64), slot: f32) -> impl Iterator<Item = u64> {
    let least = f64::from(BETWEEN / slot.max(f32::MIN_POSITIVE)).max(1.0);
    let power = 10_f64.powf(least.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    let step = step.into_iter().find(|step| *step >= least).unwrap_or(least).max(1.0) as u64;
    let from = first.checked_next_multiple_of(step);
    let all = std::iter::successors(from, move |number| number.checked_add(step));
    all.take_while(move |number| *number <= last)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sequence(numbers: impl IntoIterator<Item = u64>) -> VdbSequence {
        VdbSequence::new(numbers.into_iter().map(|number| VdbFrame::new(number, "frame.vdb")))
    }

    fn scale(range: (u64, u64), width: f32) -> Scale {
        Scale::new(range, egui::Rangef::new(100.0, 100.0 + width))
    }

    fn places(numbers: &[u64], all: impl IntoIterator<Item = u64>) -> Vec<(f32, f32)> {
        let sequence = sequence(all);
        let range = sequence.range().expect("there are frames");
        let slots = (range.1 - range.0 + 1) as f32;
        let runs = runs(numbers, sequence.frames(), &scale(range, 10.0 * slots));
        runs.iter().map(|run| (run.min, run.max)).collect()
    }

    #[test]
    fn frames_in_memory_are_one_run_as_far_as_they_touch() {
        let expected = [(100.0, 120.0), (140.0, 170.0), (190.0, 200.0)];
        assert_eq!(places(&[1, 2, 5, 6, 7, 10], 1..=10), expected);
        assert_eq!(places(&[], 1..=10), []);
        // A frame takes the time until the next one.
        let expected = [(100.0, 120.0), (140.0, 170.0)];
        assert_eq!(places(&[10, 14], [10, 12, 14, 17]), [expected[0], (140.0, 170.0)]);
        assert_eq!(places(&[17], [10, 12, 14, 17]), [(170.0, 180.0)]);
    }

    #[test]
    fn many_frames_are_no_more_runs_than_pixels() {
        let all = sequence(1..=10_000);
        let scale = scale((1, 10_000), 800.0);
        let every_second: Vec<u64> = (1..=10_000).step_by(2).collect();
        assert_eq!(runs(&every_second, all.frames(), &scale).len(), 1);
        let far_apart: Vec<u64> = (1..=10_000).step_by(50).collect();
        let far_apart = runs(&far_apart, all.frames(), &scale);
        assert_eq!(far_apart.len(), 200);
        // Each can be seen.
        assert!(far_apart.iter().all(|run| run.span() >= 0.99), "{far_apart:?}");
    }

    #[test]
    fn every_place_is_that_of_its_number() {
        for (first, last) in [(1, 10), (0, 0), (990, 100_989), (u64::MAX - 3, u64::MAX)] {
            let scale = scale((first, last), 800.0);
            for number in [first, first + (last - first) / 3, last] {
                assert_eq!(scale.frame(scale.middle(number)), number);
            }
            assert_eq!((scale.frame(-1e9), scale.frame(1e9)), (first, last));
        }
    }

    #[test]
    fn numbers_are_round_and_have_room() {
        let shown = |range, slot| numbers(range, slot).collect::<Vec<_>>();
        assert_eq!(shown((1, 10), 60.0), [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
        assert_eq!(shown((1, 10), 20.0), [5, 10]);
        assert_eq!(shown((1001, 1240), 3.0), (1020..=1240).step_by(20).collect::<Vec<_>>());
        assert_eq!(shown((u64::MAX - 1, u64::MAX), 60.0), [u64::MAX - 1, u64::MAX]);
        assert!(shown((1, 100_000), 0.008).len() <= 20);
    }
}
