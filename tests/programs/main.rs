//! The programs of this crate as people run them, each in a process of its own; and the viewer's window, for which
//! the viewer's modules are compiled into this one.

#![allow(dead_code, reason = "parts of the viewer are for its command line and its pictures")]

#[path = "../common/adapter.rs"]
mod adapter;
mod examples;
#[path = "../common/files.rs"]
mod files;
#[path = "../common/headless.rs"]
mod headless;
#[path = "../common/pages_folder.rs"]
mod pages_folder;
#[path = "../common/png_file.rs"]
mod png_file;
#[path = "../common/programs.rs"]
mod programs;
#[path = "../common/sequence_files.rs"]
mod sequence_files;
#[path = "../common/smoke_file.rs"]
mod smoke_file;
mod viewer;
mod viewer_app;
mod viewer_pages;
mod viewer_sequences;
mod viewer_window;

// They name each other from the root, as they do in the example.
#[path = "../../examples/viewer/app.rs"]
mod app;
#[path = "../../examples/viewer/args/mod.rs"]
mod args;
#[path = "../../examples/viewer/fly.rs"]
mod fly;
#[path = "../../examples/viewer/framing.rs"]
mod framing;
#[path = "../../examples/viewer/keys.rs"]
mod keys;
#[path = "../../examples/viewer/overlay.rs"]
mod overlay;
#[path = "../../examples/viewer/paged.rs"]
mod paged;
#[path = "../../examples/viewer/select.rs"]
mod select;
#[path = "../../examples/viewer/sequences.rs"]
mod sequences;
#[path = "../../examples/viewer/state.rs"]
mod state;
#[path = "../../examples/viewer/volumes.rs"]
mod volumes;
#[path = "../../examples/viewer/window.rs"]
mod window;

use adapter::has_gpu;
