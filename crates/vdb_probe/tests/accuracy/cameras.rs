//! Pictures of the matrix of views: what the shader's own rays meet, and how good those rays are.

use glam::{DVec3, IVec3, Vec3};
use vdb_core::pack::PackKind;
use vdb_core::pack::exact::T_ERROR;
use vdb_core::synth::fog as densities;
use vdb_core::view::{CannotShow, GpuRays, LatticeRays};
use vdb_probe::judge::fog::TRANSMITTANCE;
use vdb_probe::judge::{Errors, Judge, Scene, Tally, judged};
use vdb_probe::{ProbeHit, ProbeRay};

use crate::case::Suite;
use crate::grids::{BALL, OFFSETS, Tree, at_offset, offsets};
use crate::report::{Bound, Row};
use crate::views::{self, DISTANCES, FIELDS, SHAPES, SIZES, View};
use crate::{fog, smooth, voxels};

/// Said beside the number of views that `LatticeRays` refuses.
const REFUSED: &str = "of all views too small for f32, refused";

/// Pixels along the edge of a picture in the short form.
fn edge(kind: PackKind) -> f64 {
    match kind {
        PackKind::Surface { .. } => 12.0,
        PackKind::Smooth { .. } | PackKind::Fog => 4.0,
    }
}

/// How far the rays of pictures are from those of the view in f64.
#[derive(Default)]
struct RayErrors {
    /// Of directions, and of origins, over their bound.
    directions: Errors,
    origins: Errors,
    /// Voxels that directions are off at the surface, and the largest that their bound allows.
    at_surface: Errors,
    at_surface_bound: f64,
    /// Of the view in f64, in parts of a half picture.
    views: Errors,
}

impl RayErrors {
    /// `GpuRays::ray_through` tells the bounds.
    fn add(&mut self, lattice: &LatticeRays, distance: f64, x: f64, y: f64, made: &ProbeRay) {
        let small = |a: DVec3, b: DVec3| (a.abs() + b.abs()) / f64::from(1 << 20);
        let truth = lattice.dir_at(x, y);
        let error = (Vec3::from_array(made.dir).as_dvec3() - truth).abs();
        // What is left of the middle's rounding is rounded, too: 2⁻⁴⁸.
        let half_ulp = (1.0 + 1.0 / f64::from(1 << 23)) / f64::from(1 << 24);
        let bound = truth.abs() * half_ulp + small(lattice.dir_x, lattice.dir_y);
        let over = |error: DVec3, bound: DVec3| {
            let part = |axis| if error[axis] == 0.0 { 0.0 } else { error[axis] / bound[axis] };
            [0, 1, 2].map(part).into_iter().fold(0.0, f64::max)
        };
        self.directions.add(over(error, bound));
        let way = (distance + BALL) / truth.length();
        self.at_surface.add(error.length() * way);
        self.at_surface_bound = self.at_surface_bound.max(bound.length() * way);
        let cells = (IVec3::from_array(made.cell) - lattice.eye_cell).as_dvec3();
        let origin = cells + Vec3::from_array(made.frac).as_dvec3();
        let bound = DVec3::splat(1.5 / f64::from(1 << 24)) + small(lattice.eye_x, lattice.eye_y);
        self.origins.add(over((origin - lattice.start_at(x, y)).abs(), bound));
    }
}

fn trees(kind: PackKind) -> Vec<Tree> {
    match kind {
        PackKind::Fog => {
            OFFSETS.iter().map(|(_, at)| densities::sphere(at_offset(*at), BALL, 5.0)).collect()
        }
        _ => offsets().map(|(_, tree)| tree).collect(),
    }
}

/// Rows that share the same pictures.
struct Rows {
    names: Vec<String>,
    tallies: Vec<Tally>,
}

impl Rows {
    fn new(names: impl Iterator<Item = String>) -> Self {
        let names: Vec<String> = names.collect();
        Self { tallies: names.iter().map(|_| Tally::default()).collect(), names }
    }

    fn add(&mut self, row: usize, tally: &Tally) {
        let own = std::mem::take(&mut self.tallies[row]);
        self.tallies[row] = own.merge(tally.clone());
    }
}

pub fn run(suite: &mut Suite) {
    let mut errors: Vec<RayErrors> = DISTANCES.iter().map(|_| RayErrors::default()).collect();
    for (group, kind) in [("voxels", voxels::KIND), ("smooth", smooth::KIND), ("fog", fog::KIND)] {
        if suite.wants(&format!("{group}: camera")) || suite.wants("rays: ") {
            pictures(suite, group, kind, &mut errors);
        }
    }
    if errors[0].views.count() > 0 {
        ray_rows(suite, &errors);
    }
}

/// All pictures of one kind of grid.
fn pictures(suite: &mut Suite, group: &'static str, kind: PackKind, errors: &mut [RayErrors]) {
    let trees = trees(kind);
    let scenes: Vec<Scene> = trees
        .iter()
        .map(|tree| Scene::new(suite.gpu, tree, kind).expect("there is something to see"))
        .collect();
    let judges: Vec<Judge> = scenes.iter().map(|scene| Judge::new(scene, 2.0 * BALL)).collect();
    let times = if kind == voxels::KIND { suite.times } else { suite.some_times() };
    let edge = (edge(kind) * (times as f64).sqrt()).ceil() as u32;
    let named = |what: &str, name: &str| format!("{what} {name}");
    let mut by_distance =
        Rows::new(DISTANCES.iter().map(|(d, _)| named("camera at", &format!("{d} voxels"))));
    let mut by_offset = Rows::new(OFFSETS.iter().map(|(o, _)| named("of these, index offset", o)));
    let mut by_size =
        Rows::new(SIZES.iter().map(|s| named("of these, voxel size", &format!("{s:e}"))));
    let mut by_shape = Rows::new(
        SHAPES.iter().map(|s| named("of these, transform", &format!("{s:?}").to_lowercase())),
    );
    let mut by_field = Rows::new(FIELDS.iter().map(|f| match f {
        0.0 => "of these, orthographic".into(),
        f => format!("of these, field of view {f}°"),
    }));
    let mut refused = 0;
    for (d, o, view) in views::all(suite.seed) {
        let scene = &scenes[o];
        let Some(camera) = view.camera() else { panic!("{view:?} has no inverse") };
        let lattice = match camera.lattice(&scene.grid) {
            Ok(lattice) => lattice,
            // Only what is beyond the stated range may be refused.
            Err(CannotShow::TooSmall) if is_beyond(&view) => {
                refused += 1;
                continue;
            }
            Err(why) => panic!("{view:?} cannot be shown: {why}"),
        };
        let gpu_rays = GpuRays::from(&lattice);
        let (made, hits) = suite.probe(kind).picture(&scene.on_gpu, &gpu_rays, [edge; 2]);
        let judge = |ray: &ProbeRay, hit: &ProbeHit, tally: &mut Tally| {
            let shown = tally.examples.len();
            judges[o].judge(ray, hit, tally);
            if let Some(example) = tally.examples.get_mut(shown) {
                *example = format!("{view:?}: {example}");
            }
        };
        let tally = judged(suite.gpu, &made, &hits, &judge);
        let size = SIZES.iter().position(|size| *size == view.size);
        let shape = SHAPES.iter().position(|shape| *shape == view.shape);
        let field = FIELDS.iter().position(|field| *field == view.field);
        by_distance.add(d, &tally);
        by_offset.add(o, &tally);
        by_size.add(size.unwrap_or(0), &tally);
        by_shape.add(shape.unwrap_or(0), &tally);
        by_field.add(field.unwrap_or(0), &tally);
        // A few of a picture's rays will do.
        let step = (made.len() / 64).max(1);
        for (i, ray) in made.iter().enumerate().step_by(step) {
            let ndc = |pixel: u32| 2.0 * (f64::from(pixel) + 0.5) / f64::from(edge) - 1.0;
            let (x, y) = (ndc(i as u32 % edge), -ndc(i as u32 / edge));
            errors[d].add(&lattice, view.distance, x, y, ray);
            errors[d].views.add(camera.off(&scene.grid, &lattice, x, y));
        }
    }
    // What the views have in common is of interest once.
    let parts = if kind == voxels::KIND { 5 } else { 1 };
    let rows = [by_distance, by_offset, by_size, by_shape, by_field];
    for (part, rows) in rows.into_iter().take(parts).enumerate() {
        for (row, (name, tally)) in rows.names.iter().zip(&rows.tallies).enumerate() {
            let refused = if (part, row) == (0, 0) { refused } else { 0 };
            add_rows(suite, group, kind, name, tally, part > 0, refused);
        }
    }
}

/// Whether a unit of the view's depth is more than 2³⁰ voxels.
fn is_beyond(view: &View) -> bool {
    let widest = (view.field.to_radians() / 2.0).tan().max(1.0) * 1.5;
    widest / (view.size * view.shape.least()) > f64::from(1 << 30)
}

fn add_rows(
    suite: &mut Suite,
    group: &'static str,
    kind: PackKind,
    name: &str,
    tally: &Tally,
    again: bool,
    refused: u64,
) {
    match kind {
        PackKind::Smooth { .. } => smooth::add_rows(suite, group, name, tally, again),
        PackKind::Surface { .. } => {
            let bound = Bound::Max(f64::from(T_ERROR));
            let row = Row::new(group, name, "of t", bound, tally).and(refused, REFUSED);
            suite.report.add(Row { again, ..row }, tally);
        }
        PackKind::Fog => {
            let row = fog::row(group, name, TRANSMITTANCE, tally);
            suite.report.add(Row { again, ..row }, tally);
        }
    }
}

/// How good the rays are that pictures are made of.
fn ray_rows(suite: &mut Suite, errors: &[RayErrors]) {
    let none = Tally::default();
    let mut add = |case: String, unit, bound, errors: &Errors| {
        suite.report.add(Row::of_errors("rays", case, unit, bound, errors), &none);
    };
    for ((distance, _), errors) in DISTANCES.iter().zip(errors) {
        let camera = format!("camera at {distance} voxels");
        add(format!("{camera}, direction"), "of its bound", Bound::Max(1.0), &errors.directions);
        add(format!("{camera}, origin"), "of its bound", Bound::Max(1.0), &errors.origins);
        let bound = Bound::Max(errors.at_surface_bound);
        add(format!("{camera}, off at the surface"), "voxels", bound, &errors.at_surface);
        add(format!("{camera}, view in f64"), "half pictures", Bound::Max(1e-6), &errors.views);
    }
}
