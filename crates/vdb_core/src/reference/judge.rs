//! Verdicts on the answers of an f32 tracer.

use super::{Blocky, Face, Ray, Smooth, SurfaceHit, SurfaceTrace};
use crate::tree::{IVec3, Node};

/// A verdict on the first voxel and the face entered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VoxelVerdict {
    /// Voxel and face are correct.
    Right,
    /// Correct for the ray with its denormals flushed to zero ([`Ray::flushed`]), as hardware may
    /// do.
    RightWhenFlushed,
    /// The correct voxel, but the wrong face.
    WrongFace,
    /// The wrong voxel, a hit where there is none, or a miss where there is a hit.
    WrongVoxel,
}

impl<C: Node<Value = f32>> Blocky<'_, C> {
    /// Judges an answer: a voxel and the face entered (`None`: the ray begins inside), or a miss.
    pub fn judge(&self, ray: &Ray, answer: Option<(IVec3, Option<Face>)>) -> VoxelVerdict {
        let truth = |ray: &Ray| self.first_voxel(ray).map(|hit| (hit.ijk, hit.face));
        let exact = truth(ray);
        if answer == exact {
            return VoxelVerdict::Right;
        }
        let flushed = ray.flushed();
        if flushed != *ray && answer == truth(&flushed) {
            return VoxelVerdict::RightWhenFlushed;
        }
        match (answer, exact) {
            (Some((a, _)), Some((b, _))) if a == b => VoxelVerdict::WrongFace,
            _ => VoxelVerdict::WrongVoxel,
        }
    }
}

/// A verdict on the position of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SurfaceVerdict {
    /// Both miss.
    BothMiss,
    /// Both hit, this many voxels apart along the ray.
    Off(f64),
    /// Only one hits, or they hit different surfaces, and the interpolant comes within the
    /// permitted noise of a double root there. Such cases are to be listed and counted.
    NearDouble,
    /// The answer misses a surface.
    Missed,
    /// The answer hits a surface that does not exist.
    Invented,
}

/// The largest distance in voxels between two answers about the same root.
const SAME_ROOT: f64 = 0.5;

impl<C: Node<Value = f32>> Smooth<'_, C> {
    /// Judges an answer: `t` of the first surface, or a miss. `noise` bounds the error of the
    /// interpolant in the tracer under test, relative to the largest distance of a cell corner from
    /// the iso-value; a smaller dip or graze excuses the answer.
    pub fn judge(&self, ray: &Ray, answer: Option<f64>, noise: f64) -> SurfaceVerdict {
        self.judge_within(ray, answer, noise, SAME_ROOT).0
    }

    /// [`Smooth::judge`] for answers up to `reach` voxels apart that count as the same root. Also
    /// returns the root that the answer was compared with. For distant surfaces, f32 cannot resolve
    /// half a voxel.
    pub fn judge_within(
        &self,
        ray: &Ray,
        answer: Option<f64>,
        noise: f64,
        reach: f64,
    ) -> (SurfaceVerdict, Option<SurfaceHit>) {
        let voxels = ray.dir.as_dvec3().length();
        let mut ray = *ray;
        // The side on which an overlooked dip began, until the ray has left the dip.
        let mut overlooked = None;
        let mut excused = false;
        // Terminates: a ray passes each root once, and `t_min` grows by at least one f32 step each
        // time.
        loop {
            let trace = self.trace(&ray);
            let verdict = judge(&trace, answer, noise, voxels, reach);
            let excuse = |verdict| if excused { SurfaceVerdict::NearDouble } else { verdict };
            let Some(hit) = trace.hit else {
                let found = verdict == SurfaceVerdict::Invented;
                return (if found { verdict } else { excuse(verdict) }, None);
            };
            let back = overlooked.is_some_and(|entering: bool| entering != hit.entering);
            match verdict {
                SurfaceVerdict::Missed if back => overlooked = None,
                SurfaceVerdict::Missed if hit.depth <= noise * hit.largest => {
                    overlooked = Some(hit.entering)
                }
                SurfaceVerdict::Off(_) => return (excuse(verdict), Some(hit)),
                _ => return (verdict, Some(hit)),
            }
            excused = true;
            ray.t_min = (hit.t as f32).max(ray.t_min).next_up();
        }
    }
}

fn judge(
    trace: &SurfaceTrace,
    answer: Option<f64>,
    noise: f64,
    voxels: f64,
    reach: f64,
) -> SurfaceVerdict {
    let at_graze = |t: f64| {
        let near = |t0: f64| (t - t0).abs() * voxels <= reach;
        trace.graze.is_some_and(|graze| graze.value <= noise * graze.largest && near(graze.t))
    };
    match (answer, trace.hit) {
        (None, None) => SurfaceVerdict::BothMiss,
        (None, Some(_)) => SurfaceVerdict::Missed,
        (Some(t), Some(hit)) if (t - hit.t).abs() * voxels <= reach => {
            SurfaceVerdict::Off((t - hit.t).abs() * voxels)
        }
        (Some(t), _) if at_graze(t) => SurfaceVerdict::NearDouble,
        (Some(t), Some(hit)) if t > hit.t => SurfaceVerdict::Missed,
        (Some(_), _) => SurfaceVerdict::Invented,
    }
}
