//! Recording of the camera.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::{
    VdbRecordClock, VdbRecordEnded, VdbRecordFormat, VdbRecordPhase, VdbRecordSettings, VdbRecorder,
};

use super::state::VdbInspector;

const FORMATS: [(&str, VdbRecordFormat); 3] = [
    ("PNG files", VdbRecordFormat::PngSequence),
    ("MP4", VdbRecordFormat::Mp4),
    ("WebM", VdbRecordFormat::WebM),
];
const CLOCKS: [(&str, VdbRecordClock); 2] =
    [("every frame", VdbRecordClock::FixedStep), ("in real time", VdbRecordClock::RealTime)];

/// Settings of the next recording.
pub(super) struct Next(VdbRecordSettings, String, Option<String>);

impl Default for Next {
    fn default() -> Self {
        let target = String::from("recording");
        Self(VdbRecordSettings::new(&target, VdbRecordFormat::PngSequence), target, None)
    }
}

/// Whether the app can record.
pub(super) fn is_there(world: &World) -> bool {
    world.contains_resource::<Messages<VdbRecordEnded>>()
}

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    mut commands: Commands,
    inspector: Res<VdbInspector>,
    mut recorders: Query<&mut VdbRecorder>,
    mut next: Local<Next>,
) {
    let Some(camera) = inspector.camera else { return };
    let Next(settings, target, refused) = &mut *next;
    let status = recorders.get(camera).map(VdbRecorder::status).unwrap_or_default();
    let busy = [VdbRecordPhase::Recording, VdbRecordPhase::Finishing].contains(&status.phase);
    ui.add_enabled_ui(!busy, |ui| {
        if super::widgets::pick(ui, "format", &mut settings.format, &FORMATS) {
            let stem = target.trim_end_matches(".mp4").trim_end_matches(".webm").to_owned();
            *target = match settings.format {
                VdbRecordFormat::PngSequence => stem,
                VdbRecordFormat::Mp4 => stem + ".mp4",
                VdbRecordFormat::WebM => stem + ".webm",
            };
        }
        let what = match settings.format {
            VdbRecordFormat::PngSequence => "folder",
            _ => "file",
        };
        ui.horizontal(|ui| {
            let edit = egui::TextEdit::singleline(target).desired_width(0.5 * super::WIDTH);
            let edit = ui.add(edit);
            edit.labelled_by(ui.label(what).id);
        });
        ui.checkbox(&mut settings.overwrite, "overwrite");
        super::widgets::pick(ui, "time", &mut settings.clock, &CLOCKS);
        ui.add(super::widgets::slider(&mut settings.frame_rate, 1..=120).text("frames per second"));
    });
    match status.phase {
        VdbRecordPhase::Idle | VdbRecordPhase::Ended => {
            if ui.button("Record").clicked() {
                settings.target = target.as_str().into();
                let mut recorder = VdbRecorder::default();
                let started = match recorders.get_mut(camera) {
                    Ok(mut own) => own.start(settings.clone()),
                    Err(_) => {
                        let started = recorder.start(settings.clone());
                        commands.entity(camera).insert(recorder);
                        started
                    }
                };
                *refused = started.err().map(|error| error.to_string());
            }
        }
        VdbRecordPhase::Recording => {
            if ui.button("Stop").clicked()
                && let Ok(recorder) = recorders.get(camera)
            {
                recorder.stop();
            }
        }
        VdbRecordPhase::Finishing => _ = ui.label("writing the last frames …"),
    }
    if status.phase != VdbRecordPhase::Idle {
        let (written, dropped) = (status.written, status.dropped);
        ui.label(format!("{written} frames written, {dropped} dropped"));
    }
    let error = refused.clone().or_else(|| status.error.map(|error| error.to_string()));
    if let Some(error) = error {
        super::widgets::complain(ui, error);
    }
}
