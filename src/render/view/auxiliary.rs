//! Auxiliary grids in a view's volume list. Each is an entry of its own, whose rays are computed in
//! f64 on the CPU like those of every volume, so a transform that differs from the volume's costs
//! nothing extra. Emission grids are among the volumes that the view sees, and are traversed like
//! them. Colour grids come after all entries that rays can meet, and are only looked up.

use bevy::math::DAffine3;
use bevy::prelude::*;
use bevy::render::sync_world::MainEntity;
use vdb_core::view::{CannotShow, GpuRays, LatticeRays, ViewRays};

use crate::render::extract::{AuxiliaryGrid, ExtractedVolume, Trouble, Warned};
use crate::render::gpu::{affine, types};
use crate::render::pool::VdbTreePool;

/// The transform of an auxiliary grid.
pub(super) fn world_from_index(grid: &AuxiliaryGrid, volume: &ExtractedVolume) -> DAffine3 {
    affine(volume.world_from_local) * grid.local_from_index
}

/// The rays and the transform of a view.
pub(crate) type View<'a> = (&'a ViewRays, DAffine3);

/// The entry of a grid.
fn entry_data(
    part: &AuxiliaryGrid,
    volume: &ExtractedVolume,
    grid: u32,
    (rays, world_from_view): View,
) -> Result<types::Volume, CannotShow> {
    let world_from_index = world_from_index(part, volume);
    let rays = LatticeRays::new(rays, world_from_view, world_from_index, &part.packed)?;
    let lattice = world_from_index.inverse().matrix3;
    let array = |v: bevy::math::DVec3| v.as_vec3().to_array();
    Ok(types::Volume {
        rays: GpuRays::from(&rays),
        grid,
        kind: part.kind,
        lattice_x: array(lattice.x_axis),
        lattice_y: array(lattice.y_axis),
        lattice_z: array(lattice.z_axis),
        emissive: part.emissive.to_array(),
        temperature_scale: part.temperature.x,
        temperature_offset: part.temperature.y,
        background: part.background,
        color_grids: types::NO_COLOR,
        t_first: -types::FARTHEST,
        t_end: types::FARTHEST,
        ..default()
    })
}

/// The entries of a volume's emission. Warns of problems if `warned` is given.
pub(crate) fn emission_data<'a>(
    entity: MainEntity,
    volume: &'a ExtractedVolume,
    pool: &VdbTreePool,
    view: View,
    mut warned: Option<&mut Warned>,
) -> Vec<(types::Volume, &'a AuxiliaryGrid)> {
    let mut note = |trouble| {
        if let Some(text) =
            warned.as_deref_mut().and_then(|warned| warned.note(entity, &volume.name, trouble))
        {
            warn!("{text}");
        }
    };
    volume.auxiliary.trouble.into_iter().for_each(&mut note);
    let mut entries = Vec::new();
    for part in volume.auxiliary.emission.iter().filter(|part| part.packed.occupied.is_some()) {
        let Some(grid) = pool.index(part.key) else { continue };
        match entry_data(part, volume, grid, view) {
            Ok(data) => {
                let clip_planes = volume.clip.planes;
                entries.push((types::Volume { clip_planes, ..data }, part));
            }
            Err(why) => note(Trouble::NotShown(why)),
        }
    }
    entries
}

/// The three entries of a volume's colour, if it has one.
pub(crate) fn color_data(
    volume: &ExtractedVolume,
    pool: &VdbTreePool,
    view: View,
) -> Option<[types::Volume; 3]> {
    let entry = |i: usize| {
        let part = volume.auxiliary.colors.get(i)?;
        entry_data(part, volume, pool.index(part.key)?, view).ok()
    };
    Some([entry(0)?, entry(1)?, entry(2)?])
}
