//! Memory: of grids on the GPU, and of the frames of sequences.

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_vdb::{VdbFrameCache, VdbFrameCacheUsage, VdbGpuMemory, VdbGpuUsage};

use super::widgets::table;

/// The bytes that had been written when the section was last shown.
#[derive(Default)]
pub(super) struct Written(Option<u64>);

pub(super) fn show(
    InMut(ui): InMut<egui::Ui>,
    usage: Option<Res<VdbGpuUsage>>,
    limits: Option<Res<VdbGpuMemory>>,
    (cache, frames): (Option<Res<VdbFrameCache>>, Option<Res<VdbFrameCacheUsage>>),
    mut written: Local<Written>,
) {
    let mut rows: Vec<(String, String)> = Vec::new();
    let mut row = |name: &str, value: String| rows.push((name.into(), value));
    if let (Some(usage), Some(limits)) = (usage, limits) {
        let total = usage.bytes_written();
        let new = total.saturating_sub(written.0.replace(total).unwrap_or(total));
        let grids = (usage.grids(), usage.levels(), usage.idle_grids());
        row("grids on the GPU", format!("{} displayed, {} idle", grids.0, grids.2));
        row("levels of detail", grids.1.to_string());
        row("used", of(usage.bytes_used(), usage.bytes()));
        row("limit of buffers", limit(limits.max_bytes));
        row("idle", of(usage.bytes_idle(), limits.idle_bytes));
        row("to upload", megabytes(usage.bytes_to_upload()));
        row("written, last frame", of(new, limits.upload_bytes_per_frame));
        row("written since the start", megabytes(total));
    } else {
        ui.weak("nothing is drawn on the GPU");
    }
    if let (Some(cache), Some(frames)) = (cache, frames) {
        let (count, loading) = (frames.frames(), frames.loading());
        row("frames of sequences", format!("{count} in memory, {loading} loading"));
        row("memory of frames", of(frames.bytes(), cache.bytes));
    }
    table(ui, "memory", &rows);
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

/// A part of a whole, or of what is allowed.
fn of(part: u64, whole: u64) -> String {
    match whole {
        u64::MAX => megabytes(part),
        _ => format!("{:.1} of {}", part as f64 / 1e6, megabytes(whole)),
    }
}

fn limit(bytes: u64) -> String {
    if bytes == u64::MAX { "that of the GPU".into() } else { megabytes(bytes) }
}
