//! The roles of the grids of a file, identified by name.

use bevy::math::DVec3;
use bevy::prelude::*;

use crate::asset::parts::{COLORS, VELOCITIES, candidate, is, kelvin, parts};
use crate::{VdbColorGrid, VdbEmission, VdbFile, VdbGrid, VdbVectorGrid};

/// The luminance in cd/m² of guessed emission, for the hottest value through a tenth of the grid's
/// box. White at Bevy's default exposure.
const LUMINANCE: f32 = 1_000.0;

/// The grids of a [`VdbFile`] by role: see [`VdbFile::roles`].
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct VdbRoles {
    /// All surfaces, in file order. If there is a density, Blender's auxiliary surfaces, such as
    /// `phi_obstacle`, are left out. If the density is not empty, so are grids called `distance`,
    /// `sdf` or `signed_distance`, which would hide it.
    pub surfaces: Vec<Handle<VdbGrid>>,
    /// The fog: a grid called `density` or `smoke`, otherwise the first fog grid that is not a
    /// component of a colour or velocity, such as `Cd.x`, `color_r` or `vel.z`.
    pub density: Option<Handle<VdbGrid>>,
    /// The emission within the fog: a first guess ([`VdbEmission::guess`]) for another non-empty
    /// fog grid, called `flame`, `flames`, `fire`, `burn`, `temperature`, `heat` or `temp`, in this
    /// order.
    pub emission: Option<VdbEmission>,
    /// The colour of surfaces and fog: a vector grid called `Cd`, `color`, `colour` or `albedo`, or
    /// three float grids that are its components, such as `Cd.x`, `Cd.y` and `Cd.z`, or
    /// `color_r`, `color_g` and `color_b`.
    pub colors: Option<VdbColorGrid>,
    /// The velocity: a vector grid called `velocity`, `vel` or `v`.
    pub velocity: Option<Handle<VdbVectorGrid>>,
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
        let candidates: Vec<_> = grids.iter().map(|grid| candidate(grid)).collect();
        let parts = parts(&candidates);
        let emission =
            parts.fire.map(|fire| VdbEmission::guess(handles[fire].clone(), grids[fire]));
        VdbRoles {
            surfaces: parts.surfaces.iter().map(|surface| handles[*surface].clone()).collect(),
            density: parts.density.map(|density| handles[density].clone()),
            emission,
            colors: self.colors(),
            velocity: self.velocity(),
        }
    }

    /// The colour of surfaces and fog: see [`VdbRoles::colors`].
    pub(crate) fn colors(&self) -> Option<VdbColorGrid> {
        self.vectors(&COLORS).map(VdbColorGrid)
    }

    /// The velocity: see [`VdbRoles::velocity`].
    pub(crate) fn velocity(&self) -> Option<Handle<VdbVectorGrid>> {
        self.vectors(&VELOCITIES)
    }

    /// The vector grid with the first of some names.
    fn vectors(&self, names: &[&str]) -> Option<Handle<VdbVectorGrid>> {
        names.iter().find_map(|name| {
            let mut vectors = self.vector_grids.iter();
            vectors.find(|(label, _)| is(label, name)).map(|(_, grid)| grid.clone())
        })
    }
}

impl VdbEmission {
    /// A first guess at the emission of a grid, by its name and values: black bodies, in kelvin if
    /// any value exceeds 100; otherwise from 1,500 K at 0 to 3,000 K at 1 for `flame` and similar
    /// names, and 1,000 K at 1 for others. The strength suits Bevy's default exposure: the hottest
    /// value has 1,000 cd/m² through a tenth of the grid's box.
    pub fn guess(handle: Handle<VdbGrid>, grid: &VdbGrid) -> Self {
        let most = grid.packed().majorant;
        let [offset, one] = kelvin(grid.name(), most);
        let scale = one - offset;
        let hottest = f64::from(scale * most + offset);
        let [r, g, b] = vdb_core::blackbody(hottest);
        let luminance = (0.2126 * r + 0.7152 * g + 0.0722 * b) as f32;
        let strength = LUMINANCE / (luminance.max(1.0) * tenth(grid.world_bounds()));
        Self::Temperature { grid: handle, scale, offset, strength }
    }

    /// A first guess at the emission of a colour grid: a value of 1 has 1,000 cd/m² through a tenth
    /// of the grid's box.
    pub fn guess_color(handle: Handle<VdbVectorGrid>, grid: &VdbVectorGrid) -> Self {
        Self::Color { grid: handle, strength: LUMINANCE / tenth(grid.world_bounds()) }
    }
}

/// A tenth of the diagonal of a box; 1 if there is none.
fn tenth(bounds: Option<(DVec3, DVec3)>) -> f32 {
    let tenth = bounds.map_or(1.0, |(low, high)| (0.1 * high.distance(low)) as f32);
    if tenth.is_normal() { tenth } else { 1.0 }
}
