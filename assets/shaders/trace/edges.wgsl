// Finds the pixels of a traced image that lie on edges of surfaces, which get further rays: where the colour
// changes by more than a little from a pixel to the next, or the depth by more than that of a plane.

#import bevy_vdb::trace::edge_list::{EDGE_COUNT, EDGE_WORDS, FIRST_EDGE, MAX_GROUPS, REFINEMENT_LAYERS}
#import bevy_vdb::view::depths::is_surface_depth

// Output of the trace; see `trace.wgsl`.
@group(0) @binding(0) var traced_color: texture_2d<f32>;
@group(0) @binding(1) var traced_depth: texture_2d<f32>;
// The list of pixels on edges; its head is zeroed beforehand.
@group(0) @binding(2) var<storage, read_write> edges: array<atomic<u32>>;

struct Setup {
    size: vec2<u32>,
    // Pixels of two workgroups of the refinement, one in each layer.
    pixels_of_layers: u32,
    pad: u32,
}

@group(0) @binding(3) var<uniform> setup: Setup;

// The least difference of two surfaces' colours, mapped to 0 to 1, that is an edge. With half of it, the error is
// the same and the refinement takes an eighth more time.
const CONTRAST: f32 = 0.125;
// The least bend of the depths along three pixels that is an edge, relative to their slope.
const BEND: f32 = 0.5;

var<workgroup> found: atomic<u32>;
var<workgroup> first: u32;

struct Pixel {
    color: vec4<f32>,
    depth: f32,
}

fn load(at: vec2<i32>) -> Pixel {
    let inside = clamp(at, vec2(0), vec2<i32>(setup.size) - 1);
    let color = textureLoad(traced_color, inside, 0);
    return Pixel(vec4(color.rgb / (1.0 + color.rgb), color.a), textureLoad(traced_depth, inside, 0).x);
}

// Whether there is an edge between two pixels, at least one of which shows a surface.
fn differs(a: Pixel, b: Pixel) -> bool {
    let are_surfaces = vec2(is_surface_depth(a.depth), is_surface_depth(b.depth));
    let is_contrast = any(abs(a.color - b.color) > vec4(CONTRAST));
    return are_surfaces.x != are_surfaces.y || (are_surfaces.x && is_contrast);
}

// Whether three pixels in a row are not on one plane: along a plane, the values in the depth buffer are those
// of an affine function of the position.
fn bends(a: Pixel, b: Pixel, c: Pixel) -> bool {
    let low = b.depth - a.depth;
    let high = c.depth - b.depth;
    // Of curved surfaces, slopes change gradually; steps are many times the slope beside them.
    let bend = abs(high - low);
    return bend > BEND * (abs(low) + abs(high)) && bend > 1e-3 * b.depth;
}

@compute @workgroup_size(8, 8, 1)
fn find_edges(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let at = vec2<i32>(id.xy);
    let middle = load(at);
    let left = load(at - vec2(1, 0));
    let right = load(at + vec2(1, 0));
    let up = load(at - vec2(0, 1));
    let down = load(at + vec2(0, 1));
    let is_surface = is_surface_depth(middle.depth);
    var is_edge = differs(left, middle) || differs(right, middle) || differs(up, middle) || differs(down, middle);
    if !is_edge && is_surface {
        is_edge = bends(left, middle, right) || bends(up, middle, down);
    }
    is_edge = is_edge && all(id.xy < setup.size);
    // Bevy's pipelines do not clear the memory of workgroups.
    if thread == 0u {
        atomicStore(&found, 0u);
    }
    workgroupBarrier();
    var own = 0u;
    if is_edge {
        own = atomicAdd(&found, 1u);
    }
    workgroupBarrier();
    if thread == 0u {
        let count = atomicLoad(&found);
        if count > 0u {
            first = atomicAdd(&edges[EDGE_COUNT], count);
            let groups = (first + count + setup.pixels_of_layers - 1u) / setup.pixels_of_layers;
            atomicMax(&edges[0], min(groups, MAX_GROUPS));
            atomicMax(&edges[1], (groups + MAX_GROUPS - 1u) / MAX_GROUPS);
            atomicMax(&edges[2], REFINEMENT_LAYERS);
        }
    }
    workgroupBarrier();
    if is_edge {
        let surface_bit = select(0u, 1u << 31u, is_surface);
        let entry = FIRST_EDGE + EDGE_WORDS * (first + own);
        let color = textureLoad(traced_color, at, 0);
        atomicStore(&edges[entry], id.x | (id.y << 15u) | surface_bit);
        atomicStore(&edges[entry + 1u], pack2x16float(color.rg));
        atomicStore(&edges[entry + 2u], pack2x16float(color.ba));
    }
}
