// Renders surfaces into one of Bevy's shadow maps: the fragments of a quad (`quad.wgsl`) find where the light's ray
// hits its surface.

#import bevy_vdb::gpu::bindings::grids
#import bevy_vdb::gpu::types::KIND_SURFACE
#import bevy_vdb::traversal::rays::ndc_of
#import bevy_vdb::traversal::hdda::{FAR, mirrored_ray, enter, first_hit}
#import bevy_vdb::view::scene::{depth_of_t, view, volumes}
#import bevy_vdb::trace::segment::{enters_page, lattice_ray, view_segment}
#ifdef VDB_SMOOTH
#import bevy_vdb::gpu::types::KIND_SMOOTH
#ifdef VDB_CLIP
#import bevy_vdb::trace::caps::first_clipped_root
#endif
#import bevy_vdb::traversal::smooth::first_root
#endif

@fragment
fn stop(
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) volume: u32,
) -> @builtin(frag_depth) f32 {
    let texel = vec2<u32>(position.xy);
    let grid = grids[volumes[volume].grid];
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
    if t >= FAR {
        discard;
    }
    return depth_of_t(t);
}
