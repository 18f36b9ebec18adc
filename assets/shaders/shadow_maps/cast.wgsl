// Renders volumes into one of Bevy's shadow maps. Each volume is an instance: a quad over the texels that
// may show it, whose fragments find the depth at which the light's ray is stopped.

#import bevy_vdb::gpu::types::{KIND_FOG, KIND_SMOOTH, KIND_SURFACE}
#import bevy_vdb::traversal::rays::ndc_of
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray, enter, first_hit, local_cell}
#import bevy_vdb::view::scene::{fog_grid, view, volumes}
#import bevy_vdb::trace::segment::{enters_page, lattice_ray, view_segment}
#ifdef VDB_SMOOTH
#ifdef VDB_CLIP
#import bevy_vdb::trace::caps::first_clipped_root
#endif
#import bevy_vdb::traversal::smooth::first_root
#endif
#ifdef VDB_FOGS
#import bevy_vdb::traversal::march::{begin_march, next_interval, scaled_step}
#import bevy_vdb::traversal::tree::new_accessor
#endif

// Texels per edge of a tile: `TILE` in `src/render/view/tiles.rs`.
const TILE: f32 = 8.0;

struct Quad {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) instance: u32,
}

@vertex
fn quad(@builtin(vertex_index) corner: u32, @builtin(instance_index) instance: u32) -> Quad {
    let tiles_first = volumes[view.volume_first + instance].tiles_first;
    let tiles_last = volumes[view.volume_first + instance].tiles_last;
    let is_last = vec2((corner & 1u) != 0u, (corner & 2u) != 0u);
    let tile = select(
        vec2(tiles_first & 0xffffu, tiles_first >> 16u),
        vec2(tiles_last & 0xffffu, tiles_last >> 16u) + 1u,
        is_last,
    );
    let at = TILE * vec2<f32>(tile) / vec2<f32>(view.size);
    return Quad(vec4(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.5, 1.0), instance);
}

#ifdef VDB_FOGS
// The transmittance at which a texel stops its ray. Fog attenuates light gradually, but a texel has a single
// depth. Each texel therefore has a threshold of its own: 256 thresholds in squares of 16×16 texels, after
// Bayer 1973, "An optimum method for two-level rendition of continuous-tone pictures", whose patterns are so
// fine that shadow map filtering smooths them. The first three digits of further fogs are rotated, so that up to
// three fogs in front of each other hardly share thresholds. The last digit, that of the coarsest squares, stays the last, or
// the pattern would be as coarse as these. In views with temporal jitter, the thresholds change every
// frame.
fn dither_threshold(texel: vec2<u32>, fog: u32) -> f32 {
    var digits = 0u;
    for (var i = 0u; i < 4u; i++) {
        let bit = (texel >> vec2(i)) & vec2(1u);
        let place = select(1u + (2u - i + fog % 3u) % 3u, 0u, i == 3u);
        digits |= (2u * (bit.x ^ bit.y) + bit.y) << (2u * place);
    }
    return max(fract((f32(digits) + 0.5) / 256.0 + view.random_offset), 1e-6);
}

// Voxels between samples of fog, and the longest edge of its box, in voxels, above which steps become
// longer. Several cameras may share a shadow map, so their quality settings do not apply.
const STEP: f32 = 1.0;
const EDGE: f32 = 256.0;
#endif

@fragment
fn stop(in: Quad) -> @builtin(frag_depth) f32 {
    let texel = vec2<u32>(in.position.xy);
    let volume = view.volume_first + in.instance;
    let grid = fog_grid(volume);
    let segment = view_segment(ndc_of(texel, view.size));
    let mirrored = mirrored_ray(grid, lattice_ray(segment, volume, FAR));
    let dda = enter(mirrored);
    var t = FAR;
#ifdef VDB_SURFACES
    if volumes[volume].kind == KIND_SURFACE {
        let hit = first_hit(grid, mirrored, dda);
        t = select(FAR, hit.t, hit.found);
    }
#endif
#ifdef VDB_SMOOTH
    if volumes[volume].kind == KIND_SMOOTH {
        let begins_outside = enters_page(volume, dda.axis);
#ifdef VDB_CLIP
        let clipped = first_clipped_root(segment, volume, grid, mirrored, dda, begins_outside);
        t = select(select(FAR, clipped.root.t, clipped.root.found), dda.t, clipped.is_cap);
#else
        let root = first_root(grid, mirrored, dda, begins_outside);
        t = select(FAR, root.t, root.found);
#endif
    }
#endif
#ifdef VDB_FOGS
    if volumes[volume].kind == KIND_FOG && dda.inside {
        let scale = volumes[volume].density_scale * length(segment.dir);
        var remaining = -log(dither_threshold(texel, in.instance)) / max(scale, 1e-30);
        var march = begin_march(mirrored, dda, scaled_step(grid, STEP, EDGE));
        var accessor = new_accessor(local_cell(mirrored, dda.rel));
        while march.dda.inside {
            let interval = next_interval(grid, mirrored, &march, &accessor, 1e30);
            if interval.density_integral >= remaining {
                t = mix(
                    interval.t_first,
                    2.0 * interval.t_mean - interval.t_first,
                    remaining / max(interval.density_integral, 1e-30),
                );
                break;
            }
            remaining -= interval.density_integral;
        }
    }
#endif
    if t >= FAR {
        discard;
    }
    // Clamp depths in front of the near plane to it.
    let m = view.depth_from_t;
    return saturate((m.x * t + m.y) / (m.z * t + m.w));
}
