//! The reference tracer against closed forms, brute force and OpenVDB's own intersectors.

mod blocky;
mod brute;
mod emission;
mod fog;
mod judge;
mod paths;
mod peers;
mod picture;
mod radiance;
mod smooth;
mod synth;
