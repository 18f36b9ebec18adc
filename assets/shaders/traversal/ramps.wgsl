// Transfer functions from the values of a grid to the optical properties of fog: their means over all values
// between two, from tables of integrals (Engel, Kraus and Ertl 2001, "High-quality pre-integrated volume
// rendering using hardware-accelerated pixel shading"). Twin: `RampTable` in `crates/vdb_core/src/ramp.rs`.
//
// Every index is in range: positions are clamped to the entries of a row, and rows come from the CPU.
#define_import_path bevy_vdb::traversal::ramps

#import bevy_vdb::gpu::types::Grid

// Rows of four ramps follow each other; each row has entries for the range of the stops, and one more on
// either side for all values beyond.
@group(2) @binding(16) var ramps: texture_2d<f32>;

// The rows of a ramp: red, green and blue of the scattering coefficient, and extinction, as means over each
// entry; sums of the means of all entries before it; differences between the end and the beginning of each
// entry; and the same of emission.
const ROWS: u32 = 6u;
const SCATTERING: u32 = 0u;
const EMISSION: u32 = 3u;

// Farthest position beyond the ends of a ramp, in entries.
const FARTHEST_POSITION: f32 = 1e7;

// Whether values of a grid from `fog_grid` are mapped.
fn has_ramp(grid: Grid) -> bool {
    return (grid.ramp & 0xffffu) != 0u;
}

// The positions of two values in a ramp, in entries from the first stop, and the texels that they are in.
struct Crossed {
    low: f32,
    high: f32,
    first: u32,
    last: u32,
}

fn crossed_entries(grid: Grid, from_value: f32, to_value: f32) -> Crossed {
    let entries = f32(textureDimensions(ramps).x - 2u);
    let values = vec2(min(from_value, to_value), max(from_value, to_value));
    let positions = clamp(
        (values - grid.ramp_low) * grid.ramp_scale,
        vec2(-FARTHEST_POSITION),
        vec2(entries + FARTHEST_POSITION),
    );
    let texels = vec2<u32>(clamp(floor(positions) + 1.0, vec2(0.0), vec2(entries + 1.0)));
    return Crossed(positions.x, positions.y, texels.x, texels.y);
}

// Mean over a part of an entry whose middle is at `at`, from -0.5 to 0.5.
fn mean_in_entry(entry: u32, y: u32, at: f32) -> vec4<f32> {
    return textureLoad(ramps, vec2(entry, y), 0) + at * textureLoad(ramps, vec2(entry, y + 2u), 0);
}

// Means over the values between two. Only differences of sums over whole entries are taken, so nothing
// cancels where the values are nearly equal.
fn means_over(grid: Grid, crossed: Crossed, row: u32) -> vec4<f32> {
    let y = ((grid.ramp & 0xffffu) - 1u) * ROWS + row;
    if crossed.first == crossed.last {
        let middle = 0.5 * (crossed.low + crossed.high);
        return mean_in_entry(crossed.first, y, middle - (f32(crossed.first) - 0.5));
    }
    let begin = textureLoad(ramps, vec2(crossed.first + 1u, y + 1u), 0);
    let end = textureLoad(ramps, vec2(crossed.last, y + 1u), 0);
    let before = f32(crossed.first) - crossed.low;
    let after = crossed.high - (f32(crossed.last) - 1.0);
    let near = mean_in_entry(crossed.first, y, 0.5 - 0.5 * before);
    let far = mean_in_entry(crossed.last, y, 0.5 * after - 0.5);
    return (before * near + (end - begin) + after * far) / (crossed.high - crossed.low);
}

// Mean extinction on a stretch of a ray with these values at its start, in its middle and at its end.
fn mean_extinction(grid: Grid, values: vec3<f32>) -> f32 {
    let near = means_over(grid, crossed_entries(grid, values.x, values.y), SCATTERING);
    let far = means_over(grid, crossed_entries(grid, values.y, values.z), SCATTERING);
    return 0.5 * (near.w + far.w);
}
