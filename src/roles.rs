//! What the grids of a file are for, identified by name.

use bevy::math::DVec3;
use bevy::prelude::*;
use vdb_core::pack::PackKind;

use crate::{VdbColorGrid, VdbEmission, VdbFile, VdbGrid, VdbVectorGrid};

/// Names of densities in OpenVDB, Blender, Houdini and `EmberGen`.
const DENSITIES: [&str; 2] = ["density", "smoke"];

/// Names of emission grids, and the temperatures in kelvin that 0 and 1 stand for. Fire comes
/// before heat, which smoke has as well.
const FIRES: [(&str, [f32; 2]); 7] = [
    ("flame", FLAMES),
    ("flames", FLAMES),
    ("fire", FLAMES),
    ("burn", FLAMES),
    ("temperature", HEAT),
    ("heat", HEAT),
    ("temp", HEAT),
];
/// Ignition and maximum temperature of fuel: Blender's defaults.
const FLAMES: [f32; 2] = [1_500.0, 3_000.0];
/// The temperature in Blender's Principled Volume.
const HEAT: [f32; 2] = [0.0, 1_000.0];

/// Houdini's name for a surface.
const SURFACE: &str = "surface";

/// The prefix of auxiliary surfaces in Blender's fluid simulations.
const HELPERS: &str = "phi_";

/// Names of colours: Houdini's, and common ones.
const COLORS: [&str; 4] = ["cd", "color", "colour", "albedo"];

/// Temperatures above this are in kelvin; other units stay far below.
const KELVIN: f32 = 100.0;

/// The largest number of values examined to find out.
const LOOKED_AT: usize = 1 << 20;

/// Luminance in cd/m² of the first guess for fire at its hottest, through a tenth of its box: white
/// at Bevy's default exposure.
const LUMINANCE: f32 = 1_000.0;

/// The grids of a [`VdbFile`] by role: see [`VdbFile::roles`].
#[derive(Clone, Debug, Default)]
pub struct VdbRoles {
    /// All surfaces, in file order. If there is a density, without Blender's auxiliary ones, such
    /// as `phi_obstacle`.
    pub surfaces: Vec<Handle<VdbGrid>>,
    /// The fog: a grid called `density` or `smoke`, otherwise the first fog grid.
    pub density: Option<Handle<VdbGrid>>,
    /// The emission within the fog: a first guess ([`VdbEmission::guess`]) for another non-empty
    /// fog grid, called `flame`, `flames`, `fire`, `burn`, `temperature`, `heat` or `temp`, in this
    /// order.
    pub emission: Option<VdbEmission>,
    /// The colour of the surfaces: a vector grid called `Cd`, `color`, `colour` or `albedo`.
    pub colors: Option<VdbColorGrid>,
}

impl VdbFile {
    /// Identifies the grids of the file by the names that Blender, Houdini and `EmberGen` give
    /// them, ignoring case.
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
        let (handles, grids): (Vec<_>, Vec<_>) = there.unzip();
        let candidates: Vec<_> = grids.iter().map(|grid| Candidate::of(grid)).collect();
        let parts = parts(&candidates);
        let emission =
            parts.fire.map(|fire| VdbEmission::guess(handles[fire].clone(), grids[fire]));
        let colors = COLORS.iter().find_map(|name| {
            let mut vectors = self.vector_grids.iter();
            vectors.find(|(label, _)| is(label, name)).map(|(_, grid)| VdbColorGrid(grid.clone()))
        });
        VdbRoles {
            surfaces: parts.surfaces.iter().map(|surface| handles[*surface].clone()).collect(),
            density: parts.density.map(|density| handles[density].clone()),
            emission,
            colors,
        }
    }
}

/// What is known of a grid when its role is chosen.
pub(crate) struct Candidate<'a> {
    pub name: &'a str,
    pub is_fog: bool,
    /// Whether there is nothing to see.
    pub is_empty: bool,
}

impl<'a> Candidate<'a> {
    fn of(grid: &'a VdbGrid) -> Self {
        Self {
            name: grid.name(),
            is_fog: grid.kind() == PackKind::Fog,
            is_empty: grid.world_bounds().is_none(),
        }
    }
}

/// Roles, as positions in a list of grids.
struct Parts {
    surfaces: Vec<usize>,
    density: Option<usize>,
    fire: Option<usize>,
}

fn parts(all: &[Candidate]) -> Parts {
    let fogs = || (0..all.len()).filter(|i| all[*i].is_fog);
    let called = |name: &str| fogs().find(|i| is(all[*i].name, name));
    // Blender writes every grid that it has, those with nothing in them as well.
    let fire = FIRES.iter().find_map(|(name, _)| called(name).filter(|i| !all[*i].is_empty));
    let density = DENSITIES.iter().find_map(|name| called(name));
    let density = density.or_else(|| fogs().find(|i| fire != Some(*i)).or(fogs().next()));
    let helps = |name: &str| {
        density.is_some() && name.get(..HELPERS.len()).is_some_and(|start| is(start, HELPERS))
    };
    let surfaces = (0..all.len()).filter(|i| !all[*i].is_fog && !helps(all[*i].name)).collect();
    Parts { surfaces, density, fire: fire.filter(|fire| density != Some(*fire)) }
}

/// The main grid of a file: its surface, or its fog. `None` if there are several candidates.
pub(crate) fn main_grid(all: &[Candidate]) -> Option<usize> {
    let Parts { surfaces, density, fire } = parts(all);
    match (&surfaces[..], density) {
        ([], density) => {
            let is_named = |i: &usize| DENSITIES.iter().any(|name| is(all[*i].name, name));
            let fogs = (0..all.len()).filter(|i| all[*i].is_fog && fire != Some(*i)).count();
            density.filter(|density| is_named(density) || fogs == 1)
        }
        ([surface], None) => Some(*surface),
        (several, None) => several.iter().copied().find(|i| is(all[*i].name, SURFACE)),
        (_, Some(_)) => None,
    }
}

/// The main vector grid, by name.
pub(crate) fn main_vectors(names: &[&str]) -> Option<usize> {
    let called = |name: &&str| names.iter().position(|own| is(own, name));
    COLORS.iter().find_map(called).or((names.len() == 1).then_some(0))
}

fn is(name: &str, what: &str) -> bool {
    name.eq_ignore_ascii_case(what)
}

impl VdbEmission {
    /// A first guess at how a grid emits, by its name and values: black bodies, in kelvin if any
    /// value exceeds 100; otherwise 1,500 K at 0 to 3,000 K at 1 for `flame` and similar names, and
    /// 1,000 K at 1 for others. The strength suits Bevy's default exposure: the hottest value has
    /// 1,000 cd/m² through a tenth of the grid's box.
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

    /// A first guess at how a colour grid emits: 1 has 1,000 cd/m² through a tenth of the grid's
    /// box.
    pub fn guess_color(handle: Handle<VdbVectorGrid>, grid: &VdbVectorGrid) -> Self {
        Self::Color { grid: handle, strength: LUMINANCE / tenth(grid.world_bounds()) }
    }
}

/// A tenth of the diagonal of a box; 1 if there is none.
fn tenth(bounds: Option<(DVec3, DVec3)>) -> f32 {
    let tenth = bounds.map_or(1.0, |(low, high)| (0.1 * high.distance(low)) as f32);
    if tenth.is_normal() { tenth } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_that_a_file_is_about_is_found_or_asked_for() {
        let main = |all: &[(&'static str, bool)]| {
            let candidate = |&(name, is_fog)| Candidate { name, is_fog, is_empty: false };
            main_grid(&all.iter().map(candidate).collect::<Vec<_>>())
        };
        let (fog, surface) = (true, false);
        for (all, expected) in [
            (&[("ls_dragon", surface)][..], Some(0)),
            (&[("", surface)], Some(0)),
            (&[("ls", fog)], Some(0)),
            // Blender's and Houdini's smoke.
            (&[("temperature", fog), ("density", fog), ("flame", fog), ("shadow", fog)], Some(1)),
            (&[("phi_obstacle", surface), ("Density", fog), ("heat", fog)], Some(1)),
            (&[("heat", fog), ("fuel", fog)], Some(1)),
            (&[("temperature", fog)], Some(0)),
            (&[("collision", surface), ("surface", surface)], Some(1)),
            // These could be any.
            (&[("left", surface), ("right", surface)], None),
            (&[("a", fog), ("b", fog)], None),
            (&[("surface", surface), ("density", fog)], None),
            (&[], None),
        ] {
            assert_eq!(main(all), expected, "{all:?}");
        }
        assert_eq!(main_vectors(&["vel", "cd"]), Some(1));
        assert_eq!(main_vectors(&["vel"]), Some(0));
        assert_eq!(main_vectors(&["vel", "rest"]), None);
        assert_eq!(main_vectors(&[]), None);
    }
}
