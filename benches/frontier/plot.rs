//! The table and the plot of a scene.

use std::fmt::Write as _;

use bevy_vdb::VdbQuality;
use vdb_probe::{INK, PALE, Svg};

use crate::Row;

pub fn csv(scene: &str, rows: &[Row]) -> String {
    let mut text = String::from(
        "scene,preset,traversal,shadows,shadow_range,reflections,reflection_range,fog_step,\
         fog_light_step,fog_shadow_step,fog_light_error,fog_slabs,detail,resolution,ms,ms_trace,ms_upscale,ms_composite,radiance_error,visible_pixels,flip_mean,\
         hits_wrong,depth_p99_voxels,normal_mean_degrees,on_front\n",
    );
    for row in rows {
        let (q, e) = (&row.quality, &row.errors);
        let _ = writeln!(
            text,
            "\"{scene}\",{},{:?},{},{},{},{},{},{},{},{},{},{},{},{:.4},{:.4},{:.4},{:.4},{:.3e},{:.3e},{},{:.3e},{:.3e},{:.3e},{}",
            row.name.unwrap_or(""),
            q.traversal,
            q.shadows,
            q.shadow_range,
            q.reflections,
            q.reflection_range,
            q.fog_step,
            q.fog_light_step,
            q.fog_shadow_step,
            q.fog_light_error,
            q.fog_slabs,
            q.detail,
            q.resolution,
            row.ms(),
            row.passes[0],
            row.passes[1],
            row.passes[2],
            e.radiance,
            e.visible,
            row.flip.map_or(String::new(), |flip| format!("{flip:.3e}")),
            e.hits_wrong,
            e.depth,
            e.normal,
            row.on_front
        );
    }
    text
}

/// What a setting has otherwise than `HIGH`.
fn label(q: &VdbQuality) -> String {
    let high = VdbQuality::HIGH;
    let mut parts = Vec::new();
    let mut part = |differs: bool, text: String| {
        if differs {
            parts.push(text);
        }
    };
    part(q.traversal != high.traversal, format!("{:?}", q.traversal));
    part(!q.shadows, "no shadows".into());
    part(q.shadow_range != high.shadow_range, format!("shadow_range {}", q.shadow_range));
    part(q.reflections != high.reflections, format!("reflections {}", q.reflections));
    part(q.reflection_range != high.reflection_range, format!("range {}", q.reflection_range));
    part(q.fog_step != high.fog_step, format!("fog_step {}", q.fog_step));
    part(q.fog_light_step != high.fog_light_step, format!("light_step {}", q.fog_light_step));
    part(q.fog_shadow_step != high.fog_shadow_step, format!("shadow_step {}", q.fog_shadow_step));
    part(q.fog_light_error != high.fog_light_error, format!("light_error {}", q.fog_light_error));
    part(q.fog_slabs != high.fog_slabs, format!("slabs {}", q.fog_slabs));
    part(q.detail != high.detail, format!("detail {}", q.detail));
    part(q.resolution != high.resolution, format!("resolution {}", q.resolution));
    if parts.is_empty() { "as HIGH".into() } else { parts.join(", ") }
}

/// The presets and the front, as a table.
pub fn summary(rows: &[Row]) -> String {
    let mut text = String::from(
        "| setting | ms | radiance off by | pixels that show it | FLIP | hits wrong | depth, voxels | normals |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    let mut shown: Vec<&Row> = rows.iter().filter(|r| r.on_front || r.name.is_some()).collect();
    shown.sort_by(|a, b| b.ms().total_cmp(&a.ms()));
    for row in shown {
        let e = &row.errors;
        let name = match row.name {
            Some(name) => format!(
                "**{}**{}",
                name.to_uppercase(),
                if row.on_front { "" } else { " (not on the front)" }
            ),
            None => label(&row.quality),
        };
        let _ = writeln!(
            text,
            "| {name} | {:.3} | {:.2} % | {:.2} % | {:.4} | {:.2} % | {:.2} | {:.1}° |",
            row.ms(),
            100.0 * e.radiance,
            100.0 * e.visible,
            row.flip.unwrap_or(0.0),
            100.0 * e.hits_wrong,
            e.depth,
            e.normal
        );
    }
    text
}

const SIZE: (f64, f64) = (640.0, 400.0);
const EDGE: f64 = 56.0;
/// Errors below are drawn there: 16-bit floats show no less.
const LEAST: f64 = 1e-4;

pub fn svg(scene: &str, rows: &[Row]) -> String {
    let times = rows.iter().map(|row| row.ms().max(1e-4).log10());
    let (low, high) = times.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
    let (low, high) = (low - 0.05, high + 0.25);
    let errors = |row: &Row| row.errors.radiance.max(LEAST).log10();
    let top = rows.iter().map(errors).fold(LEAST.log10() + 1.0, f64::max) + 0.1;
    let x = |ms: f64| EDGE + (ms.max(1e-4).log10() - low) / (high - low) * (SIZE.0 - EDGE - 16.0);
    let y = |error: f64| {
        let at = (error.max(LEAST).log10() - LEAST.log10()) / (top - LEAST.log10());
        SIZE.1 - 40.0 - at * (SIZE.1 - 76.0)
    };
    let mut svg = Svg::new(SIZE.0, SIZE.1);
    svg.text(EDGE, 20.0, "start", r#"font-size="13" font-weight="bold""#, scene);
    svg.text(SIZE.0 - 16.0, SIZE.1 - 8.0, "end", "", "milliseconds of all passes");
    svg.text(8.0, 34.0, "start", "", "radiance off by");
    for power in -4..=4 {
        for digit in [1.0, 2.0, 5.0] {
            let (ms, error) = (digit * 10_f64.powi(power), 10_f64.powi(power));
            if (low..high).contains(&ms.log10()) {
                svg.line((x(ms), 40.0), (x(ms), SIZE.1 - 40.0), PALE, 1.0);
                svg.text(x(ms), SIZE.1 - 24.0, "middle", "", &format!("{ms}"));
            }
            if digit == 1.0 && (LEAST.log10() - 1e-9..top).contains(&error.log10()) {
                svg.line((EDGE, y(error)), (SIZE.0 - 16.0, y(error)), PALE, 1.0);
                svg.text(EDGE - 6.0, y(error) + 3.0, "end", "", &format!("{} %", 100.0 * error));
            }
        }
    }
    let mut front: Vec<&Row> = rows.iter().filter(|row| row.on_front).collect();
    front.sort_by(|a, b| a.ms().total_cmp(&b.ms()));
    for pair in front.windows(2) {
        let [a, b] = [pair[0], pair[1]].map(|row| (x(row.ms()), y(row.errors.radiance)));
        svg.line(a, (b.0, a.1), INK, 1.0);
        svg.line((b.0, a.1), b, INK, 1.0);
    }
    for row in rows {
        let color = if row.on_front { INK } else { "#9fb3c8" };
        svg.dot(x(row.ms()), y(row.errors.radiance), color);
    }
    for row in rows {
        let Some(name) = row.name else { continue };
        let (x, y) = (x(row.ms()), y(row.errors.radiance));
        svg.dot(x, y, "#d64545");
        svg.text(x + 6.0, y - 4.0, "start", r#"font-weight="bold""#, &name.to_uppercase());
    }
    svg.finish()
}
