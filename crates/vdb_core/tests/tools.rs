//! Tools that make volumes and change them, against brute force in f64 and closed forms.

#[path = "tools/csg.rs"]
mod csg;
#[path = "tools/from_mesh.rs"]
mod from_mesh;
#[path = "tools/shapes.rs"]
mod shapes;
#[path = "tools/to_mesh.rs"]
mod to_mesh;
