//! The editor of ramps.

use bevy::prelude::*;
use bevy_egui::egui::accesskit::{Action, ActionData, Role};
use bevy_vdb::prelude::*;

use crate::panel::Panel;

#[test]
fn the_stops_of_a_ramp_are_edited() {
    let mut panel = Panel::new(PackKind::Fog);
    let volume = panel.volume;
    panel.click(Role::Button, "Ramp");
    panel.click(Role::CheckBox, "map values");
    // Up to the largest value of the grid, which is its background.
    let stop = |value| VdbRampStop { value, extinction: value, ..default() };
    let plain = VdbRamp::new([stop(0.0), stop(1.0)]);
    assert_eq!(panel.get::<VdbRamp>(volume), &plain);
    panel.click(Role::Button, "add stop");
    let three = VdbRamp::new([stop(0.0), stop(0.5), stop(1.0)]);
    assert_eq!(panel.get::<VdbRamp>(volume), &three);
    let mut set = |name: &str, to: f64| {
        panel.ask(Role::SpinButton, name, Action::SetValue, Some(ActionData::NumericValue(to)));
    };
    set("value 2", 0.125);
    set("extinction 2", 8.0);
    set("emission 2", 3.0);
    panel.click(Role::Button, "remove stop 3");
    let emission = LinearRgba::rgb(3.0, 3.0, 3.0);
    let middle = VdbRampStop { value: 0.125, extinction: 8.0, emission, ..default() };
    let expected = VdbRamp::new([stop(0.0), middle]);
    assert_eq!(panel.get::<VdbRamp>(volume), &expected);
    panel.click(Role::CheckBox, "map values");
    assert!(panel.world().get::<VdbRamp>(volume).is_none());
}

#[test]
fn surfaces_have_no_ramp_to_edit() {
    let mut panel = Panel::new(PackKind::Smooth { iso: 0.0 });
    panel.click(Role::Button, "Ramp");
    panel.look();
    assert!(panel.find(Role::CheckBox, "map values").is_none());
}
