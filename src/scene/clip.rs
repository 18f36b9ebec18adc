//! Clip planes, which cut volumes.

use bevy::math::DVec3;
use bevy::prelude::*;

/// A plane that cuts the volumes that list it in their [`VdbClippedBy`].
///
/// The plane goes through the entity's position. What is on the side that its local y axis points to is cut away,
/// as it is above a [`Plane3d`] with its default normal. To cut a volume in the same place however it is moved, make
/// the plane a child of the volume.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_vdb::prelude::*;
/// # fn setup(mut commands: Commands, assets: Res<AssetServer>) {
/// // Shows the half of a scan that is below y = 1.
/// let plane = commands.spawn((VdbClipPlane, Transform::from_xyz(0.0, 1.0, 0.0))).id();
/// let scan = VdbVolume(assets.load("scan.vdb"));
/// commands.spawn((scan, VdbClippedBy(vec![plane])));
/// # }
/// ```
#[derive(Clone, Copy, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(Transform)]
pub struct VdbClipPlane;

/// The [`VdbClipPlane`]s that cut a volume. Only the part on the kept side of every plane remains, so planes can bound
/// a slice or a box.
///
/// The solid inside a smooth surface is cut open: it gets a flat face with the material of the volume. Voxels and fog
/// end at the plane. What is cut away casts no shadow, is not reflected and does not shine; only the lights of a
/// [`VdbEmissionLight`](crate::VdbEmissionLight) remain those of the whole fire. Ray casts and
/// [`VdbSpatialQuery::contains`](crate::VdbSpatialQuery::contains) ignore it; point samples still return its values.
///
/// At most 32 planes can cut all visible volumes together. Beyond that, the image ignores some, and
/// a warning names the volumes; ray casts obey all. Entities without a [`VdbClipPlane`] are ignored. A
/// [`VdbPagedVolume`](crate::VdbPagedVolume) cannot be cut, because it has no pages inside the solid.
#[derive(Clone, Component, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
pub struct VdbClippedBy(#[entities] pub Vec<Entity>);

/// The half of space that a clip plane leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClipPlane {
    /// A point on the plane, in world space.
    pub point: DVec3,
    /// The unit normal on the side that is kept.
    pub kept: DVec3,
}

impl ClipPlane {
    /// The plane of an entity; `None` if its transform is singular.
    pub fn new(transform: &GlobalTransform) -> Option<Self> {
        let affine = transform.affine().as_daffine3();
        let axes = affine.matrix3;
        let normal = axes.z_axis.cross(axes.x_axis).try_normalize()?;
        let kept = if normal.dot(axes.y_axis) > 0.0 { -normal } else { normal };
        affine.translation.is_finite().then_some(Self { point: affine.translation, kept })
    }

    /// The distance of a point on the side that is kept; negative on the other one.
    pub fn distance(&self, point: DVec3) -> f64 {
        self.kept.dot(point - self.point)
    }
}

/// The part of a ray that clip planes leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClippedPart {
    pub t_first: f64,
    pub t_last: f64,
    /// The plane at `t_first`, unless the ray begins there.
    pub plane: Option<ClipPlane>,
}

impl ClippedPart {
    /// The part of `origin + t · dir` for `t` from 0 to `t_max`; `None` if nothing is left.
    pub fn new(
        planes: impl IntoIterator<Item = ClipPlane>,
        (origin, dir, t_max): (DVec3, DVec3, f64),
    ) -> Option<Self> {
        let mut part = Self { t_first: 0.0, t_last: t_max, plane: None };
        for plane in planes {
            let (distance, slope) = (plane.distance(origin), plane.kept.dot(dir));
            let t = -distance / slope;
            if slope < 0.0 {
                part.t_last = part.t_last.min(t);
            } else if slope > 0.0 && t > part.t_first {
                (part.t_first, part.plane) = (t, Some(plane));
            } else if slope == 0.0 && distance < 0.0 {
                return None;
            }
        }
        (part.t_first <= part.t_last).then_some(part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_side_of_the_y_axis_is_cut_away_however_a_plane_is_scaled() {
        for scale in [Vec3::ONE, Vec3::new(-1.0, 1.0, 1.0), Vec3::new(2.0, 0.5, -3.0)] {
            let turn = Quat::from_rotation_z(0.5);
            let transform =
                Transform::from_xyz(1.0, 2.0, 3.0).with_rotation(turn).with_scale(scale);
            let plane = ClipPlane::new(&transform.into()).unwrap();
            assert!((plane.kept + (turn * Vec3::Y).as_dvec3()).length() < 1e-6, "{scale}");
            let above = transform.transform_point(Vec3::new(0.3, 0.1, -0.7));
            assert!(plane.distance(above.as_dvec3()) < 0.0, "{scale}");
        }
        assert_eq!(ClipPlane::new(&Transform::from_scale(Vec3::ZERO).into()), None);
    }

    #[test]
    fn a_slice_leaves_a_part_of_a_ray() {
        let plane = |y: f64, kept| ClipPlane { point: DVec3::new(5.0, y, 7.0), kept };
        let slice = [plane(1.0, DVec3::Y), plane(3.0, DVec3::NEG_Y)];
        let part = |origin, dir| ClippedPart::new(slice, (origin, dir, 10.0));
        let up = part(DVec3::ZERO, DVec3::Y).unwrap();
        assert_eq!((up.t_first, up.t_last, up.plane), (1.0, 3.0, Some(slice[0])));
        let inside = part(DVec3::Y * 2.0, DVec3::Y).unwrap();
        assert_eq!((inside.t_first, inside.t_last, inside.plane), (0.0, 1.0, None));
        assert_eq!(part(DVec3::ZERO, DVec3::X), None);
        assert_eq!(part(DVec3::ZERO, DVec3::NEG_Y), None);
        assert_eq!(part(DVec3::Y * 20.0, DVec3::NEG_Y), None);
        assert_eq!(part(DVec3::Y * 2.0, DVec3::X).unwrap().t_last, 10.0);
    }
}
