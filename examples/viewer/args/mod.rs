//! The command line.

mod values;

use std::fmt;
use std::path::PathBuf;

use bevy::math::{DVec3, UVec2};
use bevy_vdb::{VdbOverlays, VdbRenderMode};
use lexopt::Arg;

use values::{
    NODES, absolute, density, direction, fov, frame_number, heat, mode, name, overlays,
    picture_path, point, size, surface, value,
};

pub const HELP: &str = "\
Displays OpenVDB files: level sets as surfaces, fog volumes as fog. Plays sequences of them, and shows
level sets in pages.

Usage: viewer [FILE.vdb | FOLDER | 'fire_####.vdb' | FILE.vdbseq | FILE.vdbpages …] [options]

With a display, opens a window: drop files or a folder onto it, or press F1 for a list of keys.
Without a display, or with --out, writes a PNG. Without FILE, shows the model bundled with bevy_vdb.

  --grid NAME       show this grid; may be repeated, and hides all others. By default, all level
                    sets and the fog `density` are shown, with fire and colours found by name
  --surface NAME[=ISO]
                    show a grid as a surface, regardless of its class [0]
  --fog NAME        show a grid as fog
  --fire NAME       the grid that emits light in the fog: temperatures or colours
  --heat K,OFFSET   temperatures in kelvin: K times the value plus OFFSET
  --glow X          the brightness of the fire: the strength of its emission
  --no-fire         no emission
  --colors NAME     the vector grid that colours surfaces
  --no-colors       no colours from grids
  --frame N         show this frame of a sequence, paused [the first one, playing]
  --out FILE.png    write an image and print its path [without a display: viewer.png]
  --size WxH        the size of the image or the window, in pixels [1280x720]
  --eye X,Y,Z       the position of the camera in the file's world [everything in view]
  --target X,Y,Z    the point that the camera looks at [the middle of everything]
  --fov DEGREES     the vertical field of view [45]
  --mode NAME       lit, its parts diffuse and glossy, gray, rgb, voxels, normals, depth, steps (of
                    the traversal), or maximum (of fog) [lit]
  --density X       fog: extinction per unit of density and world unit [1]
  --sun X,Y,Z       the direction towards the sun [-0.6,0.75,0.5]
  --no-shadows      the sun casts no shadows
  --scatter-once    no multiple scattering in fog, as with --cpu
  --borders NAMES   the borders of tree nodes on surfaces: leaves, lower, upper, comma-separated
  --voxels          show level sets voxel by voxel rather than smooth
  --ground          add a plane below and a ball beside the volumes, both meshes
  --no-panel        open the window without the panel (F2 toggles it)
  --cpu             trace on the CPU, slowly, without a GPU; writes an image
  -h, --help        print this help
";

/// The options of the viewer.
#[derive(Clone, Debug, PartialEq)]
pub struct Args {
    /// Absolute paths, at least one.
    pub files: Vec<PathBuf>,
    /// The names of the grids to show; empty for a selection by class and name.
    pub grids: Vec<String>,
    /// Grids shown differently from their class.
    pub kinds: Vec<(String, Shown)>,
    pub fire: Part,
    /// Kelvin per unit, and kelvin at 0; guessed from the grid's name and values by default.
    pub heat: Option<[f32; 2]>,
    pub glow: Option<f32>,
    pub colors: Part,
    /// The number of the frame at which sequences are paused.
    pub frame: Option<u64>,
    pub out: Option<PathBuf>,
    pub size: UVec2,
    pub eye: Option<DVec3>,
    pub target: Option<DVec3>,
    /// The vertical field of view in radians.
    pub fov_y: f64,
    pub mode: VdbRenderMode,
    pub density: f32,
    /// The direction towards the sun; finite and not zero.
    pub sun: DVec3,
    pub shadows: bool,
    pub scatters_again: bool,
    pub overlays: VdbOverlays,
    pub smooth: bool,
    pub ground: bool,
    pub panel: bool,
    pub cpu: bool,
}

/// The grid for a role: fire or colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Part {
    /// Chosen by name; no grid if the grids to show are named.
    #[default]
    ByName,
    Nothing,
    Named(String),
}

/// Fog or surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shown {
    Fog,
    Surface { iso: f32 },
}

impl Args {
    /// The options for other files, without those about grids, frames and the camera.
    pub fn of_other_files(&self, files: Vec<PathBuf>) -> Self {
        let Self { grids, kinds, fire, heat, glow, colors, frame, eye, target, .. } =
            Self::default();
        Self { files, grids, kinds, fire, heat, glow, colors, frame, eye, target, ..self.clone() }
    }

    /// The names of the grids to load; empty for all.
    pub fn loaded(&self) -> Vec<String> {
        let roles = [&self.fire, &self.colors].into_iter().filter_map(|role| match role {
            Part::Named(name) => Some(name),
            _ => None,
        });
        let all = self.grids.iter().chain(roles.filter(|_| !self.grids.is_empty()));
        all.cloned().collect()
    }

    /// Parses the command line; `None` if help is requested.
    pub fn from_command_line() -> Result<Option<Self>, String> {
        Self::parse(lexopt::Parser::from_env())
    }

    pub fn parse(mut parser: lexopt::Parser) -> Result<Option<Self>, String> {
        let mut args = Self::default();
        while let Some(arg) = parser.next().map_err(|error| error.to_string())? {
            match arg {
                Arg::Short('h') | Arg::Long("help") => return Ok(None),
                Arg::Long("grid") => args.grids.push(value(&mut parser, "--grid", name)?),
                Arg::Long("surface") => {
                    let (name, iso) = value(&mut parser, "--surface", surface)?;
                    args.kinds.push((name, Shown::Surface { iso }));
                }
                Arg::Long("fog") => {
                    args.kinds.push((value(&mut parser, "--fog", name)?, Shown::Fog));
                }
                Arg::Long("fire") => {
                    args.fire = Part::Named(value(&mut parser, "--fire", name)?);
                }
                Arg::Long("no-fire") => args.fire = Part::Nothing,
                Arg::Long("heat") => args.heat = Some(value(&mut parser, "--heat", heat)?),
                Arg::Long("glow") => args.glow = Some(value(&mut parser, "--glow", density)?),
                Arg::Long("colors") => {
                    args.colors = Part::Named(value(&mut parser, "--colors", name)?);
                }
                Arg::Long("no-colors") => args.colors = Part::Nothing,
                Arg::Long("frame") => {
                    args.frame = Some(value(&mut parser, "--frame", frame_number)?);
                }
                Arg::Long("out") => args.out = Some(value(&mut parser, "--out", picture_path)?),
                Arg::Long("size") => args.size = value(&mut parser, "--size", size)?,
                Arg::Long("eye") => args.eye = Some(value(&mut parser, "--eye", point)?),
                Arg::Long("target") => args.target = Some(value(&mut parser, "--target", point)?),
                Arg::Long("fov") => args.fov_y = value(&mut parser, "--fov", fov)?,
                Arg::Long("mode") => args.mode = value(&mut parser, "--mode", mode)?,
                Arg::Long("density") => args.density = value(&mut parser, "--density", density)?,
                Arg::Long("sun") => args.sun = value(&mut parser, "--sun", direction)?,
                Arg::Long("no-shadows") => args.shadows = false,
                Arg::Long("scatter-once") => args.scatters_again = false,
                Arg::Long("borders") => {
                    args.overlays = value(&mut parser, "--borders", overlays)?;
                }
                Arg::Long("no-panel") => args.panel = false,
                Arg::Long("ground") => args.ground = true,
                Arg::Long("voxels") => args.smooth = false,
                Arg::Long("cpu") => args.cpu = true,
                Arg::Value(file) => args.files.push(absolute(file)?),
                other => return Err(other.unexpected().to_string()),
            }
        }
        if args.files.is_empty() {
            args.files.push(bundled());
        }
        if args.eye.is_some() && args.eye == args.target {
            return Err("--eye and --target are the same point".into());
        }
        Ok(Some(args))
    }
}

impl Default for Args {
    fn default() -> Self {
        Self {
            files: Vec::new(),
            grids: Vec::new(),
            kinds: Vec::new(),
            fire: Part::ByName,
            heat: None,
            glow: None,
            colors: Part::ByName,
            frame: None,
            out: None,
            size: UVec2::new(1280, 720),
            eye: None,
            target: None,
            fov_y: 45_f64.to_radians(),
            mode: VdbRenderMode::Lit,
            density: 1.0,
            // Over the left shoulder of the default camera.
            sun: DVec3::new(-0.6, 0.75, 0.5),
            shadows: true,
            scatters_again: true,
            overlays: VdbOverlays::default(),
            smooth: true,
            ground: false,
            panel: true,
            cpu: false,
        }
    }
}

impl fmt::Display for Args {
    /// Writes the options that differ from the defaults as a shell command line, without the name
    /// of the program.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let default = Self::default();
        let mut words: Vec<String> =
            self.files.iter().map(|file| quoted(&file.to_string_lossy())).collect();
        let mut option = |name: &str, value: Option<String>| {
            words.push(format!("--{name}"));
            words.extend(value);
        };
        let point = |p: DVec3| Some(format!("{},{},{}", p.x, p.y, p.z));
        self.grids.iter().for_each(|name| option("grid", Some(quoted(name))));
        for (name, shown) in &self.kinds {
            match shown {
                Shown::Fog => option("fog", Some(quoted(name))),
                Shown::Surface { iso } => option("surface", Some(quoted(&format!("{name}={iso}")))),
            }
        }
        for (role, is, nothing) in
            [(&self.fire, "fire", "no-fire"), (&self.colors, "colors", "no-colors")]
        {
            match role {
                Part::ByName => {}
                Part::Nothing => option(nothing, None),
                Part::Named(name) => option(is, Some(quoted(name))),
            }
        }
        if let Some([scale, offset]) = self.heat {
            option("heat", Some(format!("{scale},{offset}")));
        }
        if let Some(glow) = self.glow {
            option("glow", Some(glow.to_string()));
        }
        if let Some(frame) = self.frame {
            option("frame", Some(frame.to_string()));
        }
        if let Some(out) = &self.out {
            option("out", Some(quoted(&out.to_string_lossy())));
        }
        if self.size != default.size {
            option("size", Some(format!("{}x{}", self.size.x, self.size.y)));
        }
        if let Some(eye) = self.eye {
            option("eye", point(eye));
        }
        if let Some(target) = self.target {
            option("target", point(target));
        }
        if self.fov_y != default.fov_y {
            option("fov", Some(self.fov_y.to_degrees().to_string()));
        }
        if self.mode != default.mode {
            option("mode", Some(self.mode.name().into()));
        }
        if self.density != default.density {
            option("density", Some(self.density.to_string()));
        }
        if self.sun != default.sun {
            option("sun", point(self.sun));
        }
        if self.overlays != default.overlays {
            let nodes = NODES.iter().filter(|(_, has)| *has(&mut self.overlays.clone()));
            let names: Vec<&str> = nodes.map(|(name, _)| *name).collect();
            option("borders", Some(names.join(",")));
        }
        let flags = [
            ("no-shadows", !self.shadows),
            ("scatter-once", !self.scatters_again),
            ("voxels", !self.smooth),
            ("ground", self.ground),
            ("no-panel", !self.panel),
            ("cpu", self.cpu),
        ];
        flags.into_iter().filter(|(_, set)| *set).for_each(|(name, _)| option(name, None));
        f.write_str(&words.join(" "))
    }
}

/// Quotes a word for a POSIX shell.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+,:@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// The model bundled with the crate.
fn bundled() -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "assets/models/teapot.vdb"].iter().collect()
}
