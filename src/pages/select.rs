//! Which pages cameras need, and which of them can be displayed.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use bevy::platform::collections::HashSet;
use vdb_core::pages::{PageId, PageIndex};

/// The pages that cameras need.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Selection {
    /// All of them, the most important first: a page comes after the one that covers it.
    pub wanted: Vec<PageId>,
    /// Those whose children are to be displayed in their place.
    pub refined: HashSet<PageId>,
    /// The number of pages for which there is no room.
    pub without_room: u32,
}

/// A page whose voxels are too large on screen, by this factor.
struct Coarse(f32, PageId);

impl Ord for Coarse {
    fn cmp(&self, other: &Self) -> Ordering {
        // Of equal ones, the first.
        self.0.total_cmp(&other.0).then_with(|| other.1.cmp(&self.1))
    }
}

impl PartialOrd for Coarse {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Coarse {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Coarse {}

/// The bytes of a page on the GPU. No page costs nothing, so that their number is limited, too.
pub(super) fn cost(index: &PageIndex, id: PageId) -> u64 {
    const LEAST: u64 = 4096;
    index.pages.get(&id).map_or(0, |entry| entry.packed_bytes.max(LEAST))
}

/// Selects pages of at most `max_bytes`, and those of the coarsest level in any case. `excess` is the size of a
/// page's voxels on screen relative to the largest allowed size; pages with the greatest excess are refined first.
/// A page with a child that is not `is_usable` is not refined.
pub(super) fn select(
    index: &PageIndex,
    max_bytes: u64,
    excess: impl Fn(PageId) -> f32,
    is_usable: impl Fn(PageId) -> bool,
) -> Selection {
    let bytes_of = |id: &PageId| cost(index, *id);
    let mut selection = Selection { wanted: index.roots().collect(), ..Selection::default() };
    let mut bytes: u64 = selection.wanted.iter().map(bytes_of).sum();
    let coarse = |id: PageId| {
        // Only its children can take the place of a page of the coarsest level that failed.
        let excess = if is_usable(id) { excess(id) } else { f32::INFINITY };
        (id.level > 0 && excess > 1.0).then_some(Coarse(excess, id))
    };
    let mut heap: BinaryHeap<_> = selection.wanted.iter().filter_map(|id| coarse(*id)).collect();
    while let Some(Coarse(_, id)) = heap.pop() {
        let children: Vec<_> = index.children(id).collect();
        if !children.iter().all(|child| is_usable(*child)) {
            continue;
        }
        let more: u64 = children.iter().map(bytes_of).sum();
        if bytes.saturating_add(more) > max_bytes {
            selection.without_room += children.len() as u32;
            continue;
        }
        bytes += more;
        selection.refined.insert(id);
        heap.extend(children.iter().filter_map(|child| coarse(*child)));
        selection.wanted.extend(children);
    }
    selection
}

/// The pages to be displayed: together they cover everything once. A page is displayed in place of its
/// children until all of them are ready, and the page itself, which may have to take their place again, is
/// ready or `has_failed`.
pub(super) fn displayed(
    index: &PageIndex,
    refined: &HashSet<PageId>,
    is_ready: impl Fn(PageId) -> bool,
    has_failed: impl Fn(PageId) -> bool,
) -> Vec<PageId> {
    let is_there = |id: PageId| !index.has_grid(id) || is_ready(id);
    let mut shown = Vec::new();
    let mut stack: Vec<_> = index.roots().collect();
    while let Some(id) = stack.pop() {
        let is_safe = is_there(id) || has_failed(id);
        if refined.contains(&id) && is_safe && index.children(id).all(is_there) {
            stack.extend(index.children(id));
        } else if index.has_grid(id) && is_ready(id) {
            shown.push(id);
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use bevy::math::DVec3;
    use vdb_core::pages::{FunctionSource, PageOptions, cook_pages};

    use super::*;

    /// A ball across eight pages of the coarsest level, at three levels.
    fn ball() -> PageIndex {
        let bounds = [DVec3::splat(-410.0), DVec3::splat(410.0)];
        let identity = bevy::math::DAffine3::IDENTITY;
        let ball = FunctionSource::new("ball", identity, bounds, |p| p.length() - 400.0);
        let options = PageOptions { edge: 128, ..PageOptions::default() };
        cook_pages(&ball, &options, &|_, _| Ok(())).unwrap()
    }

    /// The factor for a camera at a point, whose pixels are `angle` times the distance.
    fn excess(index: &PageIndex, eye: DVec3, angle: f64) -> impl Fn(PageId) -> f32 {
        move |id| {
            let (low, high) = index.index_bounds(id);
            let distance = eye.distance(eye.clamp(low, high));
            (f64::from(1 << id.level) / (angle * distance).max(1e-9)) as f32
        }
    }

    /// The number of displayed pages that cover a point.
    fn covering(index: &PageIndex, displayed: &[PageId], point: DVec3) -> usize {
        let covers = |id: &&PageId| {
            let (low, high) = index.index_bounds(**id);
            point.cmpge(low).all() && point.cmplt(high).all()
        };
        displayed.iter().filter(covers).count()
    }

    /// Points on the ball.
    fn points() -> impl Iterator<Item = DVec3> {
        (0..500).map(|i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 500.0;
            let (sin, cos) = (2.399_963 * f64::from(i)).sin_cos();
            400.0 * DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
        })
    }

    #[test]
    fn every_point_is_covered_once_whatever_has_arrived() {
        let index = ball();
        assert!(index.levels >= 3 && index.pages.len() > 50, "{} pages", index.pages.len());
        for (eye, angle) in [(900.0, 0.001), (410.0, 0.01), (2_000.0, 0.002)] {
            let eye = DVec3::new(eye, 0.0, 0.0);
            let selection = select(&index, u64::MAX, excess(&index, eye, angle), |_| true);
            assert_eq!(selection.without_room, 0);
            for arrived in 0..=selection.wanted.len() {
                let ready: HashSet<_> = selection.wanted[..arrived].iter().copied().collect();
                if !index.roots().all(|root| ready.contains(&root)) {
                    continue;
                }
                let pages =
                    displayed(&index, &selection.refined, |id| ready.contains(&id), |_| false);
                for point in points() {
                    assert_eq!(covering(&index, &pages, point), 1, "{point} of {arrived} pages");
                }
            }
        }
    }

    #[test]
    fn voxels_are_no_larger_than_asked_where_there_is_room() {
        let index = ball();
        let excess = excess(&index, DVec3::new(450.0, 0.0, 0.0), 0.01);
        let selection = select(&index, u64::MAX, &excess, |_| true);
        let pages = displayed(&index, &selection.refined, |_| true, |_| false);
        assert!(pages.iter().all(|id| id.level == 0 || excess(*id) <= 1.0));
        assert!(pages.iter().any(|id| id.level == 0) && pages.iter().any(|id| id.level > 0));
        // No page is finer than it has to be.
        assert!(pages.iter().all(|id| id.level + 1 == index.levels || excess(id.parent()) > 1.0));
    }

    #[test]
    fn the_nearest_pages_get_the_room() {
        let index = ball();
        let excess = excess(&index, DVec3::new(450.0, 0.0, 0.0), 1e-6);
        let all = select(&index, u64::MAX, &excess, |_| true);
        let bytes = |pages: &[PageId]| -> u64 { pages.iter().map(|id| cost(&index, *id)).sum() };
        let roots: Vec<_> = index.roots().collect();
        for share in [0, 10, 30, 60, 100] {
            let max = bytes(&all.wanted) * share / 100;
            let selection = select(&index, max, &excess, |_| true);
            assert!(bytes(&selection.wanted) <= max.max(bytes(&roots)));
            assert_eq!(selection.without_room == 0, share == 100);
            let left = |id: &PageId| !selection.refined.contains(id);
            let refined = selection.refined.iter().map(|id| excess(*id)).fold(f32::MAX, f32::min);
            // What was left out is coarser by less, or was too large for the room that remained.
            let coarsest = all.refined.iter().filter(|id| left(id)).map(|id| excess(*id));
            let missed = coarsest.filter(|excess| *excess > 4.0 * refined).count();
            assert!(missed <= all.refined.len() / 8, "{missed} at {share} %");
        }
    }

    #[test]
    fn a_page_that_failed_is_covered_by_its_parent() {
        let index = ball();
        let excess = excess(&index, DVec3::new(450.0, 0.0, 0.0), 0.001);
        let lost = *index.pages.keys().find(|id| id.level == 0).unwrap();
        let selection = select(&index, u64::MAX, excess, |id| id != lost);
        let pages = displayed(&index, &selection.refined, |_| true, |_| false);
        assert!(!selection.wanted.contains(&lost));
        assert!(points().all(|point| covering(&index, &pages, point) == 1));
    }

    /// There is none coarser that could cover it.
    #[test]
    fn the_children_of_a_page_of_the_coarsest_level_replace_it_if_it_failed() {
        let index = ball();
        let far = excess(&index, DVec3::new(1e5, 0.0, 0.0), 0.1);
        let lost = index.roots().next().unwrap();
        let selection = select(&index, u64::MAX, far, |id| id != lost);
        assert!(selection.refined.contains(&lost) && selection.refined.len() == 1);
        let is_lost = |id| id == lost;
        let pages = displayed(&index, &selection.refined, |id| id != lost, is_lost);
        assert!(points().all(|point| covering(&index, &pages, point) == 1));
    }
}
