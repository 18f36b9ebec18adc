// Gradients of smooth surfaces, interpolated between cells.
//
// The gradient of the trilinear interpolant jumps at every face between cells, which makes shading look
// faceted: its derivative along an axis is the difference between samples, constant along that axis within a
// cell. Here, that difference is the derivative at the middle of the cell, and between the middles of two
// cells, derivatives are interpolated, as in a quadratic spline. Where the surface does not pass through the
// face between the two, the samples of the other cell may not be stored; the derivative is then extrapolated
// from the cell on the other side. If the surface passes through neither face, the derivative stays constant.
//
// Every index is in range: records are those of blocks that are not empty, and `stored_pair` does not look up
// samples that are not stored.
#define_import_path bevy_vdb::traversal::normals

#import bevy_vdb::gpu::types::Grid
#import bevy_vdb::gpu::bindings::word_at
#import bevy_vdb::traversal::samples::{record_of, stored_pair, trilinear_gradient}
#import bevy_vdb::traversal::smooth::SurfaceHit
#import bevy_vdb::traversal::tree::{CHILD, LEAF_NUMBER, LOWER_BITS, covers, has_block, locate_slot, lower_slot}

// The cell beside that of a hit, along an axis, from which its derivative is interpolated.
struct Beside {
    // 0 if the surface passes through neither of the two faces.
    weight: f32,
    is_after: bool,
    cell: vec3<i32>,
}

// Whether samples have different signs.
fn is_crossed(face: vec4<f32>) -> bool {
    let is_negative = face < vec4(0.0);
    return any(is_negative) && !all(is_negative);
}

// `low` and `high` are the samples on the faces of the cell across the axis, `t` the position along it.
fn beside(cell: vec3<i32>, step: vec3<i32>, low: vec4<f32>, high: vec4<f32>, t: f32) -> Beside {
    let is_near_after = t > 0.5;
    let crossed = vec2(is_crossed(low), is_crossed(high));
    let is_near_crossed = select(crossed.x, crossed.y, is_near_after);
    let is_far_crossed = select(crossed.y, crossed.x, is_near_after);
    let is_after = is_near_after == is_near_crossed;
    let far_weight = select(0.0, -abs(t - 0.5), is_far_crossed);
    let weight = select(far_weight, abs(t - 0.5), is_near_crossed);
    return Beside(weight, is_after, cell + select(-step, step, is_after));
}

// The word of the slot around a cell beside that of a hit, and the head of its lower node.
fn slot_beside(grid: Grid, hit: SurfaceHit, beside: Beside) -> vec2<u32> {
    // Not whether it is in the box that rays are clipped to, because a page also stores the cells around that box.
    if !covers(grid, beside.cell) || beside.weight == 0.0 {
        return vec2(0u);
    }
    var accessor = hit.accessor;
    let word = locate_slot(grid, beside.cell, &accessor);
    return vec2(word, accessor.head);
}

// The cell beside that of a hit if its block has a record, or else the cell of the hit, with a weight of 0: a
// tile has no record, and a cell that the surface does not reach may have none.
fn stored_beside(hit: SurfaceHit, slot: vec2<u32>, beside: Beside) -> Beside {
    let is_stored = (slot.x & CHILD) != 0u && has_block(slot.x, beside.cell);
    return Beside(
        select(0.0, beside.weight, is_stored),
        beside.is_after,
        select(hit.cell, beside.cell, is_stored),
    );
}

// The record of the block around this cell.
fn record_beside(grid: Grid, hit: SurfaceHit, slot: vec2<u32>, beside: Beside) -> u32 {
    let is_own = all(beside.cell == hit.cell);
    let found = select(slot, vec2(hit.accessor.word, hit.accessor.head), is_own);
    return record_of(grid, found.x, found.y + (found.x & LEAF_NUMBER), beside.cell);
}

// The place in its block of the far face of a cell beside another: of its lowest sample.
fn far_face(beside: Beside, axis: vec3<u32>) -> vec3<u32> {
    return (vec3<u32>(beside.cell) & vec3(3u)) + select(vec3(0u), axis, beside.is_after);
}

// The derivative along an axis, from the samples on the faces of a cell across it and on the far face of the
// cell beside it; `u` is the position across the axis.
fn derivative(low: vec4<f32>, high: vec4<f32>, far: vec4<f32>, beside: Beside, u: vec2<f32>) -> f32 {
    let slopes_beside = select(low - far, far - high, beside.is_after);
    let slopes = mix(high - low, slopes_beside, beside.weight);
    let at_u = mix(slopes.xy, slopes.zw, u.x);
    return mix(at_u.x, at_u.y, u.y);
}

// The gradient where a ray hits a smooth surface, in values per voxel.
//
// There is hardly a branch, so that what is read for one axis does not wait for the others.
fn smooth_gradient(grid: Grid, hit: SurfaceHit) -> vec3<f32> {
    let c = hit.corners;
    let u = hit.frac;
    if (hit.accessor.word & CHILD) == 0u {
        return grid.scale * trilinear_gradient(c, u);
    }
    let x = vec3(1u, 0u, 0u);
    let y = vec3(0u, 1u, 0u);
    let z = vec3(0u, 0u, 1u);
    let low_y = vec4(c.low.xy, c.high.xy);
    let high_y = vec4(c.low.zw, c.high.zw);
    let low_z = vec4(c.low.xz, c.high.xz);
    let high_z = vec4(c.low.yw, c.high.yw);
    let beside_x = beside(hit.cell, vec3<i32>(x), c.low, c.high, u.x);
    let beside_y = beside(hit.cell, vec3<i32>(y), low_y, high_y, u.y);
    let beside_z = beside(hit.cell, vec3<i32>(z), low_z, high_z, u.z);

    let moved = (beside_x.cell ^ hit.cell) | (beside_y.cell ^ hit.cell) | (beside_z.cell ^ hit.cell);
    var slot_x = vec2(0u, hit.accessor.head);
    var slot_y = slot_x;
    var slot_z = slot_x;
    if any((moved >> vec3(LOWER_BITS)) != vec3(0)) {
        slot_x = slot_beside(grid, hit, beside_x);
        slot_y = slot_beside(grid, hit, beside_y);
        slot_z = slot_beside(grid, hit, beside_z);
    } else {
        slot_x.x = word_at(hit.accessor.lower_node + lower_slot(beside_x.cell));
        slot_y.x = word_at(hit.accessor.lower_node + lower_slot(beside_y.cell));
        slot_z.x = word_at(hit.accessor.lower_node + lower_slot(beside_z.cell));
    }
    let stored_x = stored_beside(hit, slot_x, beside_x);
    let stored_y = stored_beside(hit, slot_y, beside_y);
    let stored_z = stored_beside(hit, slot_z, beside_z);
    let record_x = record_beside(grid, hit, slot_x, stored_x);
    let record_y = record_beside(grid, hit, slot_y, stored_y);
    let record_z = record_beside(grid, hit, slot_z, stored_z);
    let at_x = far_face(stored_x, x);
    let at_y = far_face(stored_y, y);
    let at_z = far_face(stored_z, z);
    let far_x = vec4(stored_pair(grid, record_x, at_x), stored_pair(grid, record_x, at_x + y));
    let far_y = vec4(stored_pair(grid, record_y, at_y), stored_pair(grid, record_y, at_y + x));
    let far_z = vec4(
        stored_pair(grid, record_z, at_z).x,
        stored_pair(grid, record_z, at_z + y).x,
        stored_pair(grid, record_z, at_z + x).x,
        stored_pair(grid, record_z, at_z + x + y).x,
    );
    return grid.scale * vec3(
        derivative(c.low, c.high, far_x, stored_x, u.yz),
        derivative(low_y, high_y, far_y, stored_y, u.xz),
        derivative(low_z, high_z, far_z, stored_z, u.xy),
    );
}
