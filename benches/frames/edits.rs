//! What voxels that change each frame do to frames.

use std::time::Instant;

use bevy::math::{DVec3, Vec3A};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::{fog, level_set};
use bevy_vdb::vdb_core::tree::{CoordBox, Vdb543};

use crate::studio::Studio;
use crate::{Args, CELLS, cells, print_heading, summary};

/// Voxels from the middle of the large ball to its surface, and of the small one: 100,000 voxels.
const RADIUS: f32 = 300.0;
const SMALL: f32 = 28.8;
/// Of fog, all of whose inside is active: half of the large ball's; and how soft its rim is.
const FOG_RADIUS: f32 = 150.0;
const FOG_RIM: f32 = 50.0;
const BAND: f32 = level_set::HALF_WIDTH;

/// A small ball that runs around in a large one. A ball that is no longer where it was is taken away again: the large one is put back there.
pub struct Running {
    grid: Handle<VdbGrid>,
    kind: PackKind,
    angle: f32,
}

pub fn run(args: &Args) -> Result<(), String> {
    let mut studio = Studio::new(args.size)?;
    print_heading(&studio, "Edits", args.size);
    println!("| shown as |{CELLS} VdbGrid::edit, median, ms | 99 % |");
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let large = level_set::sphere(DVec3::ZERO, RADIUS.into());
    let kinds = [
        ("voxels", PackKind::Surface { iso: 0.0 }, large.clone()),
        ("a smooth surface", PackKind::Smooth { iso: 0.0 }, large),
        ("fog", PackKind::Fog, large_fog()),
    ];
    let volume = studio.app.world_mut().spawn_empty().id();
    for (name, kind, tree) in kinds {
        let mut ball = Running::new(&mut studio, volume, kind, tree)?;
        let (mut with, mut without, mut edits) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..args.rounds {
            without.extend(studio.frames(args.frames));
            let mut wrong = Ok(());
            with.extend(studio.frames_after(args.frames, |studio| {
                let start = Instant::now();
                wrong = wrong.clone().and_then(|()| ball.run(studio));
                edits.push(start.elapsed().as_secs_f64() * 1e3);
            }));
            wrong?;
        }
        let [median, _, slow] = summary(&mut edits);
        let cells = cells(&mut with, &mut without);
        println!("| {name} |{cells} {median:.2} | {slow:.2} |");
    }
    Ok(())
}

/// The large ball, of fog.
pub fn large_fog() -> Vdb543<f32> {
    fog::sphere(DVec3::ZERO, FOG_RADIUS.into(), FOG_RIM.into())
}

impl Running {
    /// Shows the large ball as the volume of an entity.
    pub fn new(
        studio: &mut Studio,
        volume: Entity,
        kind: PackKind,
        tree: Vdb543<f32>,
    ) -> Result<Self, String> {
        let radius = if kind == PackKind::Fog { FOG_RADIUS } else { RADIUS };
        let grid = studio.grid(tree, kind, f64::from(1.0 / radius))?;
        let look = VdbMaterial { density_scale: 4.0, ..default() };
        studio.app.world_mut().entity_mut(volume).insert((VdbVolume(grid.clone()), look));
        studio.settle(1)?;
        let mut ball = Self { grid, kind, angle: 0.0 };
        // The first ones pack the grid for changes.
        (0..10).try_for_each(|_| ball.run(studio))?;
        Ok(ball)
    }

    /// Half sunk into the surface of the large ball, half a turn around it in some hundred frames.
    fn middle(&self) -> Vec3A {
        let radius = if self.kind == PackKind::Fog { FOG_RADIUS - FOG_RIM } else { RADIUS };
        radius * Vec3A::new(self.angle.cos(), 0.2 * (3.0 * self.angle).sin(), self.angle.sin())
    }

    /// A frame's way.
    pub fn run(&mut self, studio: &mut Studio) -> Result<(), String> {
        let before = self.middle();
        self.angle += 0.02;
        let (now, kind) = (self.middle(), self.kind);
        let mut grids = studio.app.world_mut().resource_mut::<Assets<VdbGrid>>();
        let mut grid = grids.get_mut(&self.grid).ok_or("the grid is gone")?;
        let around = |middle: Vec3A| {
            let reach = SMALL + BAND;
            CoordBox {
                min: (middle - reach).floor().as_ivec3(),
                max: (middle + reach).ceil().as_ivec3(),
            }
        };
        let edited = grid.edit(|voxels| {
            voxels.update(around(before), |ijk, _| voxel(kind, ijk, None));
            voxels.update(around(now), |ijk, _| voxel(kind, ijk, Some(now)));
        });
        edited.map(drop).map_err(|error| error.to_string())
    }
}

/// Of the large ball, and of the small one where there is one.
fn voxel(kind: PackKind, ijk: IVec3, small: Option<Vec3A>) -> VdbVoxel {
    let at = ijk.as_vec3a();
    let small = small.map_or(f32::INFINITY, |middle| at.distance(middle) - SMALL);
    if kind == PackKind::Fog {
        let value = ((FOG_RADIUS - at.length()) / FOG_RIM).max(-small).clamp(0.0, 1.0);
        return VdbVoxel { value, active: value > 0.0 };
    }
    let value = (at.length() - RADIUS).min(small).clamp(-BAND, BAND);
    VdbVoxel { value, active: value.abs() < BAND }
}
