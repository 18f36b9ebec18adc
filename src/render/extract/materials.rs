//! Custom materials: their plugin, and the table of their parameters.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::marker::PhantomData;

use bevy::ecs::schedule::SystemSet;
use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy::render::sync_world::{MainEntity, MainEntityHashMap};
use bevy::render::{Extract, ExtractSchedule, RenderApp};

use crate::render::gpu::materials::{MOST_WORDS, MaterialKinds, Roles, Words, words_of};
use crate::{VdbMaterialExtension, VdbPagedVolume, VdbVolume};

/// Registers a [`VdbMaterialExtension`], so that volumes with the component `M` are shown with its
/// functions.
///
/// Add it after [`VdbRenderPlugin`](crate::VdbRenderPlugin). An app can register 32 custom materials.
#[derive(Clone, Copy, Debug)]
pub struct VdbMaterialPlugin<M>(PhantomData<fn() -> M>);

impl<M> Default for VdbMaterialPlugin<M> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<M: VdbMaterialExtension> Plugin for VdbMaterialPlugin<M> {
    fn build(&self, app: &mut App) {
        if let Err(why) = MaterialKinds::add::<M>(app) {
            error!("material {} is ignored: {why}", M::short_type_path());
            return;
        }
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else { return };
        render_app
            .init_resource::<ExtractedMaterials>()
            .add_systems(ExtractSchedule, extract_materials::<M>.in_set(ExtractMaterials));
    }
}

/// The extraction of all materials, before that of volumes.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct ExtractMaterials;

/// The words of a row of the table: its kind, from 1, and three unused; three rows of the matrix
/// from index space to the space of the entity; the parameters.
pub(crate) const ROW_WORDS: usize = 16 + MOST_WORDS;
pub(crate) type Row = [u32; ROW_WORDS];

/// The most rows: as many as the flags of a volume can number.
const MOST_ROWS: usize = 0xffff;

/// The material of a volume in the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct MaterialRow {
    /// From 1.
    pub number: u32,
    /// From 0.
    pub kind: usize,
    /// Changes with the parameters and with the functions.
    pub content: u64,
}

/// A component with its kind and the functions of the kind.
#[derive(Clone, Copy, Debug)]
struct OwnMaterial {
    kind: usize,
    roles: Roles,
    words: Words,
}

/// All custom materials of volumes, and the table of those of volumes that are not hidden.
#[derive(Debug, Default, Resource)]
pub(crate) struct ExtractedMaterials {
    of_volumes: MainEntityHashMap<OwnMaterial>,
    pub rows: Vec<Row>,
    before: Vec<Row>,
    functions: u64,
    /// Increases whenever the table or a function changes.
    pub changes: u64,
}

impl ExtractedMaterials {
    /// Adds the material of a volume to the table, if it has one with a function for it.
    pub fn add(
        &mut self,
        entity: MainEntity,
        is_fog: bool,
        local_from_index: &DAffine3,
    ) -> Option<MaterialRow> {
        let OwnMaterial { kind, roles, words } = *self.of_volumes.get(&entity)?;
        if !(if is_fog { roles.fog } else { roles.surface }) {
            return None;
        }
        if self.rows.len() == MOST_ROWS {
            warn_once!(
                "more than {MOST_ROWS} volumes have custom materials: the others are shown without"
            );
            return None;
        }
        let mut row = [0; ROW_WORDS];
        row[0] = kind as u32 + 1;
        let matrix = local_from_index.matrix3.transpose();
        let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
        let origin = local_from_index.translation.to_array();
        for (i, (axis, origin)) in axes.into_iter().zip(origin).enumerate() {
            let line = axis.extend(origin).as_vec4().to_array().map(f32::to_bits);
            row[4 * (i + 1)..][..4].copy_from_slice(&line);
        }
        row[16..].copy_from_slice(&words);
        let mut hasher = DefaultHasher::new();
        (row, self.functions).hash(&mut hasher);
        self.rows.push(row);
        let number = self.rows.len() as u32;
        Some(MaterialRow { number, kind, content: hasher.finish() })
    }

    /// Notes whether anything has changed since the previous frame, once all volumes have been
    /// extracted.
    pub fn end_frame(&mut self) {
        self.changes += u64::from(self.rows != self.before);
    }
}

/// Empties the table.
pub(super) fn begin_materials(
    mut extracted: ResMut<ExtractedMaterials>,
    kinds: Extract<Option<Res<MaterialKinds>>>,
) {
    let extracted = &mut *extracted;
    extracted.of_volumes.clear();
    std::mem::swap(&mut extracted.rows, &mut extracted.before);
    extracted.rows.clear();
    let functions = kinds.as_ref().map_or(0, |kinds| kinds.changes);
    extracted.changes +=
        u64::from(std::mem::replace(&mut extracted.functions, functions) != functions);
}

fn extract_materials<M: VdbMaterialExtension>(
    volumes: Extract<Query<(Entity, &M), Or<(With<VdbVolume>, With<VdbPagedVolume>)>>>,
    kinds: Extract<Res<MaterialKinds>>,
    mut extracted: ResMut<ExtractedMaterials>,
) {
    let Some((kind, roles)) = kinds.ready::<M>() else { return };
    for (entity, material) in &volumes {
        let before = extracted
            .of_volumes
            .insert(entity.into(), OwnMaterial { kind, roles, words: words_of(material) });
        if before.is_some() {
            warn_once!("a volume has several custom materials: it is shown with one of them");
        }
    }
}
