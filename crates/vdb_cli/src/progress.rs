//! A progress bar on standard error.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use vdb_core::ProgressFn;
use vdb_core::display::escaped;

/// The most characters of a file's name to show beside the bar.
const NAME_CHARS: usize = 40;

/// The progress of the work on one file. Shown only on a terminal, and cleared when dropped.
pub struct Progress(ProgressBar);

impl Progress {
    /// Starts a bar for reading, in bytes.
    pub fn reading(path: &Path) -> Self {
        Self::with_template(path, "{msg} [{bar:30}] {bytes}/{total_bytes}")
    }

    /// Starts a bar for cooking, in percent.
    pub fn cooking(path: &Path) -> Self {
        Self::with_template(path, "{msg} [{bar:30}] cooking, {percent} %")
    }

    /// Starts a bar for making a volume or a mesh, in percent.
    pub fn making(path: &Path) -> Self {
        Self::with_template(path, "{msg} [{bar:30}] {percent} %")
    }

    fn with_template(path: &Path, template: &str) -> Self {
        let style = ProgressStyle::with_template(template)
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ");
        // indicatif hides the bar if standard error is not a terminal.
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
        bar.set_style(style);
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        bar.set_message(escaped(&name).at_most(NAME_CHARS).to_string());
        Self(bar)
    }

    /// A callback for reading or cooking.
    pub fn callback(&self) -> Arc<ProgressFn> {
        let bar = self.0.clone();
        Arc::new(move |done, all| {
            bar.set_length(all);
            // Calls from several threads may arrive out of order; the bar never moves back.
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
