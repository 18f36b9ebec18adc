//! A progress bar on standard error.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use vdb_core::ProgressFn;
use vdb_core::display::escaped;

/// Characters of a file's name beside its bar.
const NAME_CHARS: usize = 40;

/// The progress of the work on one file. Shown on a terminal only, and gone once it is dropped.
pub struct Progress(ProgressBar);

impl Progress {
    /// Starts with reading, which counts bytes.
    pub fn reading(path: &Path) -> Self {
        let style = ProgressStyle::with_template("{msg} [{bar:30}] {bytes}/{total_bytes}")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ");
        // indicatif hides it by itself if standard error is not a terminal.
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
        bar.set_style(style);
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        bar.set_message(escaped(&name).at_most(NAME_CHARS).to_string());
        Self(bar)
    }

    /// The callback for the options of the work to follow.
    pub fn callback(&self) -> Arc<ProgressFn> {
        let bar = self.0.clone();
        Arc::new(move |done, all| {
            bar.set_length(all);
            // Several threads report: the bar never goes back.
            bar.set_position(bar.position().max(done));
            ControlFlow::Continue(())
        })
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
