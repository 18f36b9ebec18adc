//! What the dial makes of a flight through a scene: whether it keeps to a budget.

use std::fmt::Write as _;

use bevy::prelude::*;
use bevy_vdb::{VdbDial, VdbQuality};

use crate::common::Stage;
use crate::newest_times;
use crate::scenes::Scene;

/// Frames from cut to cut, and cuts.
const SHOT: usize = 150;
const SHOTS: usize = 4;
/// Frames after a cut in which the dial may look for its mark.
const SETTLING: usize = 30;

/// Flights at each budget, as a table: of all frames but those after cuts, the part that took more than a tenth
/// above the budget, and how long 95 of 100 took at most.
pub fn flights(
    stage: &mut Stage,
    scene: &Scene,
    (target, camera): (&Handle<Image>, Entity),
    budgets: &[f32],
) -> Result<String, String> {
    let mut text = format!(
        "## {}\n\n| budget, ms | frames | median | 95 % below | of the budget | above 110 % of it | \
         turns between cuts and 30 frames after |\n|---|---|---|---|---|---|---|\n",
        scene.name
    );
    stage.picture(target);
    for &frame_ms in budgets {
        let quality = scene.base(VdbQuality::HIGH);
        let dial = VdbDial::Budget { frame_ms };
        stage.world().entity_mut(camera).insert((quality, dial));
        let (mut times, mut turns) = (Vec::new(), 0);
        let (mut last, mut before) = (None, quality);
        for frame in 0..SHOTS * SHOT {
            let view = flight(scene.eye, frame);
            *stage.world().get_mut::<Transform>(camera).ok_or("no camera")? = view;
            stage.update(1);
            let now = *stage.world().get::<VdbQuality>(camera).ok_or("no camera")?;
            let Some((at, passes)) = newest_times(stage.world()) else { continue };
            let is_new = last.replace(at) != Some(at);
            if frame % SHOT >= SETTLING {
                turns += usize::from(now != before);
                if is_new {
                    times.push(passes.iter().sum::<f64>());
                }
            }
            before = now;
        }
        if times.is_empty() {
            return Err("the adapter has no timestamp queries within encoders and passes".into());
        }
        times.sort_by(f64::total_cmp);
        let budget = f64::from(frame_ms);
        let above = times.iter().filter(|ms| **ms > 1.1 * budget).count();
        let least = times[times.len() * 95 / 100];
        let _ = writeln!(
            text,
            "| {frame_ms} | {} | {:.3} | {least:.3} | {:.0} % | {:.1} % | {turns} |",
            times.len(),
            times[times.len() / 2],
            100.0 * least / budget,
            100.0 * above as f64 / times.len() as f64,
        );
    }
    stage.world().entity_mut(camera).remove::<VdbDial>();
    println!("{}: {} flights", scene.name, budgets.len());
    Ok(text + "\n")
}

/// Half a turn around the middle of the scene in each shot, in and out again, each from a height and a
/// distance of its own.
fn flight(eye: Vec3, frame: usize) -> Transform {
    let (shot, part) = (frame / SHOT, (frame % SHOT) as f32 / SHOT as f32);
    let turn = Quat::from_rotation_y(std::f32::consts::PI * part + shot as f32);
    let away = [1.0, 2.5, 0.8, 1.6, 4.0][shot % SHOTS];
    let breath = 1.0 + 0.25 * (std::f32::consts::TAU * part).sin();
    Transform::from_translation(turn * eye * away * breath).looking_at(Vec3::ZERO, Vec3::Y)
}
