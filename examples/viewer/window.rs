//! The window: orbit and fly cameras, dropped files, and the panel.

use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};

use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::ecs::system::SystemParam;
use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::window::{FileDragAndDrop, WindowResolution};
use bevy_egui::EguiPrimaryContextPass;
use bevy_panorbit_camera::{PanOrbitCamera, PanOrbitCameraPlugin};
use bevy_vdb::prelude::*;
use bevy_vdb_inspector::{VdbInspector, VdbInspectorPlugin, VdbModelPicked};

use crate::app::{self, Open, Status, ViewerPlugin};
use crate::args::Args;
use crate::framing::View;
use crate::{fly, keys, overlay, sequences, state};

/// Whether there is a display for a window.
pub fn display() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    !cfg!(all(unix, not(target_os = "macos"))) || set("DISPLAY") || set("WAYLAND_DISPLAY")
}

/// Builds the app with its window; the error is the reason why there is no window.
pub fn build(args: &Args) -> Result<App, String> {
    // winit's plugin panics if the display cannot be reached; its message is suppressed.
    let hook = take_hook();
    set_hook(Box::new(|_| {}));
    let built = catch_unwind(AssertUnwindSafe(|| app(args)));
    set_hook(hook);
    built.map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        text.unwrap_or("the display cannot be used").to_owned()
    })
}

/// Runs the app until the window is closed.
pub fn run(mut app: App) -> Result<(), String> {
    match app.run() {
        AppExit::Success => Ok(()),
        AppExit::Error(_) => Err("stopped after an error; see the messages above".into()),
    }
}

fn app(args: &Args) -> App {
    let window = Window {
        title: "bevy_vdb".into(),
        resolution: WindowResolution::new(args.size.x, args.size.y),
        ..default()
    };
    let mut app = App::new();
    app.add_plugins(
        DefaultPlugins
            .set(WindowPlugin { primary_window: Some(window), ..default() })
            .set(app::asset_plugin())
            .disable::<LogPlugin>(),
    )
    // After the window's plugin: if that fails, the app for an image sets up its own logging.
    .add_plugins((LogPlugin::default(), PanOrbitCameraPlugin, InteractivePlugin(args.clone())));
    #[cfg(feature = "record")]
    app.add_plugins(VdbRecordPlugin);
    app
}

/// Everything interactive; independent of a window, for tests.
pub struct InteractivePlugin(pub Args);

impl Plugin for InteractivePlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins((
            ViewerPlugin(self.0.clone()),
            VdbInspectorPlugin { replaces_models: false },
        ))
        .insert_resource(VdbInspector { open: self.0.panel, timeline: false, ..default() })
        .init_resource::<keys::Help>()
        .init_resource::<fly::Fly>()
        .init_resource::<Hovering>()
        .add_systems(
            Update,
            (
                (keys::press, sequences::press, keys::go_home, fly::toggle, fly::fly)
                    .chain()
                    .run_if(keys::are_free),
                begin_orbit.run_if(resource_changed::<Status>),
                (drop_files, open_picked, follow_mode),
            ),
        )
        .add_observer(sequences::complain)
        .add_systems(EguiPrimaryContextPass, overlay::show)
        .add_systems(Last, (state::update_title, state::print));
        app.world_mut().spawn((Name::new("camera"), app::camera(&self.0)));
    }
}

/// Whether a file is held over the window.
#[derive(Default, Resource)]
pub struct Hovering(pub bool);

fn drop_files(
    mut events: MessageReader<FileDragAndDrop>,
    mut hovering: ResMut<Hovering>,
    mut open: MessageWriter<Open>,
) {
    for event in events.read() {
        hovering.0 = matches!(event, FileDragAndDrop::HoveredFile { .. });
        if let FileDragAndDrop::DroppedFile { path_buf, .. } = event {
            open.write(Open(vec![path_buf.clone()]));
        }
    }
}

fn open_picked(mut picked: MessageReader<VdbModelPicked>, mut open: MessageWriter<Open>) {
    for model in picked.read() {
        open.write(Open(vec![app::asset_root().join(model.path.path())]));
    }
}

/// Changes the tonemapping with the render mode.
fn follow_mode(mut cameras: Query<(&VdbCamera, &mut Tonemapping), Changed<VdbCamera>>) {
    for (camera, mut tonemapping) in &mut cameras {
        tonemapping.set_if_neq(app::tonemapping(camera.mode));
    }
}

/// Gives control of the camera to the mouse once the view is set.
fn begin_orbit(
    status: Res<Status>,
    fly: Res<fly::Fly>,
    mut orbit: Orbit,
    mut last: Local<Option<View>>,
) {
    if *last != status.view {
        *last = status.view;
        if let (Some(view), false) = (&status.view, fly.on) {
            orbit.stand(view);
        }
    }
}

/// Gives control of the cameras to the mouse, and takes it back.
#[derive(SystemParam)]
pub struct Orbit<'w, 's> {
    commands: Commands<'w, 's>,
    cameras: Query<'w, 's, (Entity, &'static mut Transform), With<Camera3d>>,
}

impl Orbit<'_, '_> {
    /// Moves the cameras to a view, and lets them orbit its target.
    pub fn stand(&mut self, view: &View) {
        let from_eye = view.eye.distance(view.target) as f32;
        self.cameras.iter_mut().for_each(|(_, mut camera)| *camera = view.transform());
        self.resume(view, from_eye);
    }

    /// Lets the cameras orbit the point at this distance ahead.
    pub fn resume(&mut self, view: &View, distance: f32) {
        for (entity, camera) in &self.cameras {
            let focus = camera.translation + distance * camera.forward();
            self.commands.entity(entity).insert(PanOrbitCamera {
                focus,
                target_focus: focus,
                zoom_lower_limit: (10.0 * view.near) as f32,
                trackpad_pinch_to_zoom_enabled: true,
                ..default()
            });
        }
    }

    /// Stops orbiting.
    pub fn rest(&mut self) {
        for (entity, _) in &self.cameras {
            self.commands.entity(entity).remove::<PanOrbitCamera>();
        }
    }
}
