//! Progress of files that are being loaded.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::asset::AssetPath;
use bevy::prelude::*;
use vdb_core::ProgressFn;

/// Progress of the files that are being loaded: a resource. A loaded grid is not necessarily on
/// screen yet; see [`VdbVolumeState`](crate::VdbVolumeState).
#[derive(Clone, Debug, Default, Resource)]
pub struct VdbLoadProgress {
    files: Arc<Mutex<Files>>,
}

/// Progress of one file.
#[derive(Clone, Debug, PartialEq)]
pub struct VdbFileProgress {
    /// The file.
    pub path: AssetPath<'static>,
    /// The size of the file in bytes. If the source does not report it, 0 until the file has been read.
    pub bytes: u64,
    /// The bytes that have been decoded.
    pub bytes_decoded: u64,
    /// The fraction of its grids that has been packed for the GPU, from 0 to 1.
    pub packed: f32,
}

impl VdbFileProgress {
    /// The total progress, from 0 to 1: half for decoding, half for packing. 0 while the file is
    /// being read.
    pub fn fraction(&self) -> f32 {
        let decoded =
            if self.bytes == 0 { 0.0 } else { self.bytes_decoded as f32 / self.bytes as f32 };
        0.5 * (decoded + self.packed)
    }
}

impl VdbLoadProgress {
    /// The files being loaded, the earliest first.
    pub fn files(&self) -> Vec<VdbFileProgress> {
        self.lock().loading.iter().map(|entry| entry.file.clone()).collect()
    }

    /// The progress of all files since loading began, from 0 to 1, weighted by size. `None` if no
    /// file is being loaded.
    ///
    /// Loading begins with the first file that is loaded while no other is. Files that have ended
    /// since then count as done, whether they were loaded, failed or were cancelled. The fraction
    /// therefore decreases only when another file is added, or when a file of unknown size has been
    /// read.
    pub fn fraction(&self) -> Option<f32> {
        let files = self.lock();
        let done = |entry: &Entry| entry.weight() as f64 * f64::from(entry.file.fraction());
        let all = files.ended + files.loading.iter().map(Entry::weight).sum::<u64>();
        let done = files.ended as f64 + files.loading.iter().map(done).sum::<f64>();
        (!files.loading.is_empty()).then(|| (done / all as f64) as f32)
    }

    /// Whether no file is being loaded.
    pub(super) fn is_idle(&self) -> bool {
        self.lock().loading.is_empty()
    }

    fn lock(&self) -> MutexGuard<'_, Files> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[derive(Debug, Default)]
struct Files {
    /// The files being loaded, the earliest first.
    loading: Vec<Entry>,
    /// The weight of the files that have ended since loading began.
    ended: u64,
}

impl Files {
    /// Removes a file that has been loaded, has failed or was cancelled.
    fn end(&mut self, job: &Arc<Job>) {
        let place = self.loading.iter().position(|entry| Arc::ptr_eq(&entry.job, job));
        let Some(entry) = place.map(|place| self.loading.remove(place)) else { return };
        self.ended = if self.loading.is_empty() { 0 } else { self.ended + entry.weight() };
    }
}

#[derive(Debug)]
struct Entry {
    file: VdbFileProgress,
    /// Grids to pack, and grids packed.
    grids: usize,
    grids_packed: usize,
    job: Arc<Job>,
}

impl Entry {
    /// The weight of the file in the total progress. Not 0 even for empty files, so sums of weights
    /// are not 0 either.
    fn weight(&self) -> u64 {
        self.file.bytes.max(1)
    }
}

/// A file being loaded. When the last handle to an asset is dropped, Bevy drops the task that loads
/// it and, with it, this guard, which cancels the work.
pub(crate) struct Running(Arc<Job>);

/// The progress that the work reports.
#[derive(Debug)]
pub(crate) struct Job {
    progress: VdbLoadProgress,
    wanted: AtomicBool,
}

impl Running {
    /// Adds a file that is about to be read; `bytes` is its size, or 0 if that is not known.
    pub fn new(progress: &VdbLoadProgress, path: &AssetPath<'static>, bytes: u64) -> Self {
        let job = Arc::new(Job { progress: progress.clone(), wanted: AtomicBool::new(true) });
        let file = VdbFileProgress { path: path.clone(), bytes, bytes_decoded: 0, packed: 0.0 };
        let entry = Entry { file, grids: 1, grids_packed: 0, job: job.clone() };
        progress.lock().loading.push(entry);
        Self(job)
    }

    pub fn job(&self) -> Arc<Job> {
        self.0.clone()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.0.wanted.store(false, Ordering::Relaxed);
        self.0.progress.lock().end(&self.0);
    }
}

impl Job {
    /// Sets the number of bytes to decode, once the file has been read.
    pub fn begin_decoding(self: &Arc<Self>, bytes: u64) {
        self.with_entry(|entry| entry.file.bytes = bytes);
    }

    /// The callback of the decoder.
    pub fn decoding(self: &Arc<Self>) -> Arc<ProgressFn> {
        self.report(|entry, done, all| {
            entry.file.bytes = all;
            // Reports of several threads may arrive out of order.
            entry.file.bytes_decoded = done.max(entry.file.bytes_decoded);
        })
    }

    /// The callback of packing a grid.
    pub fn packing(self: &Arc<Self>) -> Arc<ProgressFn> {
        self.report(|entry, done, all| {
            let part = if all == 0 { 0.0 } else { done as f32 / all as f32 };
            let packed = (entry.grids_packed as f32 + part) / entry.grids as f32;
            entry.file.packed = entry.file.packed.max(packed.min(1.0));
        })
    }

    /// Sets the number of grids to pack.
    pub fn begin_packing(self: &Arc<Self>, grids: usize) {
        self.with_entry(|entry| entry.grids = grids.max(1));
    }

    /// Counts another packed grid.
    pub fn end_grid(self: &Arc<Self>) {
        self.with_entry(|entry| {
            entry.grids_packed += 1;
            entry.file.packed = (entry.grids_packed as f32 / entry.grids as f32).min(1.0);
        });
    }

    fn report(
        self: &Arc<Self>,
        note: impl Fn(&mut Entry, u64, u64) + Send + Sync + 'static,
    ) -> Arc<ProgressFn> {
        let job = self.clone();
        Arc::new(move |done, all| {
            if !job.wanted.load(Ordering::Relaxed) {
                return ControlFlow::Break(());
            }
            job.with_entry(|entry| note(entry, done, all));
            ControlFlow::Continue(())
        })
    }

    fn with_entry(self: &Arc<Self>, note: impl FnOnce(&mut Entry)) {
        let mut files = self.progress.lock();
        if let Some(entry) = files.loading.iter_mut().find(|entry| Arc::ptr_eq(&entry.job, self)) {
            note(entry);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoding_and_packing_are_told_apart_and_added_up() {
        let progress = VdbLoadProgress::default();
        assert_eq!(progress.fraction(), None);
        let path = AssetPath::parse("smoke.vdb");
        let (running, twin) =
            (Running::new(&progress, &path, 100), Running::new(&progress, &path, 300));
        assert_eq!(progress.fraction(), Some(0.0));
        let job = running.job();
        let (decoding, packing) = (job.decoding(), job.packing());
        assert!(decoding(60, 100).is_continue() && decoding(40, 100).is_continue());
        assert_eq!(progress.files()[0].bytes_decoded, 60, "it went back");
        assert!(decoding(100, 100).is_continue());
        assert_eq!(progress.files()[0].fraction(), 0.5);
        job.begin_packing(2);
        assert!(packing(1, 2).is_continue());
        assert_eq!(progress.files()[0].packed, 0.25);
        // The number of steps may grow.
        assert!(packing(1, 4).is_continue());
        assert_eq!(progress.files()[0].packed, 0.25);
        job.end_grid();
        job.end_grid();
        assert_eq!(progress.files()[0].fraction(), 1.0);
        assert_eq!(progress.fraction(), Some(0.25));
        drop(running);
        assert!(packing(2, 2).is_break(), "nobody wants it any more");
        assert_eq!(progress.files().len(), 1, "another load of the file goes on");
        assert!(twin.job().decoding()(300, 300).is_continue());
        drop(twin);
        assert_eq!(progress.files(), []);
    }

    #[test]
    fn files_that_have_ended_count_until_all_have() {
        let progress = VdbLoadProgress::default();
        let path = AssetPath::parse("smoke.vdb");
        // The size of the second is known once it has been read.
        let (first, second) =
            (Running::new(&progress, &path, 100), Running::new(&progress, &path, 0));
        second.job().begin_decoding(300);
        assert_eq!(progress.fraction(), Some(0.0));
        drop(first);
        assert_eq!(progress.fraction(), Some(0.25));
        assert!(second.job().decoding()(300, 300).is_continue());
        assert_eq!(progress.fraction(), Some(0.625));
        let third = Running::new(&progress, &path, 100);
        assert_eq!(progress.fraction(), Some(0.5), "another file joins");
        drop(second);
        assert_eq!(progress.fraction(), Some(0.8));
        drop(third);
        assert_eq!(progress.fraction(), None);
        let empty = Running::new(&progress, &path, 0);
        assert_eq!(progress.fraction(), Some(0.0), "loading begins anew");
        drop(empty);
        assert_eq!(progress.fraction(), None);
    }
}
