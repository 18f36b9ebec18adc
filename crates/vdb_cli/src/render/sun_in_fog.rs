//! The sun's light in a fog: the depths up to each point, and what is scattered more than once, solved on
//! a lattice for the picture.

use glam::{DVec3, Vec4};
use vdb_core::scattering::{
    FogOctants, FogSample, InScattering, Lattice, MAX_CELLS, Optics, Phase, ScatteredLight,
};

use super::light_map::LightMap;
use super::medium::Medium;
use super::scene::Volume;

/// A sun and a fog.
pub struct SunInFog<'a> {
    pub map: &'a LightMap,
    to_sun: DVec3,
    phase: Phase,
    /// Light that was scattered more than once, in each of the medium's channels.
    scattered: Vec<ScatteredLight>,
}

impl<'a> SunInFog<'a> {
    /// Solves for the light of a sun in a direction of unit length, of which the map has the depths. Light is
    /// scattered equally in all directions.
    pub fn new(fog: &Volume, medium: &Medium, map: &'a LightMap, to_sun: DVec3) -> Self {
        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        fog.visit_corners(&mut |corner| {
            bounds = [bounds[0].min(corner), bounds[1].max(corner)];
        });
        let query = fog.query_points();
        let octants = FogOctants::new(Lattice::around(bounds, MAX_CELLS), |at| FogSample {
            extinction: query.trilinear(fog.point_to_index(at)).unwrap_or(0.0),
            depth: map.depth(at),
        });
        let phase = Phase::new(0.0);
        let solve = |channel: usize| {
            let [extinction, albedo] = [medium.extinction[channel], medium.albedo[channel]];
            ScatteredLight::solve(&octants, &Optics { extinction, albedo, phase }, to_sun)
        };
        let scattered = (0..medium.channels()).map(solve).collect();
        Self { map, to_sun, phase, scattered }
    }

    /// What a view ray in a direction of unit length sees of an albedo, per unit of irradiance.
    pub fn seen_along(&self, dir: DVec3, albedo: f32) -> InScattering {
        InScattering::new(&self.phase, albedo, dir.as_vec3(), self.to_sun.as_vec3())
    }

    /// The fluence and the flux at a point in world space, in a channel of the medium.
    pub fn scattered(&self, channel: usize, point: DVec3) -> Vec4 {
        self.scattered[channel].at(point)
    }
}
