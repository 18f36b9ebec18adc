//! Which fogs share a lattice: those whose boxes overlap, because each scatters the light of the others.

use bevy::math::DVec3;
use bevy::render::sync_world::MainEntity;

/// The bounds of a fog in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct FogBox {
    /// Its index in the list of a view.
    pub entry: usize,
    /// The entity of the volume.
    pub owner: MainEntity,
    pub min: DVec3,
    pub max: DVec3,
}

impl FogBox {
    fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    fn volume(&self) -> f64 {
        (self.max - self.min).element_product()
    }
}

/// At most `most` groups of fogs, the largest fog of each first. If there are more groups, the smallest share
/// a lattice.
pub(super) fn groups(mut fogs: Vec<FogBox>, most: usize) -> Vec<Vec<usize>> {
    fogs.sort_unstable_by(|a, b| a.min.x.total_cmp(&b.min.x));
    // For each fog, an earlier one of its group, or itself.
    let mut parents: Vec<usize> = (0..fogs.len()).collect();
    for i in 0..fogs.len() {
        let end = fogs[i].max.x;
        for j in (i + 1..fogs.len()).take_while(|j| fogs[*j].min.x <= end) {
            if fogs[i].overlaps(&fogs[j]) {
                let (a, b) = (root(&mut parents, i), root(&mut parents, j));
                parents[a.max(b)] = a.min(b);
            }
        }
    }
    let mut members: Vec<Vec<FogBox>> = vec![Vec::new(); fogs.len()];
    for (i, fog) in fogs.iter().enumerate() {
        members[root(&mut parents, i)].push(*fog);
    }
    let largest_first =
        |a: &FogBox, b: &FogBox| b.volume().total_cmp(&a.volume()).then(a.owner.cmp(&b.owner));
    members.retain(|group| !group.is_empty());
    members.iter_mut().for_each(|group| group.sort_unstable_by(largest_first));
    members.sort_unstable_by(|a, b| largest_first(&a[0], &b[0]));
    if members.len() > most {
        let rest = members.split_off(most - 1).concat();
        members.push(rest);
    }
    let entries = |group: Vec<FogBox>| group.iter().map(|fog| fog.entry).collect();
    members.into_iter().map(entries).collect()
}

fn root(parents: &mut [usize], mut of: usize) -> usize {
    while parents[of] != of {
        parents[of] = parents[parents[of]];
        of = parents[of];
    }
    of
}

#[cfg(test)]
mod tests {
    use bevy::ecs::entity::Entity;

    use super::*;

    fn fogs(places: &[(f64, f64)]) -> Vec<FogBox> {
        let fog = |(entry, (at, edge)): (usize, &(f64, f64))| {
            let min = DVec3::splat(*at);
            let owner = Entity::from_raw_u32(entry as u32).unwrap().into();
            FogBox { entry, owner, min, max: min + *edge }
        };
        places.iter().enumerate().map(fog).collect()
    }

    #[test]
    fn fogs_that_overlap_share_a_lattice() {
        let all = [(0.0, 1.0), (5.0, 2.0), (0.9, 0.5), (1.3, 3.0), (8.0, 1.0)];
        assert_eq!(groups(fogs(&all), 8), [vec![3, 0, 2], vec![1], vec![4]]);
        assert_eq!(groups(Vec::new(), 8), Vec::<Vec<usize>>::new());
        // Apart along one axis only.
        let mut apart = fogs(&[(0.0, 1.0), (0.0, 1.0)]);
        apart[1].min.y = 2.0;
        apart[1].max.y = 3.0;
        assert_eq!(groups(apart, 8).len(), 2);
    }

    #[test]
    fn the_smallest_groups_share_what_is_left() {
        let all = [(0.0, 1.0), (10.0, 2.0), (20.0, 3.0), (30.0, 4.0)];
        assert_eq!(groups(fogs(&all), 3), [vec![3], vec![2], vec![1, 0]]);
    }
}
