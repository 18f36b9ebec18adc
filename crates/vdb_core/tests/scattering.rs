//! Light scattered many times by the lattice and closed forms along view rays: against path tracing.

use glam::{DVec3, UVec2};
use rayon::prelude::*;
use vdb_core::reference::{Fog, Paths, Ray, Scattering};
use vdb_core::scattering::{
    FogOctants, FogSample, InScattering, Lattice, MAX_CELLS, Optics, Phase, ScatteredLight,
};
use vdb_core::synth::fog;
use vdb_core::tree::Vdb543;

/// The image, the cloud and the suns of the tables in docs/reference/fog.md.
const SIZE: UVec2 = UVec2::new(96, 64);
const RADIUS: f64 = 16.0;
const EYE: DVec3 = DVec3::new(0.0, 0.0, 50.0);
const SIDE: DVec3 = DVec3::new(1.0, 0.3, 0.2);
const BEFORE: DVec3 = DVec3::new(0.4, 0.3, -1.0);
const BEHIND: DVec3 = DVec3::new(0.3, 0.5, 1.0);

struct Cloud {
    tree: Vdb543<f32>,
    /// Optical depth through the middle for an extinction of 1 per voxel.
    depth: f64,
}

/// What a pixel sees: by paths, with the standard error, and by the lattice; for each albedo.
type Pixel = Vec<([f64; 2], f64)>;

/// The brightness of an image relative to paths and its standard error, the mean error of a pixel relative to
/// the mean light, and the mean noise of the paths of a pixel.
struct Errors {
    brightness: f64,
    uncertainty: f64,
    error: f64,
    noise: f64,
}

impl Errors {
    fn of(pixels: &[Pixel], albedo: usize) -> Self {
        let sum =
            |f: &dyn Fn(&([f64; 2], f64)) -> f64| pixels.iter().map(|p| f(&p[albedo])).sum::<f64>();
        let all = sum(&|([right, _], _)| *right);
        Self {
            brightness: sum(&|(_, found)| *found) / all,
            uncertainty: sum(&|([_, noise], _)| noise * noise).sqrt() / all,
            error: sum(&|([right, _], found)| (found - right).abs()) / all,
            noise: sum(&|([_, noise], _)| *noise) / all,
        }
    }

    /// Without the noise of the paths: the mean magnitude of a normal distribution is 0.8 of its width.
    fn deducted(&self) -> f64 {
        (self.error.powi(2) - (0.8 * self.noise).powi(2)).max(0.0).sqrt()
    }
}

impl Cloud {
    fn new() -> Self {
        let tree = fog::cloud(RADIUS, 3);
        let through = Ray::from_f64(EYE, DVec3::NEG_Z);
        let depth = Fog::new(&tree).optical_depth(&through).value;
        Self { tree, depth }
    }

    /// The fog and the depths towards a sun, for an extinction of 1 per voxel.
    fn octants(&self, to_sun: DVec3) -> FogOctants {
        let bbox = self.tree.active_bbox().expect("a cloud");
        // A sample contributes to all cells around it.
        let bounds = [bbox.min.as_dvec3() - 1.0, bbox.max.as_dvec3() + 1.0];
        let fog = Fog::new(&self.tree);
        FogOctants::new(Lattice::around(bounds, MAX_CELLS), |at| FogSample {
            extinction: self.density(at) as f32,
            depth: fog.optical_depth(&Ray::from_f64(at, to_sun)).value as f32,
        })
    }

    /// The trilinear density.
    fn density(&self, at: DVec3) -> f64 {
        let (cell, mut accessor) = (at.floor(), self.tree.accessor());
        let [u, v, w] = (at - cell).to_array();
        let mut corner = |i: i32| {
            let offset = glam::IVec3::new(i & 1, i >> 1 & 1, i >> 2);
            let weight = |u: f64, i: i32| if i == 1 { u } else { 1.0 - u };
            let value = f64::from(accessor.get(cell.as_ivec3() + offset));
            weight(u, offset.x) * weight(v, offset.y) * weight(w, offset.z) * value
        };
        (0..8).map(&mut corner).sum()
    }

    /// What every `apart`-th pixel in both directions sees of a fog with an optical depth through its
    /// middle, in the light of a sun with an irradiance of 1.
    fn pixels(
        &self,
        (depth, g, to_sun): (f64, f64, DVec3),
        albedos: &[f64],
        (paths, apart): (u32, usize),
    ) -> Vec<Pixel> {
        let extinction = depth / self.depth;
        let to_sun = to_sun.normalize();
        let octants = self.octants(to_sun);
        let phase = Phase::new(g);
        let optics =
            |albedo: &f64| Optics { extinction: extinction as f32, albedo: *albedo as f32, phase };
        let solved: Vec<ScatteredLight> = albedos
            .iter()
            .map(|albedo| ScatteredLight::solve(&octants, &optics(albedo), to_sun))
            .collect();
        let all = Paths::new(&self.tree).expect("the cloud has an end");
        let fog = Fog::new(&self.tree);
        let scattering = Scattering { extinction, anisotropy: g, to_sun, orders: u32::MAX };
        let places = (0..SIZE.y)
            .step_by(apart)
            .flat_map(|y| (0..SIZE.x).step_by(apart).map(move |x| (x, y)));
        let places: Vec<_> = places.collect();
        let pixel = |(x, y): (u32, u32)| {
            let ray = (EYE, pixel_direction(x, y));
            let passed = fog.transmittance(&Ray::from_f64(ray.0, ray.1), extinction).value;
            if passed == 1.0 {
                return None;
            }
            let right = all.light(ray, &scattering, albedos, paths, u64::from(y * SIZE.x + x));
            let to_sun = to_sun.as_vec3();
            let rays = albedos
                .iter()
                .map(|albedo| InScattering::new(&phase, *albedo as f32, ray.1.as_vec3(), to_sun));
            let rays: Vec<InScattering> = rays.collect();
            let mut light = vec![0.0; albedos.len()];
            self.march(ray, extinction, |at, seen| {
                let depth =
                    extinction * fog.optical_depth(&Ray::from_f64(at, scattering.to_sun)).value;
                for ((light, ray), solved) in light.iter_mut().zip(&rays).zip(&solved) {
                    *light += f64::from(ray.step(seen, depth as f32, solved.at(at)));
                }
            });
            let right = right.iter().map(|light| [light.sun.value, light.sun.standard_error]);
            Some(right.zip(light).collect())
        };
        places.into_par_iter().filter_map(pixel).collect()
    }

    /// Visits steps of half a voxel along a ray, in fog: the middle of each, and the transmittances to its
    /// ends.
    fn march(
        &self,
        (origin, direction): (DVec3, DVec3),
        extinction: f64,
        mut visit: impl FnMut(DVec3, [f32; 2]),
    ) {
        let (step, reach) = (0.5, 2.0 * RADIUS);
        let first = origin.length() - reach;
        let mut passed = 0.0_f64;
        for i in 0..(2.0 * reach / step) as u32 {
            let at = origin + (first + (f64::from(i) + 0.5) * step) * direction;
            let depth = extinction * step * self.density(at);
            if depth > 0.0 && passed < 16.0 {
                visit(at, [passed, passed + depth].map(|depth| (-depth).exp() as f32));
            }
            passed += depth;
        }
    }
}

/// The direction of a pixel of a camera that looks along -z, with a vertical field of view of 45°.
fn pixel_direction(x: u32, y: u32) -> DVec3 {
    let half = 22.5_f64.to_radians().tan();
    let at = (UVec2::new(x, y).as_dvec2() + 0.5) / SIZE.as_dvec2() * 2.0 - 1.0;
    let aspect = f64::from(SIZE.x) / f64::from(SIZE.y);
    DVec3::new(at.x * half * aspect, -at.y * half, -1.0).normalize()
}

/// A cloud of medium depth, in which light scattered once is a third of all at most, is as bright as by paths,
/// whatever its phase function; and so is each pixel, nearly.
#[test]
fn a_cloud_is_as_bright_as_by_paths() {
    let cloud = Cloud::new();
    for (g, paths) in [(0.0, 128), (0.8, 256), (-0.5, 128)] {
        let albedos = [0.9, 1.0];
        let pixels = cloud.pixels((10.0, g, SIDE), &albedos, (paths, 4));
        assert!(pixels.len() > 50, "{} pixels of cloud", pixels.len());
        for (i, albedo) in albedos.into_iter().enumerate() {
            let errors = Errors::of(&pixels, i);
            let Errors { brightness, uncertainty, error, .. } = errors;
            let deducted = errors.deducted();
            println!(
                "g {g}, albedo {albedo}: {brightness:.3} ± {uncertainty:.3}, {error:.3} off, {deducted:.3} without noise"
            );
            // The errors of the model itself, from the table below: 0.05 in the brightness under one sun, 0.07 in
            // pixels, and half as much again in what is left after noise was deducted.
            assert!(
                (brightness - 1.0).abs() < 0.05 + 3.0 * uncertainty,
                "g {g}, albedo {albedo}: {brightness}"
            );
            assert!(deducted < 0.11, "g {g}, albedo {albedo}: {deducted} off");
        }
    }
}

/// Prints the table of docs/internals/notebook.md, where `BEVY_VDB_PATHS` is the number of paths of a pixel.
#[test]
fn errors_of_the_lattice() {
    let Ok(count) = std::env::var("BEVY_VDB_PATHS") else {
        eprintln!("SKIPPED: the table of errors of the lattice, for which BEVY_VDB_PATHS asks");
        return;
    };
    let count: u32 = count.parse().expect("a number");
    let cloud = Cloud::new();
    let albedos = [0.9, 0.99, 1.0];
    for depth in [2.0, 10.0, 50.0] {
        for g in [0.0, 0.8] {
            let suns = [SIDE, BEFORE, BEHIND]
                .map(|to_sun| cloud.pixels((depth, g, to_sun), &albedos, (count, 3)));
            let mut row = format!("| {depth} | {g} |");
            for albedo in 0..albedos.len() {
                let errors = [0, 1, 2].map(|sun: usize| Errors::of(&suns[sun], albedo));
                let mean = |f: &dyn Fn(&Errors) -> f64| errors.iter().map(f).sum::<f64>() / 3.0;
                let brightness: Vec<String> =
                    errors.iter().map(|e| format!("{:.2}", e.brightness)).collect();
                row += &format!(
                    " {:.3} | {:.3} | {:.2} ({}) | {:.3} |",
                    mean(&|e| e.error),
                    mean(&|e| e.deducted()),
                    mean(&|e| e.brightness),
                    brightness.join(" "),
                    mean(&|e| e.noise)
                );
            }
            println!("{row}");
        }
    }
}
