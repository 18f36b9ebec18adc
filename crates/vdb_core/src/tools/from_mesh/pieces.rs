//! The cubes of a lattice that a triangle and its surroundings touch.

use glam::DVec3;

/// Calls `visit` with the bounding box of each piece of a triangle, cut until no piece is longer
/// than `longest` along any axis. Pieces that are farther than `reach` from the box from `low` to
/// `high` are left out.
pub(super) fn pieces(
    [a, b, c]: [DVec3; 3],
    longest: f64,
    reach: f64,
    [low, high]: [DVec3; 2],
    visit: &mut impl FnMut(DVec3, DVec3),
) {
    let (own_low, own_high) = (a.min(b).min(c), a.max(b).max(c));
    if (own_low - reach).cmpgt(high).any() || (own_high + reach).cmplt(low).any() {
        return;
    }
    if (own_high - own_low).max_element() <= longest {
        return visit(own_low, own_high);
    }
    // Cuts the longest edge in two.
    let [ab, bc, ca] = [a - b, b - c, c - a].map(DVec3::length_squared);
    let [a, b, c] = match () {
        () if ab >= bc && ab >= ca => [a, b, c],
        () if bc >= ca => [b, c, a],
        () => [c, a, b],
    };
    let middle = (a + b) / 2.0;
    pieces([a, middle, c], longest, reach, [low, high], visit);
    pieces([middle, b, c], longest, reach, [low, high], visit);
}
