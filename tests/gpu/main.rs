//! The shaders against the f64 reference tracer, ray by ray.

mod fog;
mod harness;
mod smooth;
mod surface;
mod validity;
