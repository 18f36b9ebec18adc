// The optical depth of all fogs on the way to a sun, along the rays of `light_cache/columns.wgsl`: for each
// column, from the beginning of its run, or from the sun if the ray enters the planes in this run.

#import bevy_vdb::light_cache::columns::{RUN, column_at, depth_index, depths, is_in_plane, job, ray_count}
#import bevy_vdb::light_cache::columns::{run_index, shift_at}
#import bevy_vdb::trace::occlusion::fog_depth_to_light
#import bevy_vdb::trace::segment::Point
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::traversal::rays::quantise_frac
#import bevy_vdb::view::scene::{view, volumes}

// The point of a column in a plane.
fn column_point(column: vec2<i32>, plane: u32) -> Point {
    let volume = view.volume_first + job.volume;
    let across = vec2<f32>(column) - 1.0 - shift_at(plane).rest;
    let along = f32(select(plane, job.planes - 1u - plane, job.is_reversed != 0u));
    var position = vec3(along, across);
    if job.major == 1u {
        position = position.zxy;
    } else if job.major == 2u {
        position = position.yzx;
    }
    let cells = position / volumes[volume].light_scale;
    let whole = floor(cells);
    let from_eye = job.origin + cells.x * job.axis_x + cells.y * job.axis_y + cells.z * job.axis_z;
    let cell = volumes[volume].light_origin + vec3<i32>(whole);
    return Point(vec2(0.0), 0.0, from_eye, volume, cell, quantise_frac(cells - whole));
}

@compute @workgroup_size(16, 4, 1)
fn sum_runs(@builtin(global_invocation_id) id: vec3<u32>) {
    let ray = id.xy;
    if any(ray >= ray_count()) {
        return;
    }
    var depth = 0.0;
    for (var i = 0u; i < RUN; i++) {
        let plane = id.z * RUN + i;
        let column = column_at(ray, plane);
        if plane < job.planes && is_in_plane(column) {
            let is_first = plane == 0u || !is_in_plane(column_at(ray, plane - 1u));
            let distance = select(job.segment, FAR, is_first);
            depth += fog_depth_to_light(column_point(column, plane), job.light, distance, job.step);
            depths[depth_index(plane, vec2<u32>(column))] = depth;
        }
    }
    depths[run_index(ray, id.z)] = depth;
}
