// What is shown of surfaces instead of their look, and the borders of the tree's nodes on top of it.
#define_import_path bevy_vdb::trace::show

#import bevy_vdb::gpu::types::Ray
#import bevy_vdb::traversal::hdda::FAR
#import bevy_vdb::view::scene::{view, volumes}
#import bevy_vdb::trace::segment::{Segment, lattice_ray}
#import bevy_vdb::trace::surface::{Surface, safe_normalize}

// Shares of the three axes in what a surface's normal is, with 1 in all.
fn axis_weights(surface: Surface) -> vec3<f32> {
    let n = safe_normalize(surface.gradient);
    return n * n;
}

// Faces told apart by how bright they are: as if lit from above, a little from the right.
fn gray(surface: Surface) -> f32 {
    let up = vec3(0.72, 1.0, 0.56);
    let down = vec3(0.36, 0.2, 0.46);
    return dot(axis_weights(surface), select(down, up, surface.gradient > vec3(0.0)));
}

// A colour of its own for each voxel, or cell between samples: by its place among 128³, so that it
// does not depend on where a grid begins.
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
// Half the width of a border, in pixels.
const HALF_WIDTH: f32 = 0.75;
// Nodes of fewer pixels have no borders: they would cover all.
const FEWEST_PIXELS: f32 = 4.0;

// How much of a pixel a line covers that is so many pixels away.
fn line_coverage(distance: f32) -> f32 {
    return saturate(HALF_WIDTH + 0.5 - distance);
}

// How much of the pixel the borders of nodes of so many cells per edge cover. `cells` is how many cells
// a pixel spans along each axis.
fn border_coverage(position: vec3<f32>, footprint: vec3<f32>, edge: f32) -> f32 {
    let in_node = position - edge * floor(position / edge);
    let pixels = min(in_node, edge - in_node) / max(footprint, vec3(1e-9));
    let fade = saturate(edge / max(footprint, vec3(1e-9)) / FEWEST_PIXELS - 1.0);
    // Along an axis that the surface does not run along, there is nothing to be near to.
    let coverage = select(vec3(line_coverage(pixels.x), line_coverage(pixels.y), line_coverage(pixels.z)) * fade, vec3(0.0), footprint < vec3(1e-6));
    return max(max(coverage.x, coverage.y), coverage.z);
}

// Puts the borders of nodes on a colour. They lie on the surface, as wide in pixels wherever it is and
// however it stands to the view.
fn with_overlays(color: vec3<f32>, segment: Segment, surface: Surface) -> vec3<f32> {
    let rays = volumes[surface.volume].rays;
    let ray = lattice_ray(segment, surface.volume, FAR);
    // From this pixel's place to the next one's on the plane that touches the surface.
    let n = safe_normalize(surface.gradient);
    let slope = dot(n, ray.dir);
    let right = (rays.eye_x + surface.t * rays.dir_x) * (2.0 / f32(view.size.x));
    let down = (rays.eye_y + surface.t * rays.dir_y) * (2.0 / f32(view.size.y));
    let along_ray = ray.dir / select(slope, -1e-6, abs(slope) < 1e-6);
    let footprint = abs(right - dot(n, right) * along_ray) + abs(down - dot(n, down) * along_ray);
    // Of a voxel's face, the place across it is on a border of cells: exactly nothing is along it.
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
