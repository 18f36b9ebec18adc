//! The viewer's modules in an app that nobody draws, and what can be done in its window.

use std::path::Path;
use std::time::Duration;

use bevy::ecs::system::RunSystemOnce;
use bevy::input::ButtonState;
use bevy::input::keyboard::{Key, KeyboardInput};
use bevy::prelude::*;
use bevy::window::{FileDragAndDrop, PrimaryWindow};
use bevy_egui::egui::accesskit::{Action, ActionRequest, Node, Role, TreeId};
use bevy_egui::{EguiContext, EguiInput, EguiOutput, egui};
use bevy_panorbit_camera::PanOrbitCameraPlugin;
use bevy_vdb::prelude::*;

use crate::app::{self, Status};
use crate::args::Args;
use crate::files::model;
use crate::state::State;
use crate::volumes::Label;
use crate::window::InteractivePlugin;
use crate::{headless, select};

pub struct Viewer {
    pub app: App,
    pub camera: Entity,
    pub window: Entity,
}

impl Viewer {
    pub fn new(args: &Args) -> Self {
        let mut app = App::new();
        app.add_plugins((
            headless::plugins(Some(Window::default()), app::asset_plugin()),
            PanOrbitCameraPlugin,
            InteractivePlugin(args.clone()),
        ));
        app.finish();
        app.cleanup();
        let world = app.world_mut();
        let camera = world.query_filtered::<Entity, With<Camera3d>>().single(world);
        let window = world.query_filtered::<Entity, With<PrimaryWindow>>().single(world);
        let (camera, window) = (camera.expect("a camera"), window.expect("a window"));
        let mut viewer = Self { app, camera, window };
        viewer.app.update();
        let mut context = viewer.app.world_mut().get_mut::<EguiContext>(camera).expect("egui");
        context.get_mut().enable_accesskit();
        context.get_mut().all_styles_mut(|style| style.animation_time = 0.0);
        viewer
    }

    pub fn files(names: &[&str]) -> Args {
        Args { files: names.iter().map(|name| model(name)).collect(), ..default() }
    }

    /// An app that has loaded what it was asked for.
    pub fn ready(args: &Args) -> Self {
        let mut viewer = Self::new(args);
        viewer.wait();
        viewer
    }

    pub fn wait(&mut self) {
        for _ in 0..4_000 {
            self.app.update();
            if self.app.world().resource::<Status>().view.is_some() {
                self.frames(4);
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("nothing was loaded");
    }

    pub fn frames(&mut self, frames: usize) {
        (0..frames).for_each(|_| self.app.update());
    }

    pub fn get<C: Component>(&self) -> &C {
        self.app.world().get(self.camera).expect("the camera has it")
    }

    pub fn args(&mut self) -> Args {
        self.app.world_mut().run_system_once(|state: State| state.args()).expect("it runs")
    }

    pub fn title(&self) -> String {
        self.app.world().get::<Window>(self.window).expect("a window").title.clone()
    }

    pub fn nodes(&self) -> Vec<(egui::accesskit::NodeId, Node)> {
        let output = self.app.world().get::<EguiOutput>(self.camera).expect("egui");
        output.platform_output.accesskit_update.clone().map_or_else(Vec::new, |all| all.nodes)
    }

    /// All that can be read in the window.
    pub fn says(&self, what: &str) -> bool {
        let holds = |text: Option<&str>| text.is_some_and(|text| text.contains(what));
        self.nodes().iter().any(|(_, node)| holds(node.label()) || holds(node.value()))
    }

    pub fn click(&mut self, name: &str) {
        let nodes = self.nodes();
        let it = |node: &Node| node.role() == Role::Button && node.label() == Some(name);
        let target_node = nodes.iter().find(|(_, node)| it(node)).expect("the button").0;
        let (target_tree, action) = (TreeId::ROOT, Action::Click);
        let request = ActionRequest { action, target_tree, target_node, data: None };
        let event = egui::Event::AccessKitActionRequest(request);
        let mut input = self.app.world_mut().get_mut::<EguiInput>(self.camera).expect("egui");
        input.events.push(event);
        self.frames(3);
    }

    pub fn key(&mut self, key_code: KeyCode, state: ButtonState) {
        let (logical_key, window) = (Key::F35, self.window);
        let input =
            KeyboardInput { key_code, logical_key, state, text: None, repeat: false, window };
        self.app.world_mut().write_message(input);
    }

    pub fn press(&mut self, key: KeyCode) {
        self.key(key, ButtonState::Pressed);
        self.app.update();
        self.key(key, ButtonState::Released);
        self.frames(3);
    }

    pub fn drop_file(&mut self, path: &Path) {
        let (window, path_buf) = (self.window, path.to_owned());
        self.app.world_mut().write_message(FileDragAndDrop::DroppedFile { window, path_buf });
        self.app.update();
    }

    /// What is shown, with what shines in it and what colours it.
    pub fn roles(&mut self) -> Vec<String> {
        let world = self.app.world_mut();
        let mut volumes =
            world.query::<(&Label, &Visibility, Option<&VdbEmission>, Option<&VdbColorGrid>)>();
        let shown = volumes.iter(world).filter(|(_, shown, ..)| **shown != Visibility::Hidden);
        let name = |path: Option<&bevy::asset::AssetPath>| {
            path.and_then(|path| path.label()).unwrap_or("?").to_owned()
        };
        let mut roles: Vec<String> = shown
            .map(|(label, _, fire, colors)| {
                let fire = fire.map(|fire| format!(" + {}", name(select::source(fire).path())));
                let colors = colors.map(|colors| format!(", {}", name(colors.0.path())));
                label.name.clone() + &fire.unwrap_or_default() + &colors.unwrap_or_default()
            })
            .collect();
        roles.sort_unstable();
        roles
    }

    pub fn fire(&mut self) -> Option<VdbEmission> {
        let world = self.app.world_mut();
        world.query::<&VdbEmission>().iter(world).next().cloned()
    }

    pub fn labels(&mut self) -> Vec<String> {
        let world = self.app.world_mut();
        let mut labels: Vec<_> =
            world.query::<&Label>().iter(world).map(|label| label.name.clone()).collect();
        labels.sort_unstable();
        labels
    }
}
