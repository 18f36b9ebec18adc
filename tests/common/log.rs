//! Captures warnings and errors.

use std::sync::{Mutex, Once};

use bevy::log::Level;
use bevy::log::tracing::field::{Field, Visit};
use bevy::log::tracing::{Event, Subscriber};
use bevy::log::tracing_subscriber::layer::{self, Layer, SubscriberExt};
use bevy::log::tracing_subscriber::{Registry, util::SubscriberInitExt};

/// All warnings and errors of this process since `listen` was first called.
static SAID: Mutex<Vec<String>> = Mutex::new(Vec::new());

struct Listener;

impl<S: Subscriber> Layer<S> for Listener {
    fn on_event(&self, event: &Event, _: layer::Context<S>) {
        struct Message(String);
        impl Visit for Message {
            fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
                if field.name() == "message" {
                    self.0 = format!("{value:?}");
                }
            }
        }
        if *event.metadata().level() <= Level::WARN {
            let mut message = Message(String::new());
            event.record(&mut message);
            SAID.lock().unwrap().push(message.0);
        }
    }
}

/// Begins to listen.
pub fn listen() {
    static LISTEN: Once = Once::new();
    LISTEN.call_once(|| Registry::default().with(Listener).init());
}

/// The warnings and errors that contain a text.
pub fn said(text: &str) -> Vec<String> {
    SAID.lock().unwrap().iter().filter(|line| line.contains(text)).cloned().collect()
}
