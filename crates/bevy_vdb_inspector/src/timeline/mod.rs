//! A timeline of players of sequences.

mod bar;

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::{VdbPlayer, VdbPlayerStatus, VdbRepeat, VdbSequence};

use bar::{Bar, Scrub};

const REPEATS: [(&str, VdbRepeat); 3] =
    [("once", VdbRepeat::Once), ("loop", VdbRepeat::Loop), ("ping-pong", VdbRepeat::PingPong)];

/// The distance between the timeline and the edges of the window, in points.
const MARGIN: f32 = 8.0;

/// A timeline for `egui`: a bar with the frames of a sequence, on which dragging scrubs, and
/// controls of its player.
///
/// On the bar, the frames in memory are lighter, and those that cannot be shown are red. Below are
/// buttons, the number of the frame, the rate, the speed, what comes after the last frame, and the
/// number of late frames.
///
/// [`VdbInspectorPlugin`](super::VdbInspectorPlugin) shows one at the bottom of the window. An app
/// can show its own, in a system of `EguiPrimaryContextPass`:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # use bevy_vdb_inspector::VdbTimeline;
/// # use bevy_egui::EguiContexts;
/// fn timeline(
///     mut contexts: EguiContexts,
///     player: Single<(&mut VdbPlayer, &VdbPlayerStatus)>,
///     sequences: Res<Assets<VdbSequence>>,
/// ) -> Result {
///     let (player, status) = player.into_inner();
///     if let Some(sequence) = sequences.get(&player.sequence) {
///         VdbTimeline::new(&mut [player], status, sequence).show_at_bottom(contexts.ctx_mut()?);
///     }
///     Ok(())
/// }
/// ```
pub struct VdbTimeline<'a, 'w> {
    players: &'a mut [Mut<'w, VdbPlayer>],
    status: &'a VdbPlayerStatus,
    sequence: &'a VdbSequence,
}

impl<'a, 'w> VdbTimeline<'a, 'w> {
    /// A timeline of one player, or of several that play a sequence together. The status is that of
    /// the first player; what the user changes is changed in all of them.
    pub fn new(
        players: &'a mut [Mut<'w, VdbPlayer>],
        status: &'a VdbPlayerStatus,
        sequence: &'a VdbSequence,
    ) -> Self {
        Self { players, status, sequence }
    }

    /// Pauses, plays on, or plays again from the beginning after the end.
    pub fn toggle(&mut self) {
        let (plays, has_ended) = (self.plays(), self.status.has_ended());
        self.each(|player| match (plays, has_ended) {
            (true, _) => player.pause(),
            (false, true) => player.replay(),
            (false, false) => player.play(),
        });
    }

    /// Pauses, and goes forwards by this many frames of the sequence, or back. Stops at its ends.
    pub fn step(&mut self, frames: isize) {
        let Some(now) = self.status.wanted().or(self.status.frame()) else { return };
        let all = self.sequence.frames();
        let index = all.partition_point(|frame| frame.number < now).saturating_add_signed(frames);
        if let Some(frame) = all.get(index.min(all.len().saturating_sub(1))) {
            self.each(|player| {
                player.pause();
                player.seek(frame.number);
            });
        }
    }

    /// Goes to the first frame. A player that plays goes on from there.
    pub fn go_to_first(&mut self) {
        if let Some((first, _)) = self.sequence.range() {
            self.each(|player| player.seek(first));
        }
    }

    /// Goes to the last frame.
    pub fn go_to_last(&mut self) {
        if let Some((_, last)) = self.sequence.range() {
            self.each(|player| player.seek(last));
        }
    }

    /// Shows the timeline at the bottom of the window, where the panel makes room for it. Returns
    /// its height with the margin below it, in points.
    pub fn show_at_bottom(&mut self, context: &egui::Context) -> f32 {
        let window = context.content_rect();
        let inner = (window.width() - 2.0 * MARGIN).max(0.0);
        let area = egui::Area::new("bevy_vdb timeline".into())
            .anchor(egui::Align2::CENTER_BOTTOM, [0.0, -MARGIN])
            .order(egui::Order::Middle)
            .show(context, |ui| {
                let frame = egui::Frame::window(ui.style()).shadow(egui::Shadow::NONE);
                let edges = frame.total_margin().sum().x;
                frame.show(ui, |ui| {
                    ui.set_width((inner - edges).max(0.0));
                    self.show(ui);
                });
            });
        // Not from its place, which is a wrong one when it is shown for the first time.
        let height = area.response.rect.height() + MARGIN;
        let now = context.cumulative_pass_nr();
        context.data_mut(|data| data.insert_temp(place_id(), (now, height)));
        height
    }

    /// Shows the timeline in the width of a `Ui`.
    pub fn show(&mut self, ui: &mut egui::Ui) {
        let (Some(range), false) = (self.sequence.range(), self.players.is_empty()) else {
            ui.weak("the sequence has no frames");
            return;
        };
        let plays = self.plays();
        let bar = Bar { range, status: self.status, sequence: self.sequence };
        match bar.show(ui, plays) {
            Scrub::No => {}
            Scrub::Step(frames) => self.step(frames),
            Scrub::To(frame) => self.each(|player| player.seek(frame)),
            Scrub::Hold(frame) => self.each(|player| {
                player.pause();
                if let Some(frame) = frame {
                    player.seek(frame);
                }
            }),
            Scrub::Release => self.each(VdbPlayer::play),
            Scrub::Toggle => self.toggle(),
        }
        ui.horizontal_wrapped(|ui| {
            // Where the window is narrow, a row ends between controls and not within them.
            ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
            self.buttons(ui, plays);
            self.frame(ui, range);
            self.settings(ui);
            self.counts(ui);
        });
    }

    /// Whether time goes on: a player at the end of its sequence is not paused.
    fn plays(&self) -> bool {
        let is_paused = self.players.first().is_none_or(|player| player.is_paused());
        !is_paused && !self.status.has_ended()
    }

    fn each(&mut self, change: impl Fn(&mut VdbPlayer)) {
        self.players.iter_mut().for_each(|player| change(player));
    }

    fn buttons(&mut self, ui: &mut egui::Ui, plays: bool) {
        let button = |ui: &mut egui::Ui, symbol: &str, name: &str| {
            let button = ui.add(egui::Button::new(symbol).min_size(egui::vec2(26.0, 0.0)));
            named(&button, name);
            button.on_hover_text(name).clicked()
        };
        if button(ui, "⏮", "first frame") {
            self.go_to_first();
        }
        if button(ui, "‹", "previous frame") {
            self.step(-1);
        }
        if button(ui, if plays { "⏸" } else { "▶" }, if plays { "pause" } else { "play" }) {
            self.toggle();
        }
        if button(ui, "›", "next frame") {
            self.step(1);
        }
        if button(ui, "⏭", "last frame") {
            self.go_to_last();
        }
    }

    /// The number of the frame, in the width of the last one, so that nothing beside it moves.
    fn frame(&self, ui: &mut egui::Ui, (first, last): (u64, u64)) {
        let shown = self.status.frame().map_or_else(|| "–".to_owned(), |frame| frame.to_string());
        let width = last.to_string().len();
        ui.separator();
        ui.label(egui::RichText::new(format!("{shown:>width$}")).monospace().strong())
            .on_hover_text("the frame that is shown");
        ui.weak(format!("of {first}–{last}"));
        ui.separator();
    }

    fn settings(&mut self, ui: &mut egui::Ui) {
        let Some(player) = self.players.first() else { return };
        let mut rate = player.frame_rate.unwrap_or(self.sequence.rate);
        let mut speed = player.speed;
        let mut repeat = player.repeat.unwrap_or(self.sequence.repeat);
        let value = egui::DragValue::new(&mut rate).range(0.1..=1_000.0).speed(0.1);
        let value = value.clamp_existing_to_range(false).custom_formatter(number).suffix(" fps");
        let value = ui.add(value).on_hover_text("frames per second: drag, or click to type");
        named(&value, "frames per second");
        if value.changed() {
            self.each(|player| player.frame_rate = Some(rate));
        }
        let value = egui::DragValue::new(&mut speed).range(-100.0..=100.0).speed(0.01);
        let value = value.clamp_existing_to_range(false).custom_formatter(number).prefix("× ");
        let value = ui.add(value).on_hover_text("speed; negative values play backwards");
        named(&value, "speed");
        if value.changed() {
            self.each(|player| player.speed = speed);
        }
        ui.scope(|ui| {
            ui.spacing_mut().combo_width = 0.0;
            let name = REPEATS.iter().find(|(_, one)| *one == repeat).map_or("", |(name, _)| name);
            let before = repeat;
            let list = egui::ComboBox::from_id_salt("repeat").selected_text(name);
            let list = list.show_ui(ui, |ui| {
                for (name, one) in REPEATS {
                    if ui.selectable_value(&mut repeat, one, name).clicked() {
                        ui.close();
                    }
                }
            });
            named(&list.response.on_hover_text("after the last frame"), "repeat");
            if repeat != before {
                self.each(|player| player.repeat = Some(repeat));
            }
        });
        ui.separator();
    }

    fn counts(&self, ui: &mut egui::Ui) {
        let (status, frames) = (self.status, self.sequence.frames().len());
        ui.weak(format!("{} of {frames} in memory", status.loaded().len()));
        let late = status.late();
        let text = egui::RichText::new(format!("{late} late"));
        let color =
            if late > 0 { ui.visuals().warn_fg_color } else { ui.visuals().weak_text_color() };
        ui.label(text.color(color))
            .on_hover_text("frames that were dropped, because they were not loaded in time");
        let failed = status.failed().len();
        if failed > 0 {
            ui.colored_label(ui.visuals().error_fg_color, format!("{failed} failed"))
                .on_hover_text("frames that cannot be shown; the reasons are logged");
        }
    }
}

/// A number with at most three decimals, and only those that it needs.
fn number(value: f64, _: std::ops::RangeInclusive<usize>) -> String {
    ((value * 1e3).round() / 1e3).to_string()
}

/// Names a control for screen readers.
fn named(control: &egui::Response, name: &str) {
    control.ctx.accesskit_node_builder(control.id, |node| node.set_label(name));
}

fn place_id() -> egui::Id {
    egui::Id::new("bevy_vdb timeline place")
}

/// The height of the timeline at the bottom of the window, with its margin; 0 if there is none.
pub(super) fn height_at_bottom(context: &egui::Context) -> f32 {
    let now = context.cumulative_pass_nr();
    let place: Option<(u64, f32)> = context.data(|data| data.get_temp(place_id()));
    // In the pass after the last one that showed it, it may be shown later.
    place.filter(|(pass, _)| now <= pass + 1).map_or(0.0, |(_, height)| height)
}
