//! Media, which are fogs and emission grids, and the slots that shaders with the light cache have
//! for them.

use bevy::platform::collections::HashSet;
use bevy::render::sync_world::MainEntity;

use crate::render::gpu::types;

/// The most fogs, and the most emission grids, that shaders march together; rays that meet more are
/// divided into slabs.
pub(super) const MAX_SLOTS: u32 = 8;

/// The media that shaders march together. Each kind has its own slots, whose code is for that kind alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct MediaSlots {
    pub fogs: u32,
    pub emitters: u32,
}

impl MediaSlots {
    /// Slots for these media, rounded up to a few sizes, because each is a shader variant. Shaders without emission
    /// have no slots for it, and those with it have one at least.
    pub fn for_media(media: Self, has_emission: bool) -> Self {
        let round = |count: u32| count.next_power_of_two().min(MAX_SLOTS);
        Self {
            fogs: round(media.fogs),
            emitters: if has_emission { round(media.emitters) } else { 0 },
        }
    }

    /// Whether a ray may meet more media than can have slots.
    pub fn is_too_much(self) -> bool {
        self.fogs > MAX_SLOTS || self.emitters > MAX_SLOTS
    }

    /// Counts the entries of these kinds.
    pub fn count(kinds: impl Iterator<Item = u32>) -> Self {
        kinds.filter(|kind| is_medium(*kind)).fold(Self::default(), |mut all, kind| {
            *all.of(kind) += 1;
            all
        })
    }

    fn of(&mut self, kind: u32) -> &mut u32 {
        if kind == types::KIND_FOG { &mut self.fogs } else { &mut self.emitters }
    }
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
    mut slots: MediaSlots,
) {
    let mut media: Vec<_> = entries.filter(|(_, volume)| is_medium(volume.kind)).collect();
    media.sort_by_key(|(owner, volume)| !drawn.contains(&(*owner, volume.kind)));
    for (_, volume) in media {
        match slots.of(volume.kind) {
            0 => volume.kind = types::KIND_NONE,
            left => *left -= 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use bevy::ecs::entity::Entity;

    use super::*;
    use types::{KIND_BLACKBODY, KIND_EMISSION, KIND_FOG, KIND_NONE, KIND_SURFACE};

    fn slots(fogs: u32, emitters: u32) -> MediaSlots {
        MediaSlots { fogs, emitters }
    }

    #[test]
    fn slots_come_in_few_sizes() {
        let of = |count| MediaSlots::for_media(slots(count, count), true);
        assert_eq!([0, 1, 2, 3, 4, 5, 8, 9].map(of), [1, 1, 2, 4, 4, 8, 8, 8].map(|n| slots(n, n)));
        assert_eq!(MediaSlots::for_media(slots(3, 0), false), slots(4, 0));
        assert!(slots(9, 0).is_too_much() && slots(0, 9).is_too_much());
        assert!(!slots(8, 8).is_too_much());
        let kinds = [KIND_FOG, KIND_SURFACE, KIND_BLACKBODY, KIND_EMISSION, KIND_NONE];
        assert_eq!(MediaSlots::count(kinds.into_iter()), slots(1, 2));
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
            (3, KIND_EMISSION),
            (4, KIND_NONE),
        ];
        // The entries that are kept, by their index.
        let kept = |drawn: &[(u32, u32)], slots| {
            let drawn = drawn.iter().map(|(i, kind)| (owner(*i), *kind)).collect();
            let mut volumes = list.map(|(_, kind)| types::Volume { kind, ..Default::default() });
            let owners = list.map(|(i, _)| owner(i));
            hide_surplus(owners.into_iter().zip(&mut volumes), &drawn, slots);
            let media = volumes.iter().enumerate().filter(|(_, volume)| is_medium(volume.kind));
            assert_eq!(volumes[1].kind, KIND_SURFACE);
            media.map(|(i, _)| i).collect::<Vec<_>>()
        };
        assert_eq!(kept(&[], slots(4, 2)), [0, 2, 3, 4, 5]);
        assert_eq!(kept(&[], slots(1, 1)), [0, 3], "the first ones");
        assert_eq!(kept(&[], slots(8, 0)), [0, 2, 4], "without emission");
        let drawn = [(2, KIND_FOG), (3, KIND_FOG), (3, KIND_EMISSION)];
        assert_eq!(kept(&drawn, slots(2, 1)), [2, 4, 5]);
        assert_eq!(kept(&drawn, slots(1, 1)), [2, 5], "the last of those that were drawn");
        assert_eq!(kept(&drawn[1..], slots(2, 2)), [0, 3, 4, 5], "new ones take what is left");
    }
}
