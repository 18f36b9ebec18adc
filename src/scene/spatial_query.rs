//! Ray casts and point samples against the volumes of an app, on the CPU.

use bevy::ecs::system::SystemParam;
use bevy::math::{DAffine3, DVec3};
use bevy::prelude::*;
use vdb_core::pack::PackKind;
use vdb_core::query::{GridQuery, IndexRay};

use super::clip::{ClipPlane, ClippedPart};
use super::components::Page;
use super::player::NextFrame;
use crate::{VdbClipPlane, VdbClippedBy, VdbGrid, VdbMaterial, VdbVolume};

/// Casts rays against [`VdbVolume`]s and samples their values. Hits agree with the rendered image:
/// the visible voxel and face, the root of the trilinear interpolant on a smooth surface, or the
/// point in fog where a given fraction of the light is lost.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::{VdbRayCastSettings, VdbSpatialQuery};
/// fn below(volumes: VdbSpatialQuery) {
///     let ray = Ray3d::new(Vec3::new(0.0, 10.0, 0.0), Dir3::NEG_Y);
///     let settings = VdbRayCastSettings { max_distance: 20.0, ..default() };
///     if let Some(hit) = volumes.cast_ray_nearest(ray, &settings) {
///         println!("voxel {} of {}, {} below", hit.voxel, hit.entity, hit.distance);
///     }
/// }
/// ```
///
/// Volumes are placed by their [`GlobalTransform`], which is that of the last frame in systems
/// before `TransformSystems::Propagate`. As in the image, volumes are skipped if their grid is not
/// loaded or their transform cannot be inverted.
///
/// A ray takes as many steps as on the GPU: at most 3 · 4096 through each 4096³ node on its way,
/// and usually a few dozen, regardless of its length and the grid's position
/// ([`GridQuery::first_hit`](vdb_core::query::GridQuery::first_hit) states the bound). The nearest
/// hit among several volumes takes one traversal per volume whose box the ray crosses. Queries use
/// [`VdbGrid::tree`] and [`VdbGrid::packed`], and need no additional memory.
#[derive(SystemParam)]
pub struct VdbSpatialQuery<'w, 's> {
    grids: Res<'w, Assets<VdbGrid>>,
    volumes: Query<
        'w,
        's,
        (
            Entity,
            &'static VdbVolume,
            &'static VdbMaterial,
            &'static GlobalTransform,
            &'static InheritedVisibility,
            &'static ViewVisibility,
            Has<Page>,
            Option<&'static VdbClippedBy>,
        ),
        // What fades in belongs to the frame that is shown.
        Without<NextFrame>,
    >,
    planes: Query<'w, 's, &'static GlobalTransform, With<VdbClipPlane>>,
}

/// A hit: see [`VdbSpatialQuery::cast_ray`].
#[derive(Clone, Debug, PartialEq)]
pub struct VdbRayHit {
    /// The volume.
    pub entity: Entity,
    /// The point, in world space.
    pub position: Vec3,
    /// The outward unit normal, in world space: of the voxel face through which the ray enters, or
    /// along the trilinear gradient of a smooth surface or fog (shading may use a different normal,
    /// see [`VdbQuality::smooth_normals`](crate::VdbQuality::smooth_normals)), or of the
    /// [`VdbClipPlane`](crate::VdbClipPlane) that cuts the volume open there. Where there is no
    /// normal, because the ray begins in a voxel or the gradient is zero, the direction opposite to
    /// the ray.
    pub normal: Vec3,
    /// The distance from the ray's origin, in world units.
    pub distance: f32,
    /// The voxel in the grid's index space: the one that the ray enters, or the one around the
    /// point on a smooth surface or in fog.
    pub voxel: IVec3,
    /// The value of that voxel. `None` for a cooked voxel surface, which has no values.
    pub value: Option<f32>,
    /// Whether the ray begins in a solid voxel; `distance` is then 0. Always `false` for smooth
    /// surfaces and fog: see [`VdbSpatialQuery::contains`].
    pub begins_inside: bool,
}

/// The length of a ray, and the volumes that it can hit.
#[derive(Clone, Copy)]
pub struct VdbRayCastSettings<'a> {
    /// The length of the ray, in world units. 0 or more; infinite by default.
    pub max_distance: f32,
    /// The optical depth from the ray's origin at which fog counts as hit: 0 where fog begins,
    /// `-ln(transmittance)` elsewhere, infinity to ignore fog. `ln 2` by default, where half the
    /// light is left. Each fog volume counts separately.
    pub optical_depth: f32,
    /// Whether hidden volumes can be hit. [`VdbRayVisibility::Visible`] by default.
    pub visibility: VdbRayVisibility,
    /// Selects volumes. All by default.
    pub filter: &'a dyn Fn(Entity) -> bool,
}

impl Default for VdbRayCastSettings<'_> {
    fn default() -> Self {
        Self {
            max_distance: f32::INFINITY,
            optical_depth: std::f32::consts::LN_2,
            visibility: VdbRayVisibility::default(),
            filter: &|_| true,
        }
    }
}

/// Selects volumes by visibility.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Clone, Debug, Default, PartialEq, Hash)]
#[non_exhaustive]
pub enum VdbRayVisibility {
    /// All volumes, hidden or not, except the pages of a [`VdbPagedVolume`](crate::VdbPagedVolume)
    /// that are not displayed: all of them if it is hidden.
    Any,
    /// Volumes that [`Visibility`] does not hide, whether or not a camera sees them.
    #[default]
    Visible,
    /// Volumes that a camera saw in the last frame.
    VisibleInView,
}

impl VdbSpatialQuery<'_, '_> {
    /// The first hit of a ray in each volume, nearest first. Volumes do not occlude each other.
    pub fn cast_ray(&self, ray: Ray3d, settings: &VdbRayCastSettings) -> Vec<VdbRayHit> {
        let mut hits: Vec<VdbRayHit> =
            self.cast(ray, settings).filter_map(|cast| cast(settings.max_distance)).collect();
        hits.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.entity.cmp(&b.entity)));
        hits
    }

    /// The first hit of a ray in any volume.
    pub fn cast_ray_nearest(&self, ray: Ray3d, settings: &VdbRayCastSettings) -> Option<VdbRayHit> {
        let mut nearest: Option<VdbRayHit> = None;
        for cast in self.cast(ray, settings) {
            let most = nearest.as_ref().map_or(settings.max_distance, |hit| hit.distance);
            let farther = |hit: &VdbRayHit| {
                nearest.as_ref().is_some_and(|nearest| {
                    (nearest.distance, nearest.entity) < (hit.distance, hit.entity)
                })
            };
            if let Some(hit) = cast(most).filter(|hit| !farther(hit)) {
                nearest = Some(hit);
            }
        }
        nearest
    }

    /// For each selected volume, a function that casts the ray up to a given distance.
    fn cast(
        &self,
        ray: Ray3d,
        settings: &VdbRayCastSettings,
    ) -> impl Iterator<Item = impl Fn(f32) -> Option<VdbRayHit>> {
        self.volumes
            .iter()
            .filter(|(entity, .., inherited, in_view, is_page, _)| {
                let visible = match settings.visibility {
                    VdbRayVisibility::Any => !is_page || inherited.get(),
                    VdbRayVisibility::Visible => inherited.get(),
                    VdbRayVisibility::VisibleInView => in_view.get(),
                };
                visible && (settings.filter)(*entity)
            })
            .filter_map(move |(entity, volume, material, transform, .., by)| {
                let planes = self.planes(by);
                let placed = Placed::new(self.grids.get(&volume.0)?, transform, planes)?;
                // Infinite where the fog has no extinction.
                let enough =
                    f64::from(settings.optical_depth) / f64::from(material.density_scale.max(0.0));
                Some(move |most| placed.cast(entity, ray, most, enough))
            })
    }

    /// The value of the voxel around a point in world space. `None` if the entity shows no grid,
    /// or if its grid is a cooked surface without a value there.
    pub fn nearest(&self, entity: Entity, place: Vec3) -> Option<f32> {
        let placed = self.placed(entity)?;
        placed.query().nearest(placed.index(place))
    }

    /// The trilinear interpolant at a point in world space. `None` if the entity shows no grid, or
    /// if its grid is a cooked surface without a value there.
    pub fn trilinear(&self, entity: Entity, place: Vec3) -> Option<f32> {
        let placed = self.placed(entity)?;
        placed.query().trilinear(placed.index(place))
    }

    /// Whether a point in world space is in a solid voxel, inside a smooth surface, or in fog;
    /// `false` if the entity shows no grid, or if a clip plane cuts the point away.
    pub fn contains(&self, entity: Entity, place: Vec3) -> bool {
        self.placed(entity).is_some_and(|placed| {
            let is_kept = |plane: &ClipPlane| plane.distance(place.as_dvec3()) >= 0.0;
            placed.planes.iter().all(is_kept) && placed.query().contains(placed.index(place))
        })
    }

    /// The transform from the index space of an entity's grid, whose voxel `ijk` is the unit cube
    /// around the point `(i, j, k)`, to world space; `None` if the entity shows no grid.
    pub fn world_from_index(&self, entity: Entity) -> Option<DAffine3> {
        self.placed(entity).map(|placed| placed.world_from_index)
    }

    fn placed(&self, entity: Entity) -> Option<Placed<'_>> {
        let (_, volume, _, transform, .., by) = self.volumes.get(entity).ok()?;
        Placed::new(self.grids.get(&volume.0)?, transform, self.planes(by))
    }

    /// The planes that cut a volume.
    fn planes(&self, by: Option<&VdbClippedBy>) -> Vec<ClipPlane> {
        let entities = by.into_iter().flat_map(|by| &by.0);
        let transforms = entities.filter_map(|plane| self.planes.get(*plane).ok());
        transforms.filter_map(ClipPlane::new).collect()
    }
}

/// A grid placed in the world.
struct Placed<'a> {
    grid: &'a VdbGrid,
    world_from_index: DAffine3,
    index_from_world: DAffine3,
    planes: Vec<ClipPlane>,
}

impl<'a> Placed<'a> {
    fn new(grid: &'a VdbGrid, transform: &GlobalTransform, planes: Vec<ClipPlane>) -> Option<Self> {
        let world_from_index = transform.affine().as_daffine3() * grid.world_from_index();
        let index_from_world = world_from_index.inverse();
        index_from_world.is_finite().then_some(Self {
            grid,
            world_from_index,
            index_from_world,
            planes,
        })
    }

    fn query(&self) -> GridQuery<'a> {
        match self.grid.tree() {
            Some(tree) => GridQuery::new(tree, self.grid.packed()),
            None => GridQuery::of_packed(self.grid.packed()),
        }
    }

    fn index(&self, place: Vec3) -> DVec3 {
        self.index_from_world.transform_point3(place.as_dvec3())
    }

    fn cast(&self, entity: Entity, ray: Ray3d, most: f32, enough: f64) -> Option<VdbRayHit> {
        let (origin, dir) = (ray.origin.as_dvec3(), ray.direction.as_dvec3().normalize());
        let part = ClippedPart::new(self.planes.iter().copied(), (origin, dir, most.into()))?;
        let start = origin + part.t_first * dir;
        let hit = |t: f64, voxel: IVec3, normal: DVec3, begins_inside| VdbRayHit {
            entity,
            position: (origin + t * dir).as_vec3(),
            normal: normal.try_normalize().unwrap_or(-dir).as_vec3(),
            distance: t as f32,
            voxel,
            value: match self.grid.tree() {
                Some(tree) => Some(tree.get(voxel)),
                None => self.query().nearest(voxel.as_dvec3()),
            },
            begins_inside,
        };
        let index_ray = IndexRay {
            origin: self.index_from_world.transform_point3(start),
            dir: self.index_from_world.transform_vector3(dir),
            t_max: part.t_last - part.t_first,
        };
        let is_smooth = matches!(self.grid.kind(), PackKind::Smooth { .. });
        if let Some(plane) = part.plane
            && is_smooth
            && self.query().contains(index_ray.origin)
        {
            let voxel = (index_ray.origin + 0.5).floor().as_ivec3();
            return Some(hit(part.t_first, voxel, -plane.kept, false));
        }
        let found = self.query().first_hit(&index_ray, enough)?;
        if let Some(plane) = part.plane.filter(|_| found.begins_inside) {
            return Some(hit(part.t_first, found.ijk, -plane.kept, false));
        }
        let normal = self.index_from_world.matrix3.transpose() * found.normal;
        Some(hit(part.t_first + found.t, found.ijk, normal, found.begins_inside))
    }
}
