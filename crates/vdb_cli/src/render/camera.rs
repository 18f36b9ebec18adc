//! Cameras as in OpenVDB's `vdb_render`, and where they are if nothing is said.

use glam::{DMat3, DVec2, DVec3, EulerRot};

use super::options::Vector;
use super::ray::Ray;
use super::scene::Scene;

/// The default direction from the middle of the volumes to the camera: that of the viewer.
const DIRECTION: DVec3 = DVec3::new(0.45, 0.35, 0.82);
/// How much of the picture's width or height the box of the volumes takes up at most.
const FILL: f64 = 0.94;

#[derive(clap::Args)]
#[command(next_help_heading = "Camera")]
pub struct CameraArgs {
    /// The projection
    #[arg(long, value_enum, value_name = "KIND", default_value_t = Kind::Perspective)]
    camera: Kind,

    /// The position of the camera in world units; by default one from which all is seen
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    translate: Option<Vector>,

    /// Turn the camera by degrees about x, then y, then z; without a turn it looks along -z
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "lookat")]
    rotate: Option<Vector>,

    /// The point to look at; by default the middle of the volumes
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    lookat: Option<Vector>,

    /// The direction that points up in the picture
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, default_value = "0,1,0")]
    up: Vector,

    /// Perspective: the focal length in mm
    #[arg(long, value_name = "MM", default_value = "50", conflicts_with = "fov")]
    focal: f64,

    /// Perspective: the width of the aperture in mm
    #[arg(long, value_name = "MM", default_value = "41.2136", conflicts_with = "fov")]
    aperture: f64,

    /// Perspective: the horizontal field of view in degrees, instead of both
    #[arg(long, value_name = "DEGREES")]
    fov: Option<f64>,

    /// Ortho: the width of the picture in world units; by default all is seen
    #[arg(long, value_name = "WIDTH")]
    frame: Option<f64>,

    /// Show nothing nearer than this, in world units along the axis of the view
    #[arg(long, value_name = "D", default_value = "0")]
    near: f64,

    /// Show nothing farther than this
    #[arg(long, value_name = "D", default_value = "inf")]
    far: f64,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    Perspective,
    /// Orthographic: parallel rays
    #[value(alias = "orthographic")]
    Ortho,
}

impl CameraArgs {
    /// Checks the options against each other and against their ranges.
    pub fn check(&self) -> Result<(), String> {
        let positive = |name: &str, value: f64| match value > 0.0 && value.is_finite() {
            true => Ok(()),
            false => Err(format!("--{name} is {value}; it must be more than 0")),
        };
        positive("focal", self.focal)?;
        positive("aperture", self.aperture)?;
        if let Some(frame) = self.frame {
            positive("frame", frame)?;
            if self.camera == Kind::Perspective {
                return Err("--frame is for --camera ortho; use --fov".to_owned());
            }
        }
        if let Some(fov) = self.fov {
            if !(fov > 0.0 && fov < 180.0) {
                return Err(format!("--fov is {fov}; it must be between 0 and 180 degrees"));
            }
            if self.camera == Kind::Ortho {
                return Err("--fov is for --camera perspective; use --frame".to_owned());
            }
        }
        if self.up.0.try_normalize().is_none() {
            return Err("--up has no length".to_owned());
        }
        if !(self.near >= 0.0 && self.near.is_finite() && self.far > self.near) {
            let (near, far) = (self.near, self.far);
            return Err(format!(
                "--near is {near} and --far is {far}; the first must be 0 or more, the second larger"
            ));
        }
        Ok(())
    }

    /// The direction that points up in the picture, of unit length.
    pub fn up(&self) -> DVec3 {
        self.up.0.normalize_or(DVec3::Y)
    }
}

/// A camera in world space.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    pub eye: DVec3,
    /// Unit vectors: to the right, up, and away from what is seen.
    pub right: DVec3,
    pub up: DVec3,
    pub back: DVec3,
    projection: Projection,
    /// Depths along the axis of the view.
    near: f64,
    far: f64,
}

#[derive(Clone, Copy, Debug)]
enum Projection {
    /// The tangent of half the horizontal field of view.
    Perspective { tan: f64 },
    /// Half the width in world units.
    Ortho { half_width: f64 },
}

impl Camera {
    /// The camera that the options ask for. `aspect` is the width of the picture divided by its height.
    pub fn new(args: &CameraArgs, scene: &Scene, aspect: f64) -> Self {
        let middle = 0.5 * (scene.bounds[0] + scene.bounds[1]);
        let target = args.lookat.map_or(middle, |at| at.0);
        let turned = args.rotate.map(|Vector(degrees)| {
            let [x, y, z] = degrees.to_array().map(f64::to_radians);
            let turn = DMat3::from_euler(EulerRot::ZYX, z, y, x);
            [turn.x_axis, turn.y_axis, turn.z_axis]
        });
        let up = args.up();
        let axes = |eye: Option<DVec3>| {
            turned.unwrap_or_else(|| {
                looking(eye.map_or_else(|| default_back(up), |eye| eye - target), up)
            })
        };
        let [right, up, back] = axes(args.translate.map(|at| at.0));
        let tan = match args.fov {
            Some(fov) => (0.5 * fov).to_radians().tan(),
            None => 0.5 * args.aperture / args.focal,
        };
        let centered = args.translate.is_none() && args.lookat.is_none();
        let fit = Fit::new(scene, target, [right, up, back], args.camera, tan, aspect);
        let (aside, half_width, distance) = fit.place(centered);
        let projection = match args.camera {
            Kind::Perspective => Projection::Perspective { tan },
            Kind::Ortho => {
                let half_width = args.frame.map_or(half_width, |frame| 0.5 * frame);
                Projection::Ortho { half_width }
            }
        };
        let fitting = target + aside.x * right + aside.y * up + (distance + args.near) * back;
        let eye = args.translate.map_or(fitting, |at| at.0);
        Self { eye, right, up, back, projection, near: args.near, far: args.far }
    }

    /// The ray through a point of the picture, in pixels from its top left corner.
    pub fn ray(&self, pixel: DVec2, size: DVec2) -> Ray {
        let at = (2.0 * pixel - size) / size.x * DVec2::new(1.0, -1.0);
        let beside = at.x * self.right + at.y * self.up;
        let (origin, dir) = match self.projection {
            Projection::Perspective { tan } => (self.eye, tan * beside - self.back),
            Projection::Ortho { half_width } => (self.eye + half_width * beside, -self.back),
        };
        // `dir` is one unit of depth long along the axis.
        let stretch = dir.length();
        let (origin, dir) = (origin + self.near * dir, dir / stretch);
        Ray { origin, dir, t_max: (self.far - self.near) * stretch }
    }
}

/// What a camera must be placed for: maxima over all points that it shows, relative to its target.
struct Fit {
    kind: Kind,
    tan: f64,
    aspect: f64,
    /// To the right, to the left, up and down: in perspective, the distance at which a point is at this
    /// edge of the picture; otherwise half the width of a picture with the point at this edge.
    edges: [f64; 4],
    /// Towards the camera.
    nearest: f64,
    /// The diagonal of the box around everything.
    size: f64,
}

impl Fit {
    fn new(
        scene: &Scene,
        target: DVec3,
        axes: [DVec3; 3],
        kind: Kind,
        tan: f64,
        aspect: f64,
    ) -> Self {
        let (mut edges, mut nearest) = ([f64::NEG_INFINITY; 4], f64::NEG_INFINITY);
        scene.visit_corners(|corner| {
            let [x, y, z] = axes.map(|axis| axis.dot(corner - target));
            for (edge, beside) in edges.iter_mut().zip([x, -x, aspect * y, -aspect * y]) {
                *edge = edge.max(match kind {
                    Kind::Perspective => z + beside / (FILL * tan),
                    Kind::Ortho => beside / FILL,
                });
            }
            nearest = nearest.max(z);
        });
        let size = scene.bounds[0].distance(scene.bounds[1]);
        Self { kind, tan, aspect, edges, nearest, size }
    }

    /// The shift of the camera to the right and up, half the width of the picture, and the distance. A
    /// camera that is not `centered` looks at its target.
    fn place(&self, centered: bool) -> (DVec2, f64, f64) {
        let [right, left, up, down] = self.edges;
        let (mut reach, mut aside) = (right.max(left).max(up).max(down), DVec2::ZERO);
        let width = match self.kind {
            Kind::Perspective => FILL * self.tan,
            Kind::Ortho => FILL,
        };
        if centered {
            reach = (0.5 * (right + left)).max(0.5 * (up + down));
            aside = 0.5 * width * DVec2::new(right - left, (up - down) / self.aspect);
        }
        let least = 1e-3 * self.size;
        let distance = match self.kind {
            Kind::Perspective => reach.max(self.nearest + least),
            Kind::Ortho => self.nearest + 0.1 * self.size,
        };
        (aside, reach.max(least), distance)
    }
}

/// [`DIRECTION`], turned so that y becomes `up`.
fn default_back(up: DVec3) -> DVec3 {
    glam::DQuat::from_rotation_arc(DVec3::Y, up) * DIRECTION
}

/// Axes of a camera: right, up and back.
fn looking(back: DVec3, up: DVec3) -> [DVec3; 3] {
    let back = back.normalize_or(DVec3::Z);
    // A camera that looks along the direction that should point up turns the axis after it upwards.
    let spare = [DVec3::NEG_Z, DVec3::X];
    let ups = std::iter::once(up).chain(spare);
    let rights = ups.map(|up| up.cross(back));
    let right = rights.into_iter().find(|right| right.length() > 1e-6);
    let right = right.unwrap_or(DVec3::X).normalize();
    [right, back.cross(right), back]
}
