//! The window: orbit camera, progress of loading, errors, and what is shown how.

use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};

use bevy::log::LogPlugin;
use bevy::prelude::*;
use bevy::window::WindowResolution;
use bevy_egui::{EguiContexts, EguiPlugin, EguiPrimaryContextPass, egui};
use bevy_panorbit_camera::{PanOrbitCamera, PanOrbitCameraPlugin};
use bevy_vdb::prelude::*;
use bevy_vdb::{VdbGpuUsage, VdbLoadProgress};

use crate::app::{self, Status, ViewerPlugin};
use crate::args::{Args, MODES};

/// Whether there is a display to show a window on.
pub fn display() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    !cfg!(all(unix, not(target_os = "macos"))) || set("DISPLAY") || set("WAYLAND_DISPLAY")
}

/// The app with its window; what the display says where it refuses one.
pub fn build(args: &Args) -> Result<App, String> {
    // winit's plugin panics where the display cannot be reached: no message but ours then.
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

/// Until it is closed.
pub fn run(mut app: App) -> Result<(), String> {
    match app.run() {
        AppExit::Success => Ok(()),
        AppExit::Error(_) => Err("stopped after an error; what happened is above".into()),
    }
}

fn app(args: &Args) -> App {
    let window = Window {
        title: "bevy_vdb viewer".into(),
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
    // After the window's plugin: where that fails, the app for a picture logs in its own way.
    .add_plugins(LogPlugin::default())
    .add_plugins((EguiPlugin::default(), PanOrbitCameraPlugin, ViewerPlugin(args.clone())))
    .add_systems(Update, orbit.run_if(resource_changed::<Status>))
    .add_systems(EguiPrimaryContextPass, panel);
    app.world_mut().spawn(app::camera(args));
    app
}

/// Hands the camera over to the mouse once it stands where it should.
fn orbit(
    mut commands: Commands,
    status: Res<Status>,
    cameras: Query<Entity, (With<Camera3d>, Without<PanOrbitCamera>)>,
) {
    let Some(view) = status.view else { return };
    let target = view.target.as_vec3();
    for camera in &cameras {
        commands.entity(camera).insert(PanOrbitCamera {
            focus: target,
            target_focus: target,
            zoom_lower_limit: (10.0 * view.near) as f32,
            ..default()
        });
    }
}

fn panel(
    mut contexts: EguiContexts,
    status: Res<Status>,
    progress: Res<VdbLoadProgress>,
    usage: Res<VdbGpuUsage>,
    mut cameras: Query<(&mut VdbCamera, &mut bevy::core_pipeline::tonemapping::Tonemapping)>,
    mut volumes: Query<(&mut Visibility, &mut VdbMaterial), With<VdbVolume>>,
) -> Result {
    egui::Window::new("bevy_vdb").resizable(false).show(contexts.ctx_mut()?, |ui| {
        for (path, done, all) in progress.files() {
            let name = path.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
            let part = if all == 0 { 0.0 } else { done as f32 / all as f32 };
            ui.add(egui::ProgressBar::new(part).text(name).show_percentage());
        }
        for error in &status.errors {
            ui.colored_label(egui::Color32::LIGHT_RED, error);
        }
        for (mut camera, mut tonemapping) in &mut cameras {
            ui.horizontal(|ui| {
                for (name, mode) in MODES {
                    if ui.selectable_label(camera.mode == mode, name).clicked() {
                        camera.mode = mode;
                        *tonemapping = app::tonemapping(mode);
                    }
                }
            });
        }
        for (name, entity) in &status.grids {
            let Ok((mut visibility, mut material)) = volumes.get_mut(*entity) else { continue };
            let mut shown = *visibility != Visibility::Hidden;
            if ui.checkbox(&mut shown, name).changed() {
                *visibility = if shown { Visibility::Inherited } else { Visibility::Hidden };
            }
            if shown && name.contains(": fog") {
                let mut density = material.density_scale;
                let slider = egui::Slider::new(&mut density, 0.0..=1000.0).logarithmic(true);
                if ui.add(slider.text("density")).changed() {
                    material.density_scale = density;
                }
            }
        }
        if status.view.is_some() {
            ui.label(format!("{:.1} MB on the GPU", usage.bytes() as f64 / 1e6));
        }
    });
    Ok(())
}
