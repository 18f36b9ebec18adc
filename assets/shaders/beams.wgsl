// One thread a volume and a tile of 8×8 pixels: where its rays can begin.

#import bevy_vdb::bindings::grids
#import bevy_vdb::scene::{view, volumes}
#import bevy_vdb::beam::{beam_of, beam_start}

// Rows of tiles, volume by volume.
@group(2) @binding(9) var<storage, read_write> starts: array<f32>;

@compute @workgroup_size(8, 8, 1)
fn beams(@builtin(global_invocation_id) id: vec3<u32>) {
    let tiles = (view.size + 7u) / 8u;
    if any(id.xy >= tiles) || id.z >= view.volume_count {
        return;
    }
    let volume = volumes[view.volume_first + id.z];
    let beam = beam_of(grids[volume.grid], volume.rays, id.xy, view.size, view.t_near);
    let row = id.z * tiles.y + id.y;
    starts[row * tiles.x + id.x] = beam_start(grids[volume.grid], beam);
}
