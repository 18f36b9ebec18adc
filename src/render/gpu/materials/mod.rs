//! The kinds of materials that an app has registered, and the WGSL modules by which the trace calls
//! their functions. A function reaches a pipeline only after it has been checked.

mod check;
mod modules;
mod parameters;

use std::any::TypeId;
use std::time::Duration;

use bevy::asset::AssetEvent;
use bevy::platform::time::Instant;
use bevy::prelude::*;
use bevy::shader::{Shader, ShaderImport, ShaderRef};

use crate::VdbMaterialExtension;
use check::Imports;
use parameters::Parameters;

use modules::MOST_KINDS;

pub(crate) use modules::{Roles, kind_defs};
pub(crate) use parameters::{MOST_WORDS, Words, words_of};

/// How long a shader may wait for its imports before this is reported.
const PATIENCE: Duration = Duration::from_secs(5);

/// A registered kind of material.
#[derive(Debug)]
struct Kind {
    component: TypeId,
    parameters: Parameters,
    /// The app's shader.
    shader: Handle<Shader>,
    /// Its module, which pipelines contain.
    module: Handle<Shader>,
    /// The sources that were checked last.
    checked: Option<u64>,
    /// The functions that have passed the check.
    roles: Option<Roles>,
    /// The wait for an import, if one is missing.
    wait: Option<Wait>,
}

/// The wait of a shader for one of its imports.
#[derive(Debug)]
struct Wait {
    since: Instant,
    is_reported: bool,
}

/// All kinds of materials of an app, in the order of their registration.
#[derive(Debug, Resource)]
pub(crate) struct MaterialKinds {
    all: Vec<Kind>,
    /// The module that the app's shaders import.
    types: Handle<Shader>,
    /// The module that the trace imports.
    calls: Handle<Shader>,
    /// Increases whenever a function changes.
    pub changes: u64,
}

impl MaterialKinds {
    /// Adds the modules of an app without materials, if it has none yet.
    pub fn init(app: &mut App) {
        if app.world().contains_resource::<Self>() {
            return;
        }
        let Some(mut shaders) = app.world_mut().get_resource_mut::<Assets<Shader>>() else {
            return;
        };
        let types = shaders.add(modules::types([].into_iter()));
        let calls = shaders.add(modules::kinds([].into_iter()));
        app.insert_resource(Self { all: Vec::new(), types, calls, changes: 0 });
    }

    /// Registers a kind. The error says why it cannot be.
    pub fn add<M: VdbMaterialExtension>(app: &mut App) -> Result<(), String> {
        Self::init(app);
        let shader = match M::shader() {
            ShaderRef::Handle(handle) => handle,
            ShaderRef::Path(path) => app.world().resource::<AssetServer>().load(path),
            ShaderRef::Default => return Err("it has no shader".into()),
        };
        let world = app.world_mut();
        if !world.contains_resource::<Self>() {
            return Err("the app has no shaders; add Bevy's RenderPlugin before".into());
        }
        let parameters = Parameters::of::<M>()?;
        let is_first = world.resource_scope(|world, mut kinds: Mut<Self>| {
            if kinds.all.len() == MOST_KINDS {
                return Err(format!("the app already has {MOST_KINDS}, which is the limit"));
            }
            if kinds.all.iter().any(|kind| kind.parameters.name == parameters.name) {
                return Err(format!("another custom material is called {}, too", parameters.name));
            }
            let mut shaders = world.resource_mut::<Assets<Shader>>();
            kinds.all.push(Kind {
                component: TypeId::of::<M>(),
                parameters,
                shader,
                module: shaders.reserve_handle(),
                checked: None,
                roles: None,
                wait: None,
            });
            let types = modules::types(kinds.all.iter().map(|kind| &kind.parameters));
            put(&mut shaders, &kinds.types, types);
            Ok(kinds.all.len() == 1)
        })?;
        if is_first {
            app.add_systems(PreUpdate, check_changed);
        }
        Ok(())
    }

    /// The number of the kind of a component, and its functions, if they can be called.
    pub fn ready<M: 'static>(&self) -> Option<(usize, Roles)> {
        let number = self.all.iter().position(|kind| kind.component == TypeId::of::<M>())?;
        Some((number, self.all[number].roles?))
    }
}

fn put(shaders: &mut Assets<Shader>, handle: &Handle<Shader>, shader: Shader) {
    if let Err(error) = shaders.insert(handle.id(), shader) {
        // The handle is held, so its place exists.
        debug!("{error}");
    }
}

/// Checks the shaders of materials that have changed, or whose imports have, and passes on those
/// that are sound.
fn check_changed(
    mut kinds: ResMut<MaterialKinds>,
    mut shaders: ResMut<Assets<Shader>>,
    mut events: MessageReader<AssetEvent<Shader>>,
) {
    let has_changed = events.read().count() > 0;
    let is_waiting = kinds.all.iter().any(Kind::is_waiting);
    if !has_changed && !is_waiting {
        return;
    }
    let mut modules = Vec::new();
    for (number, kind) in kinds.bypass_change_detection().all.iter_mut().enumerate() {
        modules.extend(kind.check(number, &shaders).map(|module| (kind.module.clone(), module)));
    }
    if modules.is_empty() {
        return;
    }
    for (handle, module) in modules {
        put(&mut shaders, &handle, module);
    }
    kinds.changes += 1;
    let all = kinds.all.iter().enumerate();
    let ready = all.filter_map(|(number, kind)| Some((number, &kind.parameters, kind.roles?)));
    let calls = modules::kinds(ready);
    let is_new =
        shaders.get(&kinds.calls).is_none_or(|now| now.source.as_str() != calls.source.as_str());
    if is_new {
        put(&mut shaders, &kinds.calls, calls);
    }
}

impl Kind {
    /// The module of the shader if it has changed and is sound; otherwise reports what is wrong,
    /// once.
    fn check(&mut self, number: usize, shaders: &Assets<Shader>) -> Option<Shader> {
        let shader = shaders.get(&self.shader)?;
        let module = modules::of_kind(number, shader);
        let (name, path) = (self.parameters.name, &shader.path);
        let imports = match Imports::of(&module, shaders) {
            Ok(imports) => imports,
            Err(missing) => {
                if self.has_waited() {
                    let import = match &missing {
                        ShaderImport::AssetPath(name) | ShaderImport::Custom(name) => name,
                    };
                    error!(
                        "material {name} cannot be used: {path} imports {import}, which no shader provides"
                    );
                }
                return None;
            }
        };
        self.wait = None;
        let content = imports.content(&module);
        if self.checked.replace(content) == Some(content) {
            return None;
        }
        match check::check(number, &self.parameters, &module, &imports) {
            Ok(roles) => {
                self.roles = Some(roles);
                Some(module)
            }
            Err(why) => {
                let now = if self.roles.is_some() {
                    "volumes are shown with the functions that it had before"
                } else {
                    "volumes are shown without it"
                };
                error!("material {name} cannot be used: {path}: {why}\n{now}");
                None
            }
        }
    }

    /// Whether an import is missing that has not been reported yet.
    fn is_waiting(&self) -> bool {
        self.wait.as_ref().is_some_and(|wait| !wait.is_reported)
    }

    /// Whether an import has been missing for too long; true once.
    fn has_waited(&mut self) -> bool {
        let new = || Wait { since: Instant::now(), is_reported: false };
        let wait = self.wait.get_or_insert_with(new);
        let is_due = !wait.is_reported && wait.since.elapsed() > PATIENCE;
        wait.is_reported |= is_due;
        is_due
    }
}
