//! What the grids of a file are for, by what programs call them.

use bevy::math::DVec3;
use bevy::prelude::*;
use vdb_core::pack::PackKind;

use crate::{VdbColorGrid, VdbEmission, VdbFile, VdbGrid, VdbVectorGrid};

/// Names of densities: OpenVDB's own, Blender's and Houdini's, `EmberGen`'s.
const DENSITIES: [&str; 2] = ["density", "smoke"];

/// Names of what shines, and how many kelvin 0 and 1 stand for there; those of fire itself before those of
/// heat, which smoke has, too.
const FIRES: [(&str, [f32; 2]); 7] = [
    ("flame", FLAMES),
    ("flames", FLAMES),
    ("fire", FLAMES),
    ("burn", FLAMES),
    ("temperature", HEAT),
    ("heat", HEAT),
    ("temp", HEAT),
];
/// Where fuel burns at the least, and at the most: Blender's defaults.
const FLAMES: [f32; 2] = [1_500.0, 3_000.0];
/// What Blender's Principled Volume takes.
const HEAT: [f32; 2] = [0.0, 1_000.0];

/// How names of surfaces begin that Blender's simulations have about a fluid.
const HELPERS: &str = "phi_";

/// Names of colours: Houdini's, and plain ones.
const COLORS: [&str; 4] = ["cd", "color", "colour", "albedo"];

/// Values of temperatures above this are kelvin: programs that count otherwise stay far below.
const KELVIN: f32 = 100.0;

/// Values that are looked at, at most, to find that out.
const LOOKED_AT: usize = 1 << 20;

/// cd/m² that fire has by a first guess where it is hottest, through a tenth of its box: what is white by
/// Bevy's default exposure.
const LUMINANCE: f32 = 1_000.0;

/// The grids of a [`VdbFile`] by the parts that they play: [`VdbFile::roles`].
#[derive(Clone, Debug, Default)]
pub struct VdbRoles {
    /// All surfaces, in the order of the file; where there is a density, without Blender's `phi_obstacle`
    /// and its like, between which the fluid was simulated.
    pub surfaces: Vec<Handle<VdbGrid>>,
    /// What dims light: fog called `density` or `smoke`, else the first fog there is.
    pub density: Option<Handle<VdbGrid>>,
    /// What shines in the density: a first guess ([`VdbEmission::guess`]) for another fog, not empty, called `flame`,
    /// `flames`, `fire`, `burn`, `temperature`, `heat` or `temp`, in this order.
    pub emission: Option<VdbEmission>,
    /// What colours the surfaces: vectors called `Cd`, `color`, `colour` or `albedo`.
    pub colors: Option<VdbColorGrid>,
}

impl VdbFile {
    /// What the file's grids are for, by their names, as Blender, Houdini and `EmberGen` give them. Capital
    /// letters are as good as small ones.
    ///
    /// ```no_run
    /// # use bevy::prelude::*;
    /// # use bevy_vdb::prelude::*;
    /// # fn smoke(mut commands: Commands, file: &VdbFile, grids: Res<Assets<VdbGrid>>) {
    /// let roles = file.roles(&grids);
    /// if let Some(density) = roles.density {
    ///     let mut smoke = commands.spawn(VdbVolume(density));
    ///     if let Some(fire) = roles.emission {
    ///         smoke.insert(fire);
    ///     }
    /// }
    /// # }
    /// ```
    pub fn roles(&self, grids: &Assets<VdbGrid>) -> VdbRoles {
        let there = self.grids.iter().filter_map(|handle| Some((handle, grids.get(handle)?)));
        let (fogs, surfaces): (Vec<_>, Vec<_>) =
            there.partition(|(_, grid)| matches!(grid.kind(), PackKind::Fog));
        let called = |name: &str| fogs.iter().find(|(_, grid)| is(grid.name(), name));
        // Blender writes every grid that it has, those with nothing in them as well.
        let burns = |(_, grid): &&(_, &VdbGrid)| grid.world_bounds().is_some();
        let fire = FIRES.iter().find_map(|(name, _)| called(name).filter(burns));
        let density = DENSITIES.iter().find_map(|name| called(name)).or_else(|| {
            let others = fogs.iter().find(|(handle, _)| fire.is_none_or(|(own, _)| own != handle));
            others.or(fogs.first())
        });
        let density = density.map(|(handle, _)| (*handle).clone());
        let emission = fire
            .filter(|(handle, _)| density.as_ref() != Some(*handle))
            .map(|(handle, grid)| VdbEmission::guess((*handle).clone(), grid));
        let colors = COLORS.iter().find_map(|name| {
            let mut vectors = self.vector_grids.iter();
            vectors.find(|(label, _)| is(label, name)).map(|(_, grid)| VdbColorGrid(grid.clone()))
        });
        let helps = |grid: &VdbGrid| {
            let start = grid.name().get(..HELPERS.len());
            density.is_some() && start.is_some_and(|start| is(start, HELPERS))
        };
        let surfaces = surfaces.into_iter().filter(|(_, grid)| !helps(grid));
        let surfaces = surfaces.map(|(handle, _)| handle.clone()).collect();
        VdbRoles { surfaces, density, emission, colors }
    }
}

fn is(name: &str, what: &str) -> bool {
    name.eq_ignore_ascii_case(what)
}

impl VdbEmission {
    /// A first guess at how a grid shines, by its name and its values: as black bodies, with kelvin for values
    /// if any is above 100; else `flame` and its like from 1,500 K at 0 to 3,000 K at 1, and all others 1,000 K
    /// at 1. Its strength is for Bevy's default exposure: what is hottest has 1,000 cd/m² through a tenth of
    /// the grid's box.
    pub fn guess(handle: Handle<VdbGrid>, grid: &VdbGrid) -> Self {
        let values = || grid.tree().active_values().take(LOOKED_AT).map(|at| at.value);
        let most = values().fold(0.0, f32::max);
        let by_name = FIRES.iter().find(|(name, _)| is(grid.name(), name));
        let (offset, scale) = match by_name.map_or(HEAT, |(_, kelvin)| *kelvin) {
            _ if most > KELVIN => (0.0, 1.0),
            [none, one] => (none, one - none),
        };
        let hottest = f64::from(scale * most + offset);
        let [r, g, b] = vdb_core::blackbody(hottest);
        let luminance = (0.2126 * r + 0.7152 * g + 0.0722 * b) as f32;
        let strength = LUMINANCE / (luminance.max(1.0) * tenth(grid.world_bounds()));
        Self::Temperature { grid: handle, scale, offset, strength }
    }

    /// A first guess at how a grid of colours shines: 1 has 1,000 cd/m² through a tenth of the grid's box.
    pub fn guess_color(handle: Handle<VdbVectorGrid>, grid: &VdbVectorGrid) -> Self {
        Self::Color { grid: handle, strength: LUMINANCE / tenth(grid.world_bounds()) }
    }
}

/// A tenth of the diagonal of a box; 1 where there is none.
fn tenth(bounds: Option<(DVec3, DVec3)>) -> f32 {
    let tenth = bounds.map_or(1.0, |(low, high)| (0.1 * high.distance(low)) as f32);
    if tenth.is_normal() { tenth } else { 1.0 }
}
