//! The state of the viewer, as the window's title and as a command line that reproduces it.

use bevy::asset::AssetPath;
use bevy::camera::Camera3d;
use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy::window::PrimaryWindow;
use bevy_panorbit_camera::PanOrbitCamera;
use bevy_vdb::VdbRoles;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb_inspector::VdbInspector;

use crate::app::{OfFiles, Settings, Status};
use crate::args::{Args, Part, Shown};
use crate::select;
use crate::volumes::Label;

/// The resources and components that make up the state of the viewer.
#[derive(SystemParam)]
pub struct State<'w, 's> {
    settings: Res<'w, Settings>,
    status: Res<'w, Status>,
    inspector: Option<Res<'w, VdbInspector>>,
    files: Res<'w, Assets<VdbFile>>,
    grids: Res<'w, Assets<VdbGrid>>,
    vectors: Res<'w, Assets<VdbVectorGrid>>,
    cameras: Query<
        'w,
        's,
        (&'static Transform, &'static VdbCamera, Option<&'static PanOrbitCamera>),
        With<Camera3d>,
    >,
    suns: Query<'w, 's, (&'static Transform, &'static DirectionalLight)>,
    volumes: Query<
        'w,
        's,
        (&'static Label, &'static VdbVolume, &'static VdbMaterial, &'static Visibility),
    >,
    roles: Query<
        'w,
        's,
        (&'static Visibility, Option<&'static VdbEmission>, Option<&'static VdbColorGrid>),
        With<VdbVolume>,
    >,
    players: Query<'w, 's, (&'static VdbPlayer, &'static VdbPlayerStatus), With<OfFiles>>,
    windows: Query<'w, 's, &'static Window, With<PrimaryWindow>>,
}

impl State<'_, '_> {
    /// The options that reproduce the state.
    pub fn args(&self) -> Args {
        let mut args = Args { out: None, cpu: false, ..self.settings.0.clone() };
        let camera = self.cameras.iter().next();
        if let (Some((transform, camera, orbit)), Some(view)) = (camera, self.status.view) {
            args.mode = camera.mode;
            args.overlays = camera.overlays;
            args.scatters_again = camera.multiple_scattering;
            let moved = transform.translation.distance(view.eye.as_vec3());
            let turned = transform.rotation.angle_between(view.transform().rotation);
            // Tolerances, because the orbit camera computes its position from angles.
            if moved > 1e-4 * view.radius() as f32 || turned > 1e-3 {
                let orbit = orbit.filter(|orbit| orbit.enabled);
                let distance = orbit.and_then(|orbit| orbit.radius).unwrap_or(view.radius() as f32);
                args.eye = Some(transform.translation.as_dvec3());
                let target = transform.translation + distance * transform.forward();
                args.target = Some(target.as_dvec3());
            }
        }
        if let Some((transform, light)) = self.suns.iter().next() {
            args.shadows = light.shadow_maps_enabled;
            if transform.back().distance(args.sun.as_vec3().normalize()) > 1e-5 {
                args.sun = transform.back().as_dvec3();
            }
        }
        let as_by_default = self.volumes.iter().all(|(label, volume, _, visibility)| {
            label.suits == (*visibility != Visibility::Hidden) && name(label, volume) == label.name
        });
        if !as_by_default || !args.grids.is_empty() {
            let shown = self.shown().map(|(label, volume, _)| name(label, volume).to_owned());
            args.grids = shown.collect();
            args.grids.sort_unstable();
            args.grids.dedup();
        }
        let paused = self.players.iter().find(|(player, _)| player.is_paused());
        args.frame = paused.and_then(|(_, status)| status.frame());
        self.kinds(&mut args);
        self.fire(&mut args);
        self.colors(&mut args);
        let fog = |volume: &VdbVolume| {
            self.grids.get(&volume.0).is_some_and(|grid| grid.kind() == PackKind::Fog)
        };
        if let Some((_, _, material)) = self.shown().find(|(_, volume, _)| fog(volume)) {
            args.density = material.density_scale;
        }
        if let Some(window) = self.windows.iter().next() {
            args.size = window.resolution.physical_size();
        }
        args.panel = self.inspector.as_ref().is_none_or(|inspector| inspector.open);
        args
    }

    /// Sets the options about grids that are shown differently from their class.
    fn kinds(&self, args: &mut Args) {
        let volumes = self.volumes.iter();
        let kinds = volumes.filter_map(|(label, volume, ..)| {
            let kind = self.grids.get(&volume.0)?.kind();
            // A grid with an asset path is unchanged.
            let shown = select::shown_as(kind);
            let other = volume.0.path().is_none() && shown != select::shown_as(label.kind);
            Some((kind, other.then(|| (label.name.clone(), shown))))
        });
        let kinds: Vec<(PackKind, Option<(String, Shown)>)> = kinds.collect();
        let surfaces = || kinds.iter().filter(|(kind, _)| !matches!(kind, PackKind::Fog));
        if surfaces().next().is_some() {
            args.smooth = surfaces().any(|(kind, _)| matches!(kind, PackKind::Smooth { .. }));
        }
        args.kinds = kinds.into_iter().filter_map(|(_, other)| other).collect();
        args.kinds.sort_by(|a, b| a.0.cmp(&b.0));
        args.kinds.dedup();
    }

    fn fire(&self, args: &mut Args) {
        let shines = self.seen().find_map(|(emission, _)| emission);
        let by_name = self.by_name(args).into_iter().find_map(|roles| roles.emission);
        (args.heat, args.glow) = (None, None);
        let same = match (shines, &by_name) {
            // The grids of two frames of a sequence are others, with the same labels.
            (Some(one), Some(other)) => {
                named(select::source(one).path()) == named(select::source(other).path())
            }
            (one, other) => one.is_none() && other.is_none(),
        };
        args.fire = match shines.map(select::source) {
            _ if same => Part::ByName,
            None => Part::Nothing,
            Some(source) => named(source.path()),
        };
        let Some(shines) = shines else { return };
        let guess = select::source(shines).guess(&self.grids, &self.vectors);
        if let (
            VdbEmission::Temperature { scale, offset, .. },
            Some(VdbEmission::Temperature { scale: usual, offset: usual_offset, .. }),
        ) = (shines, &guess)
            && (scale, offset) != (usual, usual_offset)
        {
            args.heat = Some([*scale, *offset]);
        }
        let usual = guess.as_ref().and_then(select::glow);
        args.glow = select::glow(shines).filter(|glow| Some(*glow) != usual);
    }

    fn colors(&self, args: &mut Args) {
        let shown = self.seen().find_map(|(_, colors)| colors);
        let by_name = self.by_name(args).into_iter().find_map(|roles| roles.colors);
        let label = |colors: &VdbColorGrid| named(colors.0.path());
        args.colors = match shown {
            _ if shown.map(label) == by_name.as_ref().map(label) => Part::ByName,
            None => Part::Nothing,
            Some(colors) => named(colors.0.path()),
        };
    }

    /// The emission and colours of visible volumes.
    fn seen(&self) -> impl Iterator<Item = (Option<&VdbEmission>, Option<&VdbColorGrid>)> {
        let seen = self.roles.iter().filter(|(visible, ..)| **visible != Visibility::Hidden);
        seen.map(|(_, emission, colors)| (emission, colors))
    }

    /// The roles by name of the grids in each file; empty if the grids to show are named.
    fn by_name(&self, args: &Args) -> Vec<VdbRoles> {
        if !args.grids.is_empty() {
            return Vec::new();
        }
        let files = self.status.arrived.iter().filter_map(|own| self.files.get(&own.file));
        files.map(|file| file.roles(&self.grids)).collect()
    }

    fn shown(&self) -> impl Iterator<Item = (&Label, &VdbVolume, &VdbMaterial)> {
        let seen = self.volumes.iter().filter(|(.., visible)| **visible != Visibility::Hidden);
        seen.map(|(label, volume, material, _)| (label, volume, material))
    }

    /// The title of the window.
    fn title(&self) -> String {
        let names = self.settings.0.files.iter().filter_map(|file| file.file_name());
        let names: Vec<_> = names.map(|name| name.to_string_lossy()).collect();
        let mut title = names.join(", ");
        if self.status.view.is_none() {
            title += " (loading)";
        } else {
            let mut grids: Vec<&str> =
                self.shown().map(|(label, ..)| label.name.as_str()).collect();
            grids.sort_unstable();
            title += &format!(": {}", grids.join(", "));
            if let Some((_, camera, _)) = self.cameras.iter().next() {
                title += &format!(", {}", camera.mode.name());
            }
        }
        title + " - bevy_vdb"
    }
}

/// The name of a volume's grid in its file.
fn name<'a>(label: &'a Label, volume: &'a VdbVolume) -> &'a str {
    volume.0.path().and_then(|path| path.label()).unwrap_or(&label.name)
}

fn named(path: Option<&AssetPath>) -> Part {
    let label = path.and_then(|path| path.label());
    label.map_or(Part::ByName, |label| Part::Named(label.to_owned()))
}

pub fn update_title(mut windows: ParamSet<(State, Query<&mut Window, With<PrimaryWindow>>)>) {
    let title = windows.p0().title();
    for mut window in &mut windows.p1() {
        if window.title != title {
            window.title.clone_from(&title);
        }
    }
}

/// Prints the command line when C is pressed, and on exit.
pub fn print(state: State, keys: Res<ButtonInput<KeyCode>>, mut exits: MessageReader<AppExit>) {
    if keys.just_pressed(KeyCode::KeyC) || exits.read().next().is_some() {
        println!("{}", command_line(&state.args()));
    }
}

/// The command line for a shell.
pub fn command_line(args: &Args) -> String {
    let program = std::env::args().next().unwrap_or_else(|| "viewer".into());
    format!("{program} {args}")
}
