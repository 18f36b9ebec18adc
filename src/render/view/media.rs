//! Media, which are fogs and emission grids, and the slots that shaders with the light cache have
//! for them.

use bevy::platform::collections::HashSet;
use bevy::render::sync_world::MainEntity;

use crate::render::gpu::types;

/// The most media that shaders march together; rays that meet more are divided into slabs.
pub(super) const MAX_MEDIA: u32 = 8;

/// The slots for this many media, rounded up to a few sizes, because each is a shader variant.
pub(super) fn media_slots(count: u32) -> u32 {
    count.next_power_of_two().min(MAX_MEDIA)
}

/// Whether entries of a kind attenuate rays or emit light along them.
pub(super) fn is_medium(kind: u32) -> bool {
    matches!(kind, types::KIND_FOG | types::KIND_EMISSION | types::KIND_BLACKBODY)
}

/// The volumes and kinds of the media that a view has drawn.
pub(super) type DrawnMedia = HashSet<(MainEntity, u32)>;

/// Hides the media for which shaders have no slots: the last of those that have not been drawn yet
/// and, if they are still too many, the last of the others.
pub(super) fn hide_surplus<'a>(
    entries: impl Iterator<Item = (MainEntity, &'a mut types::Volume)>,
    drawn: &DrawnMedia,
    slots: u32,
) {
    let mut media: Vec<_> = entries.filter(|(_, volume)| is_medium(volume.kind)).collect();
    media.sort_by_key(|(owner, volume)| !drawn.contains(&(*owner, volume.kind)));
    for (_, volume) in media.into_iter().skip(slots as usize) {
        volume.kind = types::KIND_NONE;
    }
}

#[cfg(test)]
mod tests {
    use bevy::ecs::entity::Entity;

    use super::*;
    use types::{KIND_EMISSION, KIND_FOG, KIND_NONE, KIND_SURFACE};

    #[test]
    fn slots_come_in_few_sizes() {
        let of = [0, 1, 2, 3, 4, 5, 8, 9].map(media_slots);
        assert_eq!(of, [1, 1, 2, 4, 4, 8, 8, 8]);
    }

    #[test]
    fn media_that_are_on_screen_keep_their_slots() {
        let owner = |i| MainEntity::from(Entity::from_raw_u32(i).unwrap());
        let list = [
            (0, KIND_FOG),
            (1, KIND_SURFACE),
            (2, KIND_FOG),
            (2, KIND_EMISSION),
            (3, KIND_FOG),
            (4, KIND_NONE),
        ];
        let kept = |drawn: &[(u32, u32)], slots| {
            let drawn = drawn.iter().map(|(i, kind)| (owner(*i), *kind)).collect();
            let mut volumes = list.map(|(_, kind)| types::Volume { kind, ..Default::default() });
            let owners = list.map(|(i, _)| owner(i));
            hide_surplus(owners.into_iter().zip(&mut volumes), &drawn, slots);
            volumes.map(|volume| volume.kind)
        };
        let all = list.map(|(_, kind)| kind);
        assert_eq!(kept(&[], 4), all);
        let expected = [KIND_FOG, KIND_SURFACE, KIND_NONE, KIND_NONE, KIND_NONE, KIND_NONE];
        assert_eq!(kept(&[], 1), expected, "the first ones");
        let drawn = [(2, KIND_EMISSION), (3, KIND_FOG)];
        let expected = [KIND_NONE, KIND_SURFACE, KIND_NONE, KIND_EMISSION, KIND_FOG, KIND_NONE];
        assert_eq!(kept(&drawn, 2), expected);
        let expected = [KIND_NONE, KIND_SURFACE, KIND_NONE, KIND_EMISSION, KIND_NONE, KIND_NONE];
        assert_eq!(kept(&drawn, 1), expected, "the last of those that were drawn");
        let expected = [KIND_FOG, KIND_SURFACE, KIND_NONE, KIND_EMISSION, KIND_FOG, KIND_NONE];
        assert_eq!(kept(&drawn, 3), expected, "new ones take the slots that are left");
    }
}
