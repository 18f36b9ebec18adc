// The part of a shadow map that may show a volume.
#define_import_path bevy_vdb::shadow_maps::quad

#import bevy_vdb::view::scene::{view, volumes}

// Texels per edge of a tile: `TILE` in `src/render/view/tiles.rs`.
const TILE: f32 = 8.0;

// A corner, of four, of the tiles that may show a volume, in clip space.
fn corner_position(volume: u32, corner: u32) -> vec4<f32> {
    let tiles_first = volumes[volume].tiles_first;
    let tiles_last = volumes[volume].tiles_last;
    let is_last = vec2((corner & 1u) != 0u, (corner & 2u) != 0u);
    let tile = select(
        vec2(tiles_first & 0xffffu, tiles_first >> 16u),
        vec2(tiles_last & 0xffffu, tiles_last >> 16u) + 1u,
        is_last,
    );
    let at = TILE * vec2<f32>(tile) / vec2<f32>(view.size);
    return vec4(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.5, 1.0);
}

// The depth at t of a light's rays. In front of the near plane, it is that of the near plane.
fn depth_at(t: f32) -> f32 {
    let m = view.depth_from_t;
    return saturate((m.x * t + m.y) / (m.z * t + m.w));
}
