//! Registration: the smooth motion that makes one field look like another.

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::lattice::{Field, Lattice};

/// The standard deviations of the windows in which motion counts as one, from coarse to fine, in
/// nodes.
const WINDOWS: [f64; 4] = [6.0, 3.0, 2.0, 1.5];
/// Steps for each window.
const STEPS: usize = 5;
/// The longest change in one step along an axis, in nodes.
const LONGEST: f32 = 3.0;

/// The motion `w` for which `a` at `x - t·w` equals `b` at `x + (1 - t)·w`, in nodes, by the method
/// of Lucas and Kanade: Gauss-Newton steps of the squared difference in a window. `stiffness` keeps
/// the motion where a window shows none; values are to be of the order of 1.
pub(super) fn registered(
    lattice: &Lattice,
    a: &Field,
    b: &Field,
    t: f64,
    stiffness: f64,
) -> Vec<Vec3> {
    let mut motion = vec![Vec3::ZERO; lattice.len()];
    for window in WINDOWS {
        for _ in 0..STEPS {
            let (a, b) = (warped(lattice, a, &motion, -t), warped(lattice, b, &motion, 1.0 - t));
            let steps = steps(lattice, &a, &b, window, stiffness);
            motion.par_iter_mut().zip(steps).for_each(|(motion, step)| *motion += step);
            motion = smoothed(lattice, &motion, 0.5 * window);
        }
    }
    motion
}

/// A field at the nodes moved by a multiple of the motion.
pub(super) fn warped(lattice: &Lattice, field: &Field, motion: &[Vec3], times: f64) -> Field {
    let zero = lattice.position(0);
    lattice.each(
        || (),
        |(), i| {
            let node = (lattice.position(i) - zero) / lattice.spacing as f64;
            lattice.interpolated([field], node + times * motion[i].as_dvec3())[0]
        },
    )
}

/// One Gauss-Newton step per node.
fn steps(lattice: &Lattice, a: &Field, b: &Field, window: f64, stiffness: f64) -> Vec<Vec3> {
    let mean: Field = a.par_iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect();
    let gradient = lattice.gradient(&mean);
    let product = |x: usize, y: usize| {
        let products: Field =
            gradient[x].par_iter().zip(&gradient[y]).map(|(x, y)| x * y).collect();
        lattice.blurred(&products, window)
    };
    let squares = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(x, y)| product(x, y));
    let slopes = [0, 1, 2].map(|axis: usize| {
        let products: Field = gradient[axis]
            .par_iter()
            .zip(a.par_iter().zip(b))
            .map(|(slope, (a, b))| slope * (b - a))
            .collect();
        lattice.blurred(&products, window)
    });
    lattice.each(
        || (),
        |(), i| {
            let [xx, xy, xz, yy, yz, zz] =
                [0, 1, 2, 3, 4, 5].map(|k: usize| f64::from(squares[k][i]));
            let matrix = DMat3::from_cols_array(&[
                xx + stiffness,
                xy,
                xz,
                xy,
                yy + stiffness,
                yz,
                xz,
                yz,
                zz + stiffness,
            ]);
            let right = DVec3::from_array([0, 1, 2].map(|k: usize| f64::from(slopes[k][i])));
            // Positive definite, so it has an inverse.
            let step = -(matrix.inverse() * right).as_vec3();
            if step.is_finite() {
                step.clamp(Vec3::splat(-LONGEST), Vec3::splat(LONGEST))
            } else {
                Vec3::ZERO
            }
        },
    )
}

fn smoothed(lattice: &Lattice, motion: &[Vec3], sigma: f64) -> Vec<Vec3> {
    let [x, y, z] = [0, 1, 2].map(|axis: usize| {
        let component: Field = motion.par_iter().map(|motion| motion[axis]).collect();
        lattice.blurred(&component, sigma)
    });
    x.into_par_iter().zip(y).zip(z).map(|((x, y), z)| Vec3::new(x, y, z)).collect()
}
