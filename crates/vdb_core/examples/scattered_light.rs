//! Path-traced light along rays through clouds, and the quantities that a closed form may use: the
//! data of `scripts/fit-scattering`.
//!
//! Usage: `scattered_light FILE [PATHS]`, with paths per ray. Of each ray, FILE gets little-endian
//! f32: the number of its case (a cloud, an anisotropy, a depth and a sun), the anisotropy, the
//! cosine of the angle between its direction and that to the sun, its optical depth, the radiance
//! for each of [`ALBEDOS`] under a sun with an irradiance of 1, and of each of [`STEPS`] stretches
//! the transmittances up to and beyond it, and the optical depth from its middle to the sun.

use std::{env, error::Error, fs::File, io::BufWriter, io::Write};

use glam::{DVec3, IVec3};
use rayon::prelude::*;
use vdb_core::{
    reference::{Fog, Paths, Ray, Scattering},
    synth::fog,
    tree::{CoordBox, Node, Tree, Vdb543},
};

const ALBEDOS: [f64; 5] = [0.8, 0.9, 0.97, 0.99, 1.0];
const ANISOTROPIES: [f64; 4] = [0.0, 0.3, 0.6, 0.85];
/// Optical depths through the middle of a cloud.
const DEPTHS: [f64; 5] = [0.5, 2.0, 8.0, 20.0, 50.0];
/// Towards the sun. Rays run along -z.
const SUNS: [DVec3; 4] = [
    DVec3::new(0.2, 1.0, 0.1),
    DVec3::new(-0.6, 0.4, -1.0),
    DVec3::new(-0.5, 0.6, 1.0),
    DVec3::new(-0.1, 0.2, -1.0),
];
const STEPS: usize = 48;
/// Rays per row and per column.
const RAYS: u16 = 12;

/// A cloud of a radius of 16 voxels, divided by a factor along each axis.
fn squeezed(seed: u64, factors: DVec3) -> Vdb543<f32> {
    let cloud = fog::cloud(32.0, seed);
    let bbox = CoordBox { min: IVec3::splat(-16), max: IVec3::splat(16) };
    fog::from_values(bbox, |ijk| {
        cloud.accessor().get((2.0 * factors * ijk.as_dvec3()).round().as_ivec3())
    })
}

/// Clouds with their radii in voxels; none of them is among those that errors are measured on.
fn clouds() -> Vec<(f64, Vdb543<f32>)> {
    vec![
        (16.0, fog::cloud(16.0, 1)),
        (24.0, fog::cloud(24.0, 7)),
        (16.0, squeezed(2, DVec3::new(1.0, 3.0, 1.0))),
        (16.0, squeezed(5, DVec3::new(2.0, 1.0, 1.5))),
        (16.0, squeezed(9, DVec3::new(1.0, 1.5, 3.0))),
        (12.0, fog::sphere(DVec3::ZERO, 12.0, 4.0)),
    ]
}

/// A cloud under the sun.
struct Scene<'a, C: Node<Value = f32>> {
    radius: f64,
    fog: &'a Fog<'a, C>,
    paths: &'a Paths<'a, C>,
    scattering: Scattering,
}

impl<C: Node<Value = f32>> Scene<'_, C> {
    fn depth(&self, from: DVec3, direction: DVec3, length: f32) -> f64 {
        let mut ray = Ray::from_f64(from, direction);
        ray.t_max = length;
        self.scattering.extinction * self.fog.optical_depth(&ray).value
    }

    /// What is known of a ray; `None` if it misses the cloud. `x` and `y` are from -1 to 1.
    fn ray(&self, case: usize, x: f64, y: f64, paths: u32, seed: u64) -> Option<Vec<f64>> {
        let Scattering { anisotropy, to_sun, .. } = self.scattering;
        let top = self.radius + 2.0;
        let origin = DVec3::new(self.radius * x, self.radius * y, top);
        let depth = self.depth(origin, DVec3::NEG_Z, f32::INFINITY);
        if depth < 1e-3 {
            return None;
        }
        let mut ray = vec![case as f64, anisotropy, -to_sun.z, depth];
        let start = (origin, DVec3::NEG_Z);
        let light = self.paths.light(start, &self.scattering, &ALBEDOS, paths, seed);
        ray.extend(light.iter().map(|light| light.sun.value));
        let width = 2.0 * top / STEPS as f64;
        let mut before = 0.0;
        for step in 0..STEPS {
            let from = origin - DVec3::Z * (step as f64 * width);
            let beyond = before + self.depth(from, DVec3::NEG_Z, width as f32);
            let to_sun = self.depth(from - DVec3::Z * (0.5 * width), to_sun, f32::INFINITY);
            ray.extend([(-before).exp(), (-beyond).exp(), to_sun]);
            before = beyond;
        }
        Some(ray)
    }
}

/// Writes all rays through one cloud. Returns the number of the next case.
fn write(
    file: &mut impl Write,
    (radius, tree): (f64, &Tree<impl Node<Value = f32>>),
    first_case: usize,
    paths: u32,
) -> Result<usize, Box<dyn Error>> {
    let fog = Fog::new(tree);
    let tracer = Paths::new(tree).ok_or("a cloud without an end")?;
    let middle = fog.optical_depth(&Ray::from_f64(DVec3::Z * 2.0 * radius, DVec3::NEG_Z)).value;
    let mut case = first_case;
    for anisotropy in ANISOTROPIES {
        for extinction in DEPTHS.map(|depth| depth / middle) {
            for to_sun in SUNS.map(DVec3::normalize) {
                let scattering = Scattering { extinction, anisotropy, to_sun, orders: u32::MAX };
                let scene = Scene { radius, fog: &fog, paths: &tracer, scattering };
                let place = |i: u16| (f64::from(i) + 0.5) / f64::from(RAYS) * 2.0 - 1.0;
                let rays: Vec<_> = (0..RAYS * RAYS)
                    .into_par_iter()
                    .filter_map(|i| {
                        let seed = case as u64 * u64::from(RAYS * RAYS) + u64::from(i);
                        scene.ray(case, place(i % RAYS), place(i / RAYS), paths, seed)
                    })
                    .collect();
                for number in rays.concat() {
                    file.write_all(&(number as f32).to_le_bytes())?;
                }
                case += 1;
            }
        }
    }
    Ok(case)
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = env::args().skip(1);
    let path = args.next().ok_or("usage: scattered_light FILE [PATHS]")?;
    let paths = args.next().map_or(Ok(1024), |paths| paths.parse())?;
    let mut file = BufWriter::new(File::create(path)?);
    let clouds = clouds();
    let mut case = 0;
    for (i, (radius, tree)) in clouds.iter().enumerate() {
        eprintln!("cloud {} of {}", i + 1, clouds.len());
        case = write(&mut file, (*radius, tree), case, paths)?;
    }
    file.flush()?;
    Ok(())
}
