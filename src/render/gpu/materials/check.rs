//! The check of an app's shader before any pipeline contains it, so that errors are reported once,
//! with the line of the app's own file, and what is drawn stays as it was.

use std::hash::{DefaultHasher, Hash, Hasher};

use bevy::prelude::*;
use bevy::shader::{Shader, ShaderImport, Source};
use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, ComposerError, NagaModuleDescriptor,
};

use super::modules::{self, Roles};
use super::parameters::Parameters;

/// The imports of a shader, each after those that it imports itself.
pub(super) struct Imports<'a>(Vec<&'a Shader>);

impl<'a> Imports<'a> {
    /// The imports of a shader among those that are loaded; otherwise the first that is missing.
    pub fn of(shader: &Shader, loaded: &'a Assets<Shader>) -> Result<Self, ShaderImport> {
        let mut all = Self(Vec::new());
        shader.imports.iter().try_for_each(|import| all.add(import, loaded, 0))?;
        Ok(all)
    }

    fn add(
        &mut self,
        import: &ShaderImport,
        loaded: &'a Assets<Shader>,
        depth: u32,
    ) -> Result<(), ShaderImport> {
        if self.0.iter().any(|known| known.import_path == *import) {
            return Ok(());
        }
        let mut all = loaded.iter().map(|(_, shader)| shader);
        // The circle of modules that import each other has no end.
        let found = all.find(|shader| shader.import_path == *import).filter(|_| depth < 32);
        let shader = found.ok_or_else(|| import.clone())?;
        shader.imports.iter().try_for_each(|import| self.add(import, loaded, depth + 1))?;
        self.0.push(shader);
        Ok(())
    }

    /// A number that changes with any of the sources, and with that of the shader itself.
    pub fn content(&self, shader: &Shader) -> u64 {
        let mut hasher = DefaultHasher::new();
        for shader in self.0.iter().copied().chain([shader]) {
            if let Source::Wgsl(text) = &shader.source {
                text.hash(&mut hasher);
            }
        }
        hasher.finish()
    }
}

/// Whether a text has a function of a name.
fn has_function(source: &str, name: &str) -> bool {
    source.lines().any(|line| {
        let line = line.split("//").next().unwrap_or_default();
        let after = line.split_once("fn ").map(|(_, after)| after.trim_start());
        after
            .and_then(|after| after.strip_prefix(name))
            .is_some_and(|rest| rest.trim_start().starts_with('('))
    })
}

/// The path of the program that calls the function for the check.
const CALLER: &str = "bevy_vdb/material/caller.wgsl";

/// Composes and validates the module of a kind, and says which functions it has. The error is a
/// text for people.
pub(super) fn check(
    kind: usize,
    parameters: &Parameters,
    module: &Shader,
    imports: &Imports,
) -> Result<Roles, String> {
    let Source::Wgsl(source) = &module.source else {
        return Err("it is not WGSL".into());
    };
    let roles =
        Roles { surface: has_function(source, "surface"), fog: has_function(source, "fog") };
    if roles == Roles::default() {
        return Err(format!("it has no function {}", signatures(parameters)));
    }
    let mut composer = Composer::default();
    let text = |error: ComposerError, composer: &Composer| error.emit_to_string(composer);
    for shader in imports.0.iter().copied().chain([module]) {
        let added = composer.add_composable_module(ComposableModuleDescriptor::from(shader));
        if let Err(error) = added.map(drop) {
            return Err(text(error, &composer));
        }
    }
    let source = modules::caller(kind, parameters, roles);
    let program = NagaModuleDescriptor { source: &source, file_path: CALLER, ..default() };
    let program = composer.make_naga_module(program).map_err(|error| {
        let is_call = error.source.path(&composer) == CALLER;
        let text = text(error, &composer);
        if is_call {
            format!("its functions are not {}\n{text}", signatures(parameters))
        } else {
            text
        }
    })?;
    let mut bound = program.global_variables.iter().filter(|(_, own)| {
        let is_own = |group, binding| group == 0 && binding < modules::CALLER_BINDINGS;
        own.binding.as_ref().is_some_and(|at| !is_own(at.group, at.binding))
    });
    match bound.next() {
        Some((_, own)) => {
            let name = own.name.as_deref().unwrap_or_default();
            Err(format!("it binds {name}, but materials cannot have bindings of their own"))
        }
        None => Ok(roles),
    }
}

/// The functions that a shader may have.
fn signatures(parameters: &Parameters) -> String {
    let third = if parameters.is_empty() {
        String::new()
    } else {
        format!(", parameters: {}", parameters.name)
    };
    format!(
        "surface(hit: VdbHit, built_in: VdbSurface{third}) -> VdbSurface or fog(at: VdbFogPoint, built_in: \
         VdbFog{third}) -> VdbFog"
    )
}
