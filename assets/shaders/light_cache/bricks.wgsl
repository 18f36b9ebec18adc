// Layout of the light cache: optical depths towards lights, at points of a coarse lattice, in bricks of
// 9×9×9 samples that share their faces with their neighbours, so that the sampler of textures can
// interpolate. `src/render/light_cache/atlas.rs` allocates bricks in rows of 64.
#define_import_path bevy_vdb::light_cache::bricks

// Intervals between samples along an edge of a brick.
const LOG_BRICK_INTERVALS: u32 = 3u;
const BRICK_INTERVALS: u32 = 8u;
const BRICK_SAMPLES: u32 = 9u;
// Texels of a brick along x: an even number, because two samples share a word when they are written.
const BRICK_WIDTH: u32 = 10u;
// Bricks in a row, and rows in a layer of the texture.
const LOG_ROW_BRICKS: u32 = 6u;
const ROW_BRICKS: u32 = 64u;
const LOG_LAYER_ROWS: u32 = 6u;
const LAYER_ROWS: u32 = 64u;
// Words of a line of texels.
const LINE_WORDS: u32 = 320u;   // ROW_BRICKS * BRICK_WIDTH / 2

// In place of an optical depth, for a sample beside which there is no fog.
const NO_FOG: f32 = -1.0;

// Bricks that a light occupies: whole rows.
fn bricks_per_light(bricks: vec3<u32>) -> u32 {
    let count = bricks.x * bricks.y * bricks.z;
    return (count + ROW_BRICKS - 1u) & ~(ROW_BRICKS - 1u);
}

// The first texel of a brick in the atlas.
fn brick_texel(brick: u32) -> vec3<u32> {
    let row = brick >> LOG_ROW_BRICKS;
    let in_layer = vec2(brick & (ROW_BRICKS - 1u), row & (LAYER_ROWS - 1u));
    return vec3(in_layer * vec2(BRICK_WIDTH, BRICK_SAMPLES), (row >> LOG_LAYER_ROWS) * BRICK_SAMPLES);
}

// The word of a sample in the buffer that is copied to the atlas, which has the rows of one lattice, `rows`
// of them from `first_row`. The rows in a layer of the atlas are copied together: 9 planes of 9 lines of 640
// texels for each row. `brick` is relative to the first brick of the lattice; `texel` is in the brick.
fn staging_word(first_row: u32, rows: u32, brick: u32, texel: vec3<u32>) -> u32 {
    let row = brick >> LOG_ROW_BRICKS;
    let layer = (first_row + row) >> LOG_LAYER_ROWS;
    let low = max(layer << LOG_LAYER_ROWS, first_row) - first_row;
    let high = min(((layer + 1u) << LOG_LAYER_ROWS) - first_row, rows);
    let line = low * BRICK_SAMPLES * BRICK_SAMPLES
        + texel.z * BRICK_SAMPLES * (high - low)
        + (row - low) * BRICK_SAMPLES
        + texel.y;
    return line * LINE_WORDS + ((brick & (ROW_BRICKS - 1u)) * BRICK_WIDTH + texel.x) / 2u;
}
