//! Bevy's own fog, the rival of ours: a `FogVolume` whose density is a dense texture, timed on views
//! that `vdb_bench` measures too. `scripts/bench-fog` builds and runs it; README.md beside this file's
//! folder says what is fair about it.

mod args;
mod scene;
mod texture;
mod timer;

use std::path::Path;
use std::process::ExitCode;

use args::Args;
use bevy::math::{DVec3, UVec2};
use scene::{Scene, View};
use texture::Density;

/// Milliseconds of work before what counts: a GPU that was idle is slow at first.
const WARM_UP: f64 = 500.0;

const HEADER: &str = "model,kind,variant,rays,width,height,dist,median_ms,min_ms,max_ms,\
spread_percent,runs,mrays_per_s,hit_percent,bytes,bytes_per_voxel,pack_ms,adapter,error_mean,\
error_p99,error_max";

fn main() -> ExitCode {
    vdb_probe::options::run("bevy_fog", Args::parse(), run)
}

fn run(args: &Args) -> Result<(), String> {
    let mut scene = Scene::new()?;
    println!("{HEADER}");
    for file in &args.files {
        for &format in &args.formats {
            let density = Density::read(file, format)
                .map_err(|error| format!("{}: {error}", file.display()))?;
            scene.show(&density);
            for &size in &args.sizes {
                for &dist in &args.dists {
                    for &steps in &args.steps {
                        measure(args, &mut scene, &density, View { size, dist, steps })?;
                    }
                }
            }
        }
    }
    Ok(())
}

/// One line of the table.
fn measure(args: &Args, scene: &mut Scene, density: &Density, view: View) -> Result<(), String> {
    scene.look(density, view)?;
    let mut warm = 0.0;
    while warm < WARM_UP {
        warm += scene.frame()?;
    }
    let mut times = (0..args.runs).map(|_| scene.frame()).collect::<Result<Vec<_>, _>>()?;
    times.sort_by(f64::total_cmp);
    let part = |quarters: usize| times[(times.len() - 1) * quarters / 4];
    let (median, spread) = (part(2), 100.0 * (part(3) - part(1)) / part(2));

    let picture = scene.picture()?;
    let View { size: UVec2 { x, y }, dist, steps } = view;
    let name = format!("{}_{x}x{y}_{dist:.1}.f32", density.name);
    let errors = match &args.beside {
        Some(dir) => errors(&picture, &dir.join(&name))?,
        None => ",,".into(),
    };
    if let Some(dir) = &args.dump {
        // Several variants of a view must not overwrite each other.
        let path = dir.join(format!("{}_{steps}_{name}", density.format.name()));
        std::fs::create_dir_all(dir)
            .and_then(|()| std::fs::write(&path, bytemuck::cast_slice(&picture)))
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    let hits = picture.iter().filter(|&&value| value < 0.999).count();
    if hits == 0 {
        return Err(format!("{}: Bevy drew no fog", density.name));
    }
    let pixels = picture.len() as f64;
    println!(
        "{},fog,{}+{steps},primary,{x},{y},{dist:.2},{median:.4},{:.4},{:.4},{spread:.1},{},{:.3},\
         {:.1},{},{:.3},{:.1},\"{}\",{errors}",
        density.name,
        density.format.name(),
        part(0),
        part(4),
        args.runs,
        pixels / median / 1e3,
        100.0 * hits as f64 / pixels,
        density.texels.len(),
        density.texels.len() as f64 / density.active_voxels as f64,
        density.fill_ms,
        scene.adapter(),
    );
    Ok(())
}

/// How far a picture is from the transmittance that `vdb_bench --dump` wrote: on average, at the
/// 99th percentile of the pixels that have fog in either, and at most.
fn errors(picture: &[f32], path: &Path) -> Result<String, String> {
    let at = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let bytes = std::fs::read(path).map_err(|error| at(&error))?;
    if bytes.len() != size_of_val(picture) {
        return Err(at(&"is a picture of another size"));
    }
    let exact: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
    let pairs = picture.iter().zip(&exact).filter(|(own, exact)| own.min(**exact) < 0.999);
    let mut errors: Vec<f32> = pairs.map(|(own, exact)| (own - exact).abs()).collect();
    errors.sort_by(f32::total_cmp);
    let most = errors.last().ok_or_else(|| at(&"has no fog"))?;
    let mean = errors.iter().map(|&error| f64::from(error)).sum::<f64>() / errors.len() as f64;
    Ok(format!("{mean:.5},{:.5},{most:.5}", errors[(errors.len() - 1) * 99 / 100]))
}

/// The direction from the middle to the eye, as all peers have it.
fn back() -> DVec3 {
    DVec3::new(0.45, 0.35, 0.82).normalize()
}
