//! Fire that lights its surroundings.
//!
//! [`summary`] reduces each pair of grids, fire and smoke, to the data that its light depends on:
//! in the background, once per change, and ahead of a player. [`update`] turns the data into point
//! lights, in each frame in which the fire, the smoke or the volume has changed.

mod component;
mod summary;
mod update;

use bevy::asset::AssetEventSystems;
use bevy::prelude::*;
use bevy::render::RenderApp;

pub use component::VdbEmissionLight;
use summary::Summaries;
pub(crate) use update::FireLight;

use crate::VdbPlayerSystems;

/// Spawns and updates the lights of fires.
pub(super) struct EmissionLightPlugin;

impl Plugin for EmissionLightPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<VdbEmissionLight>();
        // Nothing is lit, and Bevy's lights may not be spawned then.
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        let lights = any_with_component::<FireLight>;
        let burns = any_with_component::<VdbEmissionLight>.or_else(lights);
        app.init_resource::<Summaries>().add_systems(
            PostUpdate,
            (
                (update::follow_grids, update::look_ahead, update::update_lights)
                    .chain()
                    .run_if(burns),
                update::clear.run_if(not(any_with_component::<VdbEmissionLight>)),
            )
                .chain()
                .after(AssetEventSystems)
                .after(VdbPlayerSystems)
                .before(TransformSystems::Propagate),
        );
    }
}
