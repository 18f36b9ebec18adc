//! The app with the panel.

use bevy::asset::{AssetPlugin, UnapprovedPathMode};
use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy_egui::egui::accesskit::{Action, ActionData, ActionRequest, Node, NodeId, Role, TreeId};
use bevy_egui::{EguiContext, EguiInput, EguiOutput, EguiPreUpdateSet, egui};
use bevy_vdb::prelude::*;
use bevy_vdb_inspector::VdbInspectorPlugin;
use vdb_core::tree::Vdb543;

use crate::headless;

const WINDOW: egui::Vec2 = egui::vec2(1280.0, 720.0);

/// An app with the panel, and what the panel showed in the last frame.
pub struct Panel {
    pub app: App,
    pub camera: Entity,
    pub sun: Entity,
    pub volume: Entity,
    pub nodes: Vec<(NodeId, Node)>,
    pub focus: NodeId,
}

impl Panel {
    pub fn new(kind: PackKind) -> Self {
        Self::with(kind, VdbInspectorPlugin::default())
    }

    pub fn with(kind: PackKind, plugin: VdbInspectorPlugin) -> Self {
        let mut app = App::new();
        let file_path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../assets").into();
        let unapproved_path_mode = UnapprovedPathMode::Allow;
        let assets = AssetPlugin { file_path, unapproved_path_mode, ..default() };
        app.add_plugins((headless::plugins(None, assets), VdbRenderPlugin, plugin));
        // A window would have the keyboard.
        app.add_systems(
            PreUpdate,
            (|mut inputs: Query<&mut EguiInput>| {
                inputs.iter_mut().for_each(|mut input| input.focused = true);
            })
            .after(EguiPreUpdateSet::ProcessInput),
        );
        app.finish();
        app.cleanup();
        let mut tree = Vdb543::new(1.0);
        tree.set(IVec3::new(3, 4, 5), -1.0);
        tree.set(IVec3::new(3, 4, 200), 0.5);
        let grid = VdbGrid::new("blob", tree, DAffine3::IDENTITY, kind).unwrap();
        let grid = app.world_mut().resource_mut::<Assets<VdbGrid>>().add(grid);
        let volume = app.world_mut().spawn(VdbVolume(grid)).id();
        let sun = app.world_mut().spawn(DirectionalLight::default()).id();
        let camera = app.world_mut().spawn(Camera3d::default()).id();
        let mut panel = Self { app, camera, sun, volume, nodes: Vec::new(), focus: NodeId(0) };
        panel.frames(2);
        let mut context = panel.world().get_mut::<EguiContext>(camera).expect("a context");
        context.get_mut().enable_accesskit();
        context.get_mut().all_styles_mut(|style| style.animation_time = 0.0);
        panel.frames(3);
        panel
    }

    pub fn world(&mut self) -> &mut World {
        self.app.world_mut()
    }

    pub fn get<C: Component>(&self, entity: Entity) -> &C {
        self.app.world().get(entity).expect("the component is there")
    }

    pub fn frames(&mut self, frames: usize) {
        for _ in 0..frames {
            self.frame([]);
        }
    }

    pub fn frame<const N: usize>(&mut self, events: [egui::Event; N]) {
        let camera = self.camera;
        if let Some(mut input) = self.world().get_mut::<EguiInput>(camera) {
            input.screen_rect = Some(egui::Rect::from_min_size(egui::Pos2::ZERO, WINDOW));
            input.events.extend(events);
        }
        self.app.update();
    }

    /// Runs frames until nothing moves any more, and notes what is shown.
    pub fn look(&mut self) {
        self.frames(4);
        let output = self.app.world().get::<EguiOutput>(self.camera).expect("there is a context");
        let update = output.platform_output.accesskit_update.clone();
        let update = update.expect("screen readers are told");
        (self.nodes, self.focus) = (update.nodes, update.focus);
    }

    /// What a control is called: by itself, or by a label beside it.
    pub fn name(&self, node: &Node) -> Option<String> {
        let of = |id: &NodeId| self.nodes.iter().find(|(other, _)| other == id);
        let beside = || of(node.labelled_by().first()?)?.1.value();
        node.label().or_else(beside).map(str::to_owned)
    }

    pub fn find(&self, role: Role, name: &str) -> Option<&(NodeId, Node)> {
        let is_it = |node: &Node| node.role() == role && self.name(node).as_deref() == Some(name);
        self.nodes.iter().find(|(_, node)| is_it(node))
    }

    pub fn ask(&mut self, role: Role, name: &str, action: Action, data: Option<ActionData>) {
        self.look();
        let Some((target_node, _)) = self.find(role, name) else {
            panic!("there is no {role:?} {name:?}");
        };
        let (target_tree, target_node) = (TreeId::ROOT, *target_node);
        let request = ActionRequest { action, target_tree, target_node, data };
        self.frame([egui::Event::AccessKitActionRequest(request)]);
        self.frames(3);
    }

    pub fn click(&mut self, role: Role, name: &str) {
        self.ask(role, name, Action::Click, None);
    }

    pub fn slide(&mut self, name: &str, to: f64) {
        self.ask(Role::Slider, name, Action::SetValue, Some(ActionData::NumericValue(to)));
    }

    pub fn choose(&mut self, name: &str, what: &str) {
        self.click(Role::ComboBox, name);
        self.click(Role::Button, what);
    }

    pub fn press(&mut self, key: egui::Key) {
        let (physical_key, modifiers) = (None, egui::Modifiers::NONE);
        let event =
            |pressed| egui::Event::Key { key, physical_key, pressed, repeat: false, modifiers };
        self.frame([event(true), event(false)]);
        self.frames(2);
    }
}
