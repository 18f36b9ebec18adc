// The vertex stage of all volumes in a shadow map: each is an instance, a quad over the texels that may show it.

#import bevy_vdb::traversal::rays::ndc_at
#import bevy_vdb::view::scene::{view, volumes}

// Texels per edge of a tile: `TILE` in `src/render/gpu/dispatch.rs`.
const TILE: f32 = 8.0;

struct Quad {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) volume: u32,
}

@vertex
fn quad(@builtin(vertex_index) corner: u32, @builtin(instance_index) instance: u32) -> Quad {
    let volume = view.volume_first + instance;
    let tiles_first = volumes[volume].tiles_first;
    let tiles_last = volumes[volume].tiles_last;
    let is_last = vec2((corner & 1u) != 0u, (corner & 2u) != 0u);
    let tile = select(
        vec2(tiles_first & 0xffffu, tiles_first >> 16u),
        vec2(tiles_last & 0xffffu, tiles_last >> 16u) + 1u,
        is_last,
    );
    return Quad(vec4(ndc_at(TILE * vec2<f32>(tile), view.size), 0.5, 1.0), volume);
}
