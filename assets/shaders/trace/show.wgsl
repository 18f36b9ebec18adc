// Render modes without lighting, and the overlay of tree node borders.
#define_import_path bevy_vdb::trace::show

#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::traversal::rays::safe_normalize
#import bevy_vdb::view::scene::{view, volumes}
#import bevy_vdb::trace::segment::{Segment, ray_of_level}
#import bevy_vdb::trace::surface::Surface

// Squared components of the unit normal, which sum to 1.
fn axis_weights(surface: Surface) -> vec3<f32> {
    let n = safe_normalize(surface.gradient);
    return n * n;
}

// Shades faces by orientation, as if lit from above and slightly from the right.
fn gray(surface: Surface) -> f32 {
    let up = vec3(0.72, 1.0, 0.56);
    let down = vec3(0.36, 0.2, 0.46);
    return dot(axis_weights(surface), select(down, up, surface.gradient > vec3(0.0)));
}

// A pseudo-random colour for each voxel, or cell between samples. It depends on the coordinates modulo 128,
// not on where a grid begins.
fn voxel_color(surface: Surface) -> vec3<f32> {
    let at = vec3<u32>(surface.cell + volumes[surface.volume].base) & vec3(127u);
    var bits = at.x | (at.y << 7u) | (at.z << 14u);
    // The finaliser of MurmurHash3.
    bits = (bits ^ (bits >> 16u)) * 0x85ebca6bu;
    bits = (bits ^ (bits >> 13u)) * 0xc2b2ae35u;
    bits ^= bits >> 16u;
    let channels = vec3(bits, bits >> 8u, bits >> 16u) & vec3(255u);
    return 0.1 + 0.9 * vec3<f32>(channels) / 255.0;
}

#ifdef VDB_OVERLAYS
// Half the width of a border in pixels.
const HALF_WIDTH: f32 = 0.75;
// Nodes narrower than this, in pixels, have no borders, which would cover everything.
const MIN_NODE_PIXELS: f32 = 4.0;

// Fraction of a pixel that a line covers at a distance in pixels.
fn line_coverage(distance: f32) -> f32 {
    return saturate(HALF_WIDTH + 0.5 - distance);
}

// Fraction of a pixel covered by the borders of nodes with `edge` cells per edge. `footprint` is the number
// of cells that a pixel spans along each axis.
fn border_coverage(position: vec3<f32>, footprint: vec3<f32>, edge: f32) -> f32 {
    let in_node = position - edge * floor(position / edge);
    let pixels = min(in_node, edge - in_node) / max(footprint, vec3(1e-9));
    let fade = saturate(edge / max(footprint, vec3(1e-9)) / MIN_NODE_PIXELS - 1.0);
    // Along an axis perpendicular to the surface, there is no border to be near.
    let coverage = select(
        vec3(line_coverage(pixels.x), line_coverage(pixels.y), line_coverage(pixels.z)) * fade,
        vec3(0.0),
        footprint < vec3(1e-6),
    );
    return max(max(coverage.x, coverage.y), coverage.z);
}

// Blends node borders over a colour. They lie on the surface and have the same width in pixels everywhere.
fn with_overlays(color: vec3<f32>, segment: Segment, surface: Surface) -> vec3<f32> {
    let rays = volumes[surface.volume].rays;
    let ray = ray_of_level(segment, surface.volume, FAR);
    // Step from this pixel to the next on the tangent plane.
    let n = safe_normalize(surface.gradient);
    let slope = dot(n, ray.dir);
    let right = (rays.eye_x + surface.t * rays.dir_x) * (2.0 / f32(view.size.x));
    let down = (rays.eye_y + surface.t * rays.dir_y) * (2.0 / f32(view.size.y));
    let along_ray = ray.dir / select(slope, -1e-6, abs(slope) < 1e-6);
    let footprint = abs(right - dot(n, right) * along_ray) + abs(down - dot(n, down) * along_ray);
    // A voxel face lies exactly on a cell border, so its footprint across the face must be zero.
    let face_footprint = select(footprint, vec3(0.0), vec3(surface.is_face) & (n != vec3(0.0)));
    let position = vec3<f32>((surface.cell + volumes[surface.volume].base) & vec3(4095)) + surface.frac;
    var shown = color;
    if (view.overlays & 1u) != 0u {
        shown = mix(shown, vec3(0.0, 1.0, 1.0), border_coverage(position, face_footprint, 8.0));
    }
    if (view.overlays & 2u) != 0u {
        shown = mix(shown, vec3(1.0, 0.0, 0.0), border_coverage(position, face_footprint, 128.0));
    }
    if (view.overlays & 4u) != 0u {
        shown = mix(shown, vec3(0.0, 0.0, 1.0), border_coverage(position, face_footprint, 4096.0));
    }
    return shown;
}
#endif
