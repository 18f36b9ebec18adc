//! Frames in between the frames of a simulated sequence.
//!
//! [`in_between`] makes the grid at a time between two frames. A cross-fade shows both frames at
//! once: what moves is doubled. Moving smoke along its velocity grid follows it as far as the
//! velocities of two frames describe what happens between them. In a fast jet that is not far,
//! so [`Method::Register`] also matches the two frames with each other (B. D. Lucas and T. Kanade,
//! "An Iterative Image Registration Technique with an Application to Stereo Vision", IJCAI 1981,
//! from coarse to fine), starting both from rest and from what the velocities say, and weighs the
//! resulting motions by how well the two frames agree along them.
//!
//! - [`compare`] measures a made frame against the true one.
//! - [`fit_velocity_scale`] finds the unit of a velocity grid.

mod compare;
mod fit;
mod frame;
mod lattice;
mod make;
mod motion;
mod place;
mod register;
mod sample;
mod trace;
mod velocity;

use crate::{AnyTree, Error, Grid, Limits};

pub use compare::{Difference, Rays, compare};
pub use fit::fit_velocity_scale;
pub use frame::{Frame, MAX_DISPLACEMENT};

/// How a frame in between is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Carries both frames along the velocities and along the motion found by matching them, and
    /// blends what agrees best. Works without velocities, from matching alone.
    #[default]
    Register,
    /// Carries the first frame forward and the second one backward along the velocities, and
    /// blends them by time. Without velocities it is an error.
    Advect,
    /// Blends the two frames where they are.
    CrossFade,
}

/// Options for making a frame in between.
#[derive(Clone, Debug, Default)]
pub struct BetweenOptions {
    /// The method.
    pub method: Method,
    /// World units moved from one frame to the next at a velocity of 1: `1 / fps` for Houdini, whose
    /// velocities are in world units per second; `0.1 · 25 / fps` times the edge of a voxel for
    /// Blender's fluid caches. `None` [fits](fit_velocity_scale) it to the two frames, anew for each
    /// frame in between. If no scale fits, the velocities are ignored, and [`Method::Advect`] gives
    /// a cross-fade.
    pub velocity_scale: Option<f64>,
    /// The memory limit, of the motion and of the new tree alike: [`Limits::tree_bytes`].
    pub limits: Limits,
}

/// Makes the grid at time `t` between two frames, from 0 at the first to 1 at the second.
///
/// It has the transform of the first frame, and the name, the class and the metadata of the nearer
/// one. Values and velocities that are not finite count as zero. Voxels of the background value are
/// inactive, all others active.
///
/// # Errors
/// If a grid has values of another type, is a level set or has a frustum transform, if `t` or the
/// scale is out of range, if [`Method::Advect`] lacks velocities, and if the work needs more memory
/// than the limits allow.
pub fn in_between(from: Frame, to: Frame, t: f64, options: &BetweenOptions) -> Result<Grid, Error> {
    if !(0.0..=1.0).contains(&t) {
        let what = format!("a frame at time {t}; the time between two frames is from 0 to 1");
        return Err(Error::not_supported(what));
    }
    let pair = place::Pair::new(from.grid, to.grid)?;
    let scale = match (options.method, from.velocity, to.velocity) {
        (Method::CrossFade, ..) => None,
        (Method::Advect, Some(_), Some(_)) | (Method::Register, Some(_), Some(_)) => {
            scale(from, to, options)?
        }
        (Method::Advect, ..) => {
            let what = "no velocities in both frames to carry this grid along; name their grid, or \
                        use another method";
            return Err(Error::not_supported(what).in_grid(&from.grid.unique_name));
        }
        (Method::Register, ..) => None,
    };
    let flow = match (scale, from.velocity, to.velocity) {
        (Some(scale), Some(a), Some(b)) => Some(velocity::Flow::new(&pair, a, b, scale)?),
        _ => None,
    };
    let limits = &options.limits;
    let motion = match options.method {
        Method::CrossFade => Ok(motion::Motion::none()),
        Method::Advect => motion::Motion::advected(&pair, flow.as_ref(), t, limits),
        Method::Register => motion::Motion::registered(&pair, flow.as_ref(), t, limits),
    };
    let tree = motion
        .and_then(|motion| make::make(&pair, &motion, t, limits))
        .map_err(|error| error.in_grid(&from.grid.unique_name))?;
    let nearer = if t < 0.5 { from.grid } else { to.grid };
    Ok(Grid {
        transform: from.grid.transform.clone(),
        tree: AnyTree::Float(tree.into()),
        type_name: from.grid.type_name.clone(),
        instance_of: None,
        file_bytes: 0,
        ..nearer.clone()
    })
}

/// The scale of the velocities: as given, or as fitted. `None` if they explain nothing.
fn scale(from: Frame, to: Frame, options: &BetweenOptions) -> Result<Option<f64>, Error> {
    match options.velocity_scale {
        Some(scale) if scale.is_finite() => Ok(Some(scale)),
        Some(scale) => {
            let what = format!("a velocity scale of {scale}; give a finite number");
            Err(Error::not_supported(what))
        }
        None => fit_velocity_scale(from, to),
    }
}
