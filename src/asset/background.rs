//! Long-running work on dedicated threads.
//!
//! Bevy compiles pipelines on its `AsyncComputeTaskPool`, which has one thread if there are few
//! cores, so occupying it for long keeps the window black. Decoding, packing and levels of detail
//! therefore have their own pools, created on first use. Without threads, as on the web, these are
//! Bevy's single-threaded pools, and work is done when it is requested.

use std::sync::LazyLock;

use bevy::tasks::{Task, TaskPool, TaskPoolBuilder, available_parallelism};
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Urgent work: as many concurrent tasks as Bevy has threads for such work. Within a task, files
/// are decoded and grids are packed on all cores.
static WAITED_FOR: LazyLock<TaskPool> = LazyLock::new(|| pool("VDB loading", cores()));

/// Work that can wait, one task at a time.
static IMPROVEMENTS: LazyLock<TaskPool> = LazyLock::new(|| pool("VDB details", 1));

/// The threads for work that can wait: few, so that frames have the other cores. `None` on
/// platforms without threads.
static IMPROVING: LazyLock<Option<ThreadPool>> = LazyLock::new(|| {
    let name = |i| format!("VDB details ({i})");
    ThreadPoolBuilder::new().num_threads(cores()).thread_name(name).build().ok()
});

/// A quarter of the cores, as Bevy reserves for its own pool.
fn cores() -> usize {
    (available_parallelism() / 4).clamp(1, 4)
}

fn pool(name: &str, threads: usize) -> TaskPool {
    TaskPoolBuilder::new().num_threads(threads).thread_name(name.into()).build()
}

/// Runs urgent work.
pub(crate) fn run<T: Send + Sync + 'static>(
    work: impl FnOnce() -> T + Send + Sync + 'static,
) -> Task<T> {
    WAITED_FOR.spawn(async move { work() })
}

/// Runs work that can wait, on few cores.
pub(crate) fn improve<T: Send + Sync + 'static>(
    work: impl FnOnce() -> T + Send + Sync + 'static,
) -> Task<T> {
    IMPROVEMENTS.spawn(async move {
        match &*IMPROVING {
            Some(few) => few.install(work),
            None => work(),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::tasks::block_on;

    /// Parallel work in the small pool does not use the threads of other pools.
    #[test]
    fn improvements_take_a_few_cores() {
        let threads =
            || (rayon::current_num_threads(), std::thread::current().name().map(String::from));
        let (count, name) = block_on(improve(threads));
        assert!(count == cores() && name.is_some_and(|name| name.starts_with("VDB details (")));
        let (_, name) = block_on(run(threads));
        assert!(name.is_some_and(|name| name.starts_with("VDB loading")));
    }

    /// Neither pool waits for the other.
    #[test]
    fn what_is_waited_for_overtakes_improvements() {
        let (go_on, held) = std::sync::mpsc::channel::<()>();
        let held = std::sync::Mutex::new(held);
        let slow = improve(move || held.lock().is_ok_and(|held| held.recv().is_ok()));
        assert_eq!(block_on(run(|| 7)), 7);
        go_on.send(()).unwrap();
        assert!(block_on(slow));
    }
}
