//! What grids that come, go or are replaced do to frames.

use std::time::Instant;

use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::pack::PackKind;
use bevy_vdb::vdb_core::synth::{fog, level_set};
use bevy_vdb::vdb_core::tree::Vdb543;

use crate::studio::Studio;
use crate::{Args, CELLS, cells, print_heading, summary};

/// Radii in voxels: of the large surfaces, of the small one, and of the fog that is replaced, rim included.
const LARGE: f64 = 200.0;
const SMALL: f64 = 24.0;
const REPLACED: f64 = 62.0;
/// The number of large surfaces.
const COUNT: usize = 10;
/// The number of frames for which a small surface stays.
const STAY: usize = 5;
/// The number of fogs that are shown in turn.
const PHASES: usize = 8;

pub fn run(args: &Args) -> Result<(), String> {
    comings(args)?;
    replacements(args)
}

/// A small grid that comes and goes beside large ones: surfaces, whose light needs no cache.
fn comings(args: &Args) -> Result<(), String> {
    let mut studio = Studio::new(args.size)?;
    print_heading(&studio, "A small grid that comes and goes", args.size);
    let kind = PackKind::Surface { iso: 0.0 };
    let large = level_set::sphere(DVec3::ZERO, LARGE);
    for i in 0..COUNT {
        let grid = studio.grid(large.clone(), kind, 0.2 / LARGE)?;
        let angle = std::f32::consts::TAU * i as f32 / COUNT as f32;
        let place = Transform::from_translation(Vec3::new(angle.cos(), 0.0, angle.sin()));
        studio.app.world_mut().spawn((VdbVolume(grid), place));
    }
    let small = level_set::sphere(DVec3::ZERO, SMALL);
    let grid = studio.grid(small.clone(), kind, 0.2 / SMALL)?;
    let mut entity = studio.app.world_mut().spawn(VdbVolume(grid)).id();
    studio.settle(COUNT as u64 + 1)?;
    let [large, count] = [&large, &small].map(Vdb543::active_voxel_count);
    println!("{COUNT} grids of {large} voxels, and one of {count}\n");
    println!("| the small one is |{CELLS}\n|---|---|---|---|---|---|---|---|---|");
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for _ in 0..args.rounds {
        without.extend(studio.frames(args.frames));
        // A new grid each time: one that was there before may still be resident.
        let new = |_| studio.grid(small.clone(), kind, 0.2 / SMALL);
        let mut new = (0..args.frames).step_by(STAY).map(new).collect::<Result<Vec<_>, _>>()?;
        let mut frame = 0;
        with.extend(studio.frames_after(args.frames, |studio| {
            if frame % STAY == 0
                && let Some(grid) = new.pop()
            {
                let world = studio.app.world_mut();
                world.despawn(entity);
                entity = world.spawn(VdbVolume(grid)).id();
            }
            frame += 1;
        }));
    }
    let longest = |times: &[f64]| times.iter().copied().fold(0.0, f64::max);
    let [most, usual] = [longest(&with), longest(&without)];
    println!("| another one every {STAY} frames |{}", cells(&mut with, &mut without));
    println!("\nThe longest frame: {most:.2} ms, and {usual:.2} ms without");
    Ok(())
}

/// A grid that is replaced in each frame, as a simulation does it.
fn replacements(args: &Args) -> Result<(), String> {
    let mut studio = Studio::new(args.size)?;
    print_heading(&studio, "A grid replaced each frame", args.size);
    // Of the same size but each with other voxels, as the next step of a simulation.
    let trees: Vec<_> = (0..PHASES)
        .map(|i| {
            let shift = DVec3::splat(i as f64);
            fog::sphere(shift, REPLACED, REPLACED / 3.0)
        })
        .collect();
    let handle = studio.grid(trees[0].clone(), PackKind::Fog, 1.0 / REPLACED)?;
    let look = VdbMaterial { density_scale: 4.0, ..default() };
    studio.app.world_mut().spawn((VdbVolume(handle.clone()), look));
    studio.settle(1)?;
    println!("A grid of {} voxels\n", trees[0].active_voxel_count());
    println!("| shown |{CELLS} VdbGrid::new, median, ms | 99 % |");
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let (mut with, mut without, mut packing) = (Vec::new(), Vec::new(), Vec::new());
    for round in 0..args.rounds {
        without.extend(studio.frames(args.frames));
        // An app that simulates makes a tree each frame, which does not count here.
        let next: Vec<_> = (0..args.frames).map(|i| trees[(i + round) % PHASES].clone()).collect();
        let mut next = next.into_iter();
        let mut failed = None;
        with.extend(studio.frames_after(args.frames, |studio| {
            let Some(tree) = next.next() else { return };
            let start = Instant::now();
            let world_from_index = DAffine3::from_scale(DVec3::splat(1.0 / REPLACED));
            let grid = VdbGrid::new("model", tree, world_from_index, PackKind::Fog);
            packing.push(start.elapsed().as_secs_f64() * 1e3);
            let mut grids = studio.app.world_mut().resource_mut::<Assets<VdbGrid>>();
            let replaced = grid
                .map_err(|error| error.to_string())
                .and_then(|grid| grids.insert(&handle, grid).map_err(|error| error.to_string()));
            failed = replaced.err().or(failed.take());
        }));
        if let Some(error) = failed {
            return Err(error);
        }
    }
    let [median, _, slow] = summary(&mut packing);
    println!("| as fog |{} {median:.2} | {slow:.2} |", cells(&mut with, &mut without));
    Ok(())
}
