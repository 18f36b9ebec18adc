//! The shaders against the f64 reference tracer, ray by ray.

mod fog;
mod smooth;
mod surface;
mod validity;

use vdb_core::pack::PackedGrid;
use vdb_probe::{Gpu, GpuGrid, Probe, ProbeHit, ProbeKind, ProbeRay};

fn probe(gpu: &Gpu, kind: ProbeKind, grid: &PackedGrid, rays: &[ProbeRay]) -> Vec<ProbeHit> {
    Probe::new(gpu, kind).send(&GpuGrid::new(gpu, grid), 0.0, rays)
}

/// How many rays a test walks: `count`, times what `BEVY_VDB_RAYS` says, for a GPU with time.
fn ray_count(count: usize) -> usize {
    let times = std::env::var("BEVY_VDB_RAYS").ok();
    count * times.map_or(1, |times| times.parse().expect("BEVY_VDB_RAYS is a number"))
}
