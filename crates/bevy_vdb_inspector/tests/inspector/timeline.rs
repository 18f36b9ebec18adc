//! The timeline of a sequence: what it shows, and what is done with it.

use std::time::Duration;

use bevy::prelude::*;
use bevy::time::TimeUpdateStrategy;
use bevy_egui::egui::accesskit::{Action, ActionData, Role};
use bevy_egui::{EguiContext, EguiRenderOutput, egui};
use bevy_vdb::prelude::*;
use bevy_vdb_inspector::VdbInspector;

use crate::panel::Panel;
use crate::{files, sequence_files};

/// The panel, with a player of ten frames whose time stands still.
struct Timeline {
    panel: Panel,
    player: Entity,
}

impl Timeline {
    fn new(test: &str, frames_ahead: usize, broken: Option<u64>) -> Self {
        let folder = files::temporary("inspector", test);
        sequence_files::save(&folder, 1..=10);
        if let Some(number) = broken {
            let path = folder.join(format!("smoke_{number:04}.vdb"));
            std::fs::write(path, "not a volume").expect("it is written");
        }
        let mut panel = Panel::new(PackKind::Fog);
        panel.app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::ZERO));
        panel.app.insert_resource(VdbFrameCache { frames_ahead, ..default() });
        let path = folder.to_str().expect("a path in UTF-8");
        let sequence = panel.world().resource::<AssetServer>().load_vdb_sequence(path);
        let player = panel.world().spawn(VdbPlayer::new(sequence)).id();
        let mut timeline = Self { panel, player };
        timeline.until(|timeline| timeline.status().loaded().len() > frames_ahead);
        timeline
    }

    fn until(&mut self, holds: impl Fn(&Self) -> bool) {
        for _ in 0..4_000 {
            if holds(self) {
                return;
            }
            self.panel.frames(1);
            std::thread::sleep(Duration::from_millis(2));
        }
        panic!("it did not come: {:?}", self.status());
    }

    fn status(&self) -> &VdbPlayerStatus {
        self.panel.get(self.player)
    }

    fn player(&self) -> &VdbPlayer {
        self.panel.get(self.player)
    }

    fn says(&mut self, what: &str) -> bool {
        self.panel.look();
        let holds = |text: Option<&str>| text.is_some_and(|text| text.contains(what));
        self.panel.nodes.iter().any(|(_, node)| holds(node.label()) || holds(node.value()))
    }

    /// The place of the bar.
    fn bar(&mut self) -> egui::Rect {
        self.panel.look();
        let node = &self.panel.find(Role::Slider, "frame").expect("the bar").1;
        let place = node.bounds().expect("it has a place");
        let [x0, y0, x1, y1] = [place.x0, place.y0, place.x1, place.y1].map(|x| x as f32);
        egui::Rect::from_min_max(egui::pos2(x0, y0), egui::pos2(x1, y1))
    }

    /// The middle of a frame on the bar.
    fn place(&mut self, frame: u64) -> egui::Pos2 {
        let bar = self.bar();
        let part = (frame as f32 - 0.5) / 10.0;
        egui::pos2(bar.left() + part * bar.width(), bar.top() + 8.0)
    }

    fn point(&mut self, frame: u64) {
        let place = self.place(frame);
        self.panel.frame([egui::Event::PointerMoved(place)]);
        self.panel.frames(2);
    }

    fn button(&mut self, frame: u64, pressed: bool) {
        let (pos, button) = (self.place(frame), egui::PointerButton::Primary);
        let modifiers = egui::Modifiers::NONE;
        self.panel.frame([egui::Event::PointerButton { pos, button, pressed, modifiers }]);
        self.panel.frames(2);
    }

    /// From where to where something of a colour is drawn on the bar, in frames: a frame begins at
    /// its number.
    fn drawn(&mut self, color: impl Fn(&egui::Visuals) -> egui::Color32) -> Vec<(f32, f32)> {
        let bar = self.bar().expand(2.0);
        let world = self.panel.app.world_mut();
        let mut context = world.get_mut::<EguiContext>(self.panel.camera).expect("egui");
        let color = color(&context.get_mut().global_style().visuals);
        let output = world.get::<EguiRenderOutput>(self.panel.camera).expect("it is drawn");
        let bar = bar.shrink(2.0);
        let mut places = Vec::new();
        for job in &output.paint_jobs {
            let egui::epaint::Primitive::Mesh(mesh) = &job.primitive else { continue };
            let own = mesh.vertices.iter().filter(|v| v.color == color && bar.contains(v.pos));
            places.extend(own.map(|v| 1.0 + 10.0 * (v.pos.x - bar.left()) / bar.width()));
        }
        // Edges are less than a twentieth of a frame wide.
        places.sort_by(f32::total_cmp);
        places.dedup_by(|a, b| (*a - *b).abs() < 0.05);
        assert!(places.len().is_multiple_of(2), "{places:?}");
        places.chunks_exact(2).map(|ends| (ends[0], ends[1])).collect()
    }
}

fn is_loaded(visuals: &egui::Visuals) -> egui::Color32 {
    visuals.extreme_bg_color.lerp_to_gamma(visuals.text_color(), 0.45)
}

/// Whether places on the bar are those of frames, to a twentieth of one.
fn are(places: &[(f32, f32)], expected: &[(f32, f32)]) -> bool {
    let is = |(a, b): (&(f32, f32), &(f32, f32))| (a.0 - b.0).abs() + (a.1 - b.1).abs() < 0.1;
    places.len() == expected.len() && places.iter().zip(expected).all(is)
}

#[test]
fn dragging_scrubs_and_plays_on_afterwards() {
    let mut timeline = Timeline::new("scrub", 8, None);
    for plays in [true, false] {
        let entity = timeline.player;
        let mut player = timeline.panel.world().get_mut::<VdbPlayer>(entity).expect("it");
        if plays {
            player.play()
        } else {
            player.pause()
        }
        player.seek(1);
        timeline.until(|timeline| timeline.status().frame() == Some(1));
        timeline.point(4);
        assert_eq!(timeline.status().wanted(), Some(1), "the mouse alone does nothing");
        timeline.button(4, true);
        assert!(timeline.player().is_paused());
        for frame in [4, 9, 2] {
            timeline.point(frame);
            timeline.until(|timeline| timeline.status().frame() == Some(frame));
            assert_eq!(timeline.status().wanted(), Some(frame));
        }
        assert!(timeline.player().is_paused());
        timeline.button(2, false);
        assert_eq!(timeline.player().is_paused(), !plays);
        timeline.point(7);
        assert_eq!(timeline.status().wanted(), Some(2), "it has been let go");
    }
    // Beyond the ends, the ends.
    timeline.button(9, true);
    let beyond = timeline.bar().right_center() + egui::vec2(500.0, 300.0);
    timeline.panel.frame([egui::Event::PointerMoved(beyond)]);
    timeline.until(|timeline| timeline.status().frame() == Some(10));
}

#[test]
fn a_click_seeks_without_a_pause() {
    let mut timeline = Timeline::new("click", 8, None);
    let (pos, button) = (timeline.place(6), egui::PointerButton::Primary);
    let modifiers = egui::Modifiers::NONE;
    let event = |pressed| egui::Event::PointerButton { pos, button, pressed, modifiers };
    timeline.panel.frame([egui::Event::PointerMoved(pos)]);
    timeline.panel.frame([event(true), event(false)]);
    timeline.panel.frames(3);
    assert_eq!(timeline.status().wanted(), Some(6));
    assert!(!timeline.player().is_paused());
}

#[test]
fn frames_in_memory_and_failed_ones_are_drawn_where_they_are() {
    let mut timeline = Timeline::new("drawn", 2, Some(8));
    timeline.until(|timeline| timeline.status().loaded() == [1, 2, 3]);
    let loaded = timeline.drawn(is_loaded);
    assert!(are(&loaded, &[(1.0, 4.0)]), "{loaded:?}");
    let failed = timeline.drawn(|visuals| visuals.error_fg_color);
    assert!(failed.is_empty(), "{failed:?}");
    let entity = timeline.player;
    timeline.panel.world().get_mut::<VdbPlayer>(entity).expect("it").seek(7);
    timeline.until(|timeline| timeline.status().loaded() == [1, 2, 3, 7, 9]);
    let loaded = timeline.drawn(is_loaded);
    assert!(are(&loaded, &[(1.0, 4.0), (7.0, 8.0), (9.0, 10.0)]), "{loaded:?}");
    let failed = timeline.drawn(|visuals| visuals.error_fg_color);
    assert!(are(&failed, &[(8.0, 9.0)]), "{failed:?}");
    assert!(timeline.says("5 of 10 in memory") && timeline.says("1 failed"));
}

#[test]
fn late_frames_are_counted() {
    let mut timeline = Timeline::new("late", 0, None);
    assert!(timeline.says("0 late"));
    // A frame per update, and none is loaded ahead.
    let step = TimeUpdateStrategy::ManualDuration(Duration::from_nanos(41_666_667));
    timeline.panel.app.insert_resource(step);
    timeline.panel.frames(4);
    timeline.panel.app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::ZERO));
    let late = timeline.status().late();
    assert!((1..=4).contains(&late), "{late}");
    assert!(timeline.says(&format!("{late} late")));
}

#[test]
fn controls_of_a_timeline_change_the_player() {
    let mut timeline = Timeline::new("controls", 8, None);
    let wanted = |timeline: &Timeline| timeline.status().wanted();
    timeline.panel.click(Role::Button, "pause");
    assert!(timeline.player().is_paused());
    timeline.panel.click(Role::Button, "next frame");
    timeline.panel.click(Role::Button, "next frame");
    assert_eq!(wanted(&timeline), Some(3));
    timeline.panel.click(Role::Button, "previous frame");
    assert_eq!(wanted(&timeline), Some(2));
    assert!(timeline.player().is_paused());
    timeline.panel.click(Role::Button, "last frame");
    assert_eq!(wanted(&timeline), Some(10));
    timeline.panel.click(Role::Button, "next frame");
    assert_eq!(wanted(&timeline), Some(10), "there is none");
    timeline.panel.click(Role::Button, "first frame");
    assert_eq!(wanted(&timeline), Some(1));
    timeline.panel.slide("frame", 7.0);
    assert_eq!(wanted(&timeline), Some(7));
    timeline.panel.click(Role::Button, "play");
    assert!(!timeline.player().is_paused());

    timeline.panel.ask(Role::Slider, "frame", Action::Focus, None);
    timeline.panel.press(egui::Key::ArrowRight);
    assert_eq!(wanted(&timeline), Some(8));
    timeline.panel.press(egui::Key::Home);
    assert_eq!(wanted(&timeline), Some(1));
    timeline.panel.press(egui::Key::Space);
    assert!(!timeline.player().is_paused(), "a step has paused, and Space plays on");

    timeline.panel.choose("repeat", "ping-pong");
    assert_eq!(timeline.player().repeat, Some(VdbRepeat::PingPong));
    for (name, value) in [("frames per second", 30.0), ("speed", -0.5)] {
        let value = Some(ActionData::NumericValue(value));
        timeline.panel.ask(Role::SpinButton, name, Action::SetValue, value);
    }
    assert_eq!((timeline.player().frame_rate, timeline.player().speed), (Some(30.0), -0.5));
}

/// A sequence that is played once is played again from its end.
#[test]
fn play_at_the_end_begins_again() {
    let mut timeline = Timeline::new("end", 9, None);
    timeline.panel.choose("repeat", "once");
    timeline.panel.click(Role::Button, "last frame");
    let step = TimeUpdateStrategy::ManualDuration(Duration::from_millis(100));
    timeline.panel.app.insert_resource(step);
    timeline.until(|timeline| timeline.status().has_ended());
    timeline.panel.app.insert_resource(TimeUpdateStrategy::ManualDuration(Duration::ZERO));
    timeline.panel.click(Role::Button, "play");
    assert_eq!((timeline.status().wanted(), timeline.status().has_ended()), (Some(1), false));
}

#[test]
fn nothing_is_changed_by_a_timeline_that_nobody_touches() {
    let mut timeline = Timeline::new("untouched", 8, None);
    #[derive(Default, Resource)]
    struct Changed(usize);
    timeline.panel.app.init_resource::<Changed>().add_systems(
        Last,
        |players: Query<Ref<VdbPlayer>>, mut changed: ResMut<Changed>| {
            changed.0 += players.iter().filter(|player| player.is_changed()).count();
        },
    );
    timeline.panel.frames(1);
    let before = timeline.panel.world().resource::<Changed>().0;
    timeline.point(5);
    timeline.panel.frames(3);
    assert_eq!(timeline.panel.world().resource::<Changed>().0, before);
    timeline.panel.click(Role::Button, "pause");
    assert!(timeline.panel.world().resource::<Changed>().0 > before);
}

#[test]
fn the_timeline_goes_with_the_panel() {
    let mut timeline = Timeline::new("closed", 2, None);
    let bar = timeline.bar();
    assert!(bar.width() > 1_000.0 && bar.bottom() < 720.0, "{bar:?}");
    // The panel ends above it, and takes the height that is left.
    let window = timeline.panel.find(Role::Window, "bevy_vdb").expect("the panel");
    let bottom = window.1.bounds().expect("it has a place").y1 as f32;
    assert!((500.0..bar.top()).contains(&bottom), "{bottom} {bar:?}");
    timeline.panel.world().resource_mut::<VdbInspector>().timeline = false;
    timeline.panel.look();
    assert!(timeline.panel.find(Role::Slider, "frame").is_none());
    assert!(timeline.panel.find(Role::Button, "Volumes").is_some());
    let mut inspector = timeline.panel.world().resource_mut::<VdbInspector>();
    (inspector.timeline, inspector.open) = (true, false);
    timeline.panel.look();
    assert!(timeline.panel.find(Role::Slider, "frame").is_none());
}

#[test]
fn the_memory_of_frames_is_shown_beside_its_ceiling() {
    let mut timeline = Timeline::new("memory", 2, None);
    timeline.panel.app.insert_resource(VdbFrameCache {
        frames_ahead: 2,
        bytes: 3 << 30,
        ..default()
    });
    timeline.panel.click(Role::Button, "Memory");
    assert!(timeline.says("3 in memory, 0 loading"));
    let usage = *timeline.panel.world().resource::<VdbFrameCacheUsage>();
    let shown = format!("{:.1} of 3221.2 MB", usage.bytes() as f64 / 1e6);
    assert!(usage.frames() == 3 && timeline.says(&shown), "{shown}");
}
