//! Multiple scattering in fog by discrete ordinates on a coarse lattice, on the CPU: for pictures without
//! a GPU, and as the twin of the shaders.
//!
//! The Henyey–Greenstein function is divided into a forward peak and a remainder that is linear in the
//! cosine ([`Phase`]). Light that was scattered in the peak alone, and light that was also scattered once
//! in the remainder, have closed forms along a view ray ([`InScattering`]). Everything else comes from a
//! [`Lattice`] of at most 32³ cells: [`FogOctants`] samples the fog and the depth towards the light, and
//! [`ScatteredLight::solve`] finds the fluence and the flux in each cell.
//!
//! Nothing is fitted. `docs/internals/notebook.md` compares other forms.

mod chebyshev;
mod lattice;
mod medium;
mod octants;
mod phase;
mod solution;
mod sweep;
#[cfg(test)]
mod tests;
mod view_ray;

pub use chebyshev::relaxation_factors;
pub use lattice::{Lattice, MAX_CELLS};
pub use octants::{FogOctants, FogSample};
pub use phase::{MAX_ANISOTROPY, Phase};
pub use solution::{Optics, ScatteredLight};
pub use view_ray::InScattering;
