//! Rays made to be hard: along axes and diagonals, through edges and corners, with components that
//! are zero, denormal or tiny, from anywhere.

use glam::{DVec3, IVec3, Vec3};

use super::Random;

/// A ray as a shader gets it, `p(t) = cell + frac + t · dir`, in any lattice.
#[derive(Clone, Copy, Debug)]
pub struct HardRay {
    /// The cell of the origin.
    pub cell: IVec3,
    /// Where in the cell: a multiple of 2⁻²⁴ from 0 up to but not 1.
    pub frac: Vec3,
    /// Not zero; not of unit length.
    pub dir: Vec3,
}

/// A ray towards `target` (it passes within a few cells) from up to `far` cells away, mostly from
/// closer by. `None` where the origin would lie farther out than 2³⁰.
pub fn hard_ray(random: &mut Random, target: DVec3, far: f64) -> Option<HardRay> {
    let dir = loop {
        let dir = if random.below(3) == 0 {
            // Exactly along an axis or a diagonal.
            Vec3::from_array([0; 3].map(|_| random.below(3) as f32 - 1.0))
        } else {
            Vec3::from_array([0; 3].map(|_| component(random)))
        };
        if dir.abs().max_element() > 1e-3 {
            break dir;
        }
    };
    let away = random.range(0.0, 1.0).powi(4) * far;
    let origin = target - dir.as_dvec3().normalize() * away;
    let frac = Vec3::from_array([0; 3].map(|_| fraction(random)));
    let near = origin.abs().max_element() < f64::from(1 << 30);
    near.then(|| HardRay { cell: origin.floor().as_ivec3(), frac, dir })
}

/// One of the numbers that rays go wrong on.
fn component(random: &mut Random) -> f32 {
    match random.below(9) {
        0 => 0.0,
        1 => -0.0,
        2 => 1.0,
        3 => -1.0,
        4 => 0.5,
        // Denormal.
        5 => f32::from_bits(random.bits() as u32 & 0x807f_ffff),
        6 => random.range(-1.0, 1.0) as f32 * 1e-12,
        7 => (random.below(7) as f32 - 3.0) * 0.25,
        _ => random.range(-1.0, 1.0) as f32,
    }
}

/// Often on an edge, or one unit beside it.
fn fraction(random: &mut Random) -> f32 {
    let unit = 1.0 / (1 << 24) as f32;
    match random.below(5) {
        0 => 0.0,
        1 => 0.5,
        2 => unit * random.below(3) as f32,
        3 => 1.0 - unit * (1 + random.below(2)) as f32,
        _ => unit * random.below(1 << 24) as f32,
    }
}
