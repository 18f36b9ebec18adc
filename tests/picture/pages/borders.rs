//! What rays meet between pages of different levels.

use vdb_core::tree::Vdb543;

use super::*;

/// A plain whose coarser levels are 3 voxels higher.
struct Stepped<F>([FunctionSource<F>; 2]);

impl<F: Fn(DVec3) -> f64 + Sync> PageSource for Stepped<F> {
    fn name(&self) -> &str {
        "step"
    }

    fn kind(&self) -> PackKind {
        self.0[0].kind()
    }

    fn world_from_index(&self) -> DAffine3 {
        DAffine3::IDENTITY
    }

    fn levels(&self) -> u32 {
        self.0[0].levels()
    }

    fn pages(&self, level: u32, edge: u32, kind: PackKind) -> Result<Vec<IVec3>, vdb_core::Error> {
        self.0[level.min(1) as usize].pages(level, edge, kind)
    }

    fn samples(&self, level: u32, bounds: CoordBox) -> Result<Vdb543<f32>, vdb_core::Error> {
        self.0[level.min(1) as usize].samples(level, bounds)
    }
}

/// A ray that passes above the surface of a page and below that of the next one hits the border.
#[gpu_test]
fn rays_do_not_pass_between_levels() {
    let plain = |height: f64| {
        let bounds = [DVec3::new(-150.0, -60.0, -700.0), DVec3::new(150.0, 60.0, 100.0)];
        FunctionSource::new("step", DAffine3::IDENTITY, bounds, move |at| at.y - height)
    };
    let options = PageOptions { edge: 128, smooth: true, ..PageOptions::default() };
    let index = cook_source("step", &Stepped([plain(-10.3), plain(-7.3)]), &options);
    // Half-way between both, looking along the plain through a long lens.
    let from = Vec3::new(3.0, -8.8, 60.0);
    let mut land = Land::new(Transform::from_translation(from));
    let lens = PerspectiveProjection { fov: 0.05, ..default() };
    land.stage.world().entity_mut(land.camera).insert(Projection::Perspective(lens));
    let terrain = land.spawn(&index, 16.0);
    land.complete(terrain);
    let depths = land.picture(VdbRenderMode::Depth, "step");
    // The first page of the next level.
    let border = 60.0 + 256.0;
    let mut between = 0;
    for y in 0..SIZE.y {
        let upwards = (0.5 - (f64::from(y) + 0.5) / f64::from(SIZE.y)) * 2.0 * 0.025_f64.tan();
        let t = 0.1 / f64::from(depths.at(SIZE.x / 2, y).x);
        let entry = f64::from(from.y) + upwards * border;
        // In the cells that have the surface.
        if entry > -7.9 && entry < -7.4 {
            assert!((t - border).abs() < 1.0, "row {y} enters at {entry} and hits at {t}");
            between += 1;
        } else if entry < -7.4 {
            assert!(t.is_finite(), "row {y} enters at {entry} and hits nothing");
        }
    }
    assert!(between > 1, "{between} rows");
}
