//! Tools that make volumes and change them, against brute force in f64 and closed forms.

#[path = "tools/crop.rs"]
mod crop;
#[path = "tools/csg.rs"]
mod csg;
#[path = "tools/fog.rs"]
mod fog;
#[path = "tools/from_mesh.rs"]
mod from_mesh;
#[path = "tools/offset.rs"]
mod offset;
#[path = "tools/points.rs"]
mod points;
#[path = "tools/resample.rs"]
mod resample;
#[path = "tools/shapes.rs"]
mod shapes;
#[path = "tools/smooth.rs"]
mod smooth;
#[path = "tools/to_mesh.rs"]
mod to_mesh;
mod trees;
