//! Detection of encoders that make no progress, so that the app does not wait for them forever.

use std::process::{Child, ExitStatus};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Signs of progress of an encoder thread, and the means to end it.
#[derive(Debug, Default)]
pub(super) struct Pulse {
    beats: AtomicU64,
    /// Whether the encoder has nothing to do and waits for the next frame.
    idle: AtomicBool,
    given_up: AtomicBool,
    /// The encoding program, if there is one.
    child: Mutex<Option<Child>>,
}

impl Pulse {
    /// Reports that the encoder has completed a part of its work.
    pub fn beat(&self) {
        self.beats.fetch_add(1, Ordering::Relaxed);
    }

    pub fn set_idle(&self, idle: bool) {
        self.beat();
        self.idle.store(idle, Ordering::SeqCst);
    }

    /// Whether the encoder has been abandoned; its unfinished work stays unfinished.
    pub fn is_given_up(&self) -> bool {
        self.given_up.load(Ordering::SeqCst)
    }

    /// Kills the program, and abandons the encoder thread, which may hang in a system call.
    pub fn give_up(&self) {
        self.given_up.store(true, Ordering::SeqCst);
        if let Some(child) = &mut *self.child() {
            child.kill().ok();
        }
    }

    /// Stores the program, so that [`give_up`](Self::give_up) can kill it; kills it at once if the
    /// encoder was abandoned while the program was being started.
    pub fn guard(&self, mut child: Child) {
        let mut guarded = self.child();
        if self.is_given_up() {
            child.kill().ok();
        }
        *guarded = Some(child);
    }

    /// Whether there is a program.
    pub fn has_child(&self) -> bool {
        self.child().is_some()
    }

    /// The program's exit status, if it has exited.
    pub fn try_wait(&self) -> std::io::Result<Option<ExitStatus>> {
        self.child().as_mut().map_or(Ok(None), Child::try_wait)
    }

    fn child(&self) -> MutexGuard<'_, Option<Child>> {
        self.child.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The time without a sign of progress.
#[derive(Debug)]
pub(super) struct Patience {
    beats: u64,
    quiet: Duration,
    looked: Instant,
}

/// The longest time between two checks that counts. If more has passed, the app itself was
/// suspended or in a debugger, and the encoder may have had no chance to run.
const LONGEST_LOOK: Duration = Duration::from_secs(1);

impl Patience {
    pub fn new(now: Instant) -> Self {
        Self { beats: 0, quiet: Duration::ZERO, looked: now }
    }

    /// Whether there has been no sign of progress for longer than the limit.
    pub fn is_over(&mut self, pulse: &Pulse, limit: Duration, now: Instant) -> bool {
        let beats = pulse.beats.load(Ordering::Relaxed);
        let looked = std::mem::replace(&mut self.looked, now);
        if pulse.idle.load(Ordering::SeqCst) || beats != self.beats {
            (self.beats, self.quiet) = (beats, Duration::ZERO);
            return false;
        }
        self.quiet += now.saturating_duration_since(looked).min(LONGEST_LOOK);
        self.quiet > limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_time_in_which_the_encoder_could_get_on_counts() {
        let (pulse, start) = (Pulse::default(), Instant::now());
        let at = |seconds: f64| start + Duration::from_secs_f64(seconds);
        let limit = Duration::from_secs(3);
        let mut patience = Patience::new(start);
        assert!(!patience.is_over(&pulse, limit, at(0.9)));
        // The app was suspended for an hour.
        assert!(!patience.is_over(&pulse, limit, at(3600.0)));
        assert!(!patience.is_over(&pulse, limit, at(3601.0)));
        pulse.beat();
        for step in 0..4 {
            assert!(!patience.is_over(&pulse, limit, at(3602.0 + f64::from(step))), "{step}");
        }
        assert!(patience.is_over(&pulse, limit, at(3606.0)));
        // An idle encoder makes no progress, and is not abandoned.
        pulse.set_idle(true);
        (0..60).for_each(|step| {
            assert!(!patience.is_over(&pulse, limit, at(3607.0 + f64::from(step))));
        });
    }
}
