//! `.vdb` bytes → [`VdbFile`] with its [`VdbGrid`]s, off the main thread.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::asset::io::Reader;
use bevy::asset::{AssetLoader, AssetPath, LoadContext};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::tasks::AsyncComputeTaskPool;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use vdb_core::pack::{PackError, PackKind, PackOptions, PackedGrid, ValueFormat};
use vdb_core::tree::{Vdb543, trim_narrow_band};
use vdb_core::{AnyTree, Grid, GridSelection, ProgressFn, ReadOptions};

use crate::{VdbFile, VdbGrid, VdbGridError, VdbVectorGrid};

/// Loads `.vdb` files. Registered by [`VdbRenderPlugin`](crate::VdbRenderPlugin).
#[derive(Clone, Default, TypePath)]
pub struct VdbLoader {
    progress: VdbLoadProgress,
}

/// How a `.vdb` file is loaded; for `asset_server.load_builder().with_settings(…)` or a `.meta`
/// file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct VdbLoaderSettings {
    /// Names of the grids to load; the others are not even decompressed. `None`: all.
    pub grids: Option<Vec<String>>,
    /// Level sets: how much of the narrow band to keep on each side of the surface, in voxels; the
    /// rest costs memory and shows nothing. At least 2. `None`: all that the file has.
    pub half_width: Option<f32>,
    /// Whether grids are surfaces or fog.
    pub render_as: VdbRenderAs,
    /// Whether surfaces are smooth, where the trilinear interpolant passes through the iso-value, on by
    /// default. Otherwise they are made of voxels, and only bits of them are on the GPU: less than half
    /// the time and a fifth of the memory.
    pub smooth: bool,
    /// In how many bits the GPU gets the samples of fog and of smooth surfaces.
    pub values: VdbValues,
}

impl Default for VdbLoaderSettings {
    fn default() -> Self {
        Self {
            grids: None,
            half_width: None,
            render_as: VdbRenderAs::Auto,
            smooth: true,
            values: VdbValues::Exact,
        }
    }
}

/// In how many bits the GPU has samples; what each costs and loses is in `docs/benchmarks.md`. A surface
/// of voxels has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum VdbValues {
    /// As the file has them: in 16 bits where that loses nothing, as for files that were saved so, else
    /// in 32.
    #[default]
    Exact,
    /// Floats of 16 bits: relative errors of 2⁻¹² at most.
    Half,
    /// Bytes. Of fog, 255 steps from the least to the largest density of each leaf of 8³ voxels; of a
    /// smooth surface, steps of 1/127 of the largest distance that a cell on it has (about √3 voxels),
    /// such that no sign changes: the surface keeps its holes and gets no new ones.
    Byte,
}

impl From<VdbValues> for ValueFormat {
    fn from(values: VdbValues) -> Self {
        match values {
            VdbValues::Exact => Self::Exact,
            VdbValues::Half => Self::Half,
            VdbValues::Byte => Self::Byte,
        }
    }
}

/// Whether grids are shown as surfaces or as fog.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum VdbRenderAs {
    /// As their class says: level sets are surfaces, fog volumes are fog. A grid without a class is
    /// taken for a level set if its background is above zero and its values go below.
    #[default]
    Auto,
    /// Surfaces at this iso-value: what is below it is solid.
    Surface {
        /// In the units of the values; 0 for a level set.
        iso: f32,
    },
    /// Fog: the values are densities.
    Fog,
}

/// Why a `.vdb` file could not be loaded. Bevy logs it with the path of the file.
#[derive(Debug, Error)]
pub enum VdbLoaderError {
    /// The file could not be read.
    #[error("reading the file failed: {0}")]
    Io(#[from] std::io::Error),
    /// The file is not what it should be.
    #[error(transparent)]
    File(#[from] vdb_core::Error),
    /// The file has grids, but none that can be shown.
    #[error("no grid of the file can be shown: {}", .0.join("; "))]
    NothingToShow(Vec<String>),
    /// The settings make no sense.
    #[error("loader setting {0}")]
    Settings(String),
}

/// How far the files are that are being loaded: a resource.
#[derive(Clone, Debug, Default, Resource)]
pub struct VdbLoadProgress {
    files: Arc<Mutex<Files>>,
}

/// Bytes done and bytes of all, by path.
type Files = HashMap<AssetPath<'static>, (u64, u64)>;

impl VdbLoadProgress {
    /// The files being loaded, with the bytes done and the bytes of all.
    pub fn files(&self) -> Vec<(AssetPath<'static>, u64, u64)> {
        self.lock().iter().map(|(path, (done, all))| (path.clone(), *done, *all)).collect()
    }

    fn lock(&self) -> MutexGuard<'_, Files> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A file being decoded. Bevy drops the task that loads an asset, and this with it, when the last
/// handle to the asset goes: then the decoding stops too.
struct Running {
    progress: VdbLoadProgress,
    path: AssetPath<'static>,
    wanted: Arc<AtomicBool>,
}

impl Running {
    fn new(progress: &VdbLoadProgress, path: &AssetPath<'static>, all: u64) -> Self {
        progress.lock().insert(path.clone(), (0, all));
        let wanted = Arc::new(AtomicBool::new(true));
        Self { progress: progress.clone(), path: path.clone(), wanted }
    }

    /// What packing calls as it goes on.
    fn goes_on(&self) -> Arc<ProgressFn> {
        let wanted = self.wanted.clone();
        Arc::new(move |_, _| {
            let wanted = wanted.load(Ordering::Relaxed);
            if wanted { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        })
    }

    /// What the decoder calls as it goes on.
    fn report(&self) -> Arc<ProgressFn> {
        let (progress, path, wanted) =
            (self.progress.clone(), self.path.clone(), self.wanted.clone());
        Arc::new(move |done, all| {
            if !wanted.load(Ordering::Relaxed) {
                return ControlFlow::Break(());
            }
            // Reports of several threads may overtake each other.
            if let Some(entry) = progress.lock().get_mut(&path) {
                *entry = (done.max(entry.0), all);
            }
            ControlFlow::Continue(())
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.wanted.store(false, Ordering::Relaxed);
        self.progress.lock().remove(&self.path);
    }
}

impl VdbLoader {
    pub(crate) fn new(progress: VdbLoadProgress) -> Self {
        Self { progress }
    }
}

impl AssetLoader for VdbLoader {
    type Asset = VdbFile;
    type Settings = VdbLoaderSettings;
    type Error = VdbLoaderError;

    async fn load(
        &self,
        reader: &mut dyn Reader,
        settings: &VdbLoaderSettings,
        load_context: &mut LoadContext<'_>,
    ) -> Result<VdbFile, VdbLoaderError> {
        settings.check()?;
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).await?;
        let path = load_context.path().clone_owned();
        let running = Running::new(&self.progress, &path, bytes.len() as u64);
        let decoded = {
            let (settings, report) = (settings.clone(), running.report());
            let options = PackOptions {
                format: settings.values.into(),
                progress: Some(running.goes_on()),
                ..PackOptions::default()
            };
            // Decoding and packing take all the cores there are; Bevy's IO threads are not for it.
            AsyncComputeTaskPool::get()
                .spawn(async move { decode(&bytes, &settings, report, options) })
                .await?
        };
        for problem in &decoded.problems {
            warn!("{path}: {problem}");
        }
        let mut file = VdbFile {
            grids: Vec::new(),
            named_grids: HashMap::default(),
            vector_grids: HashMap::default(),
            metadata: decoded.file.metadata,
            skipped: decoded.file.skipped,
        };
        for (label, grid) in decoded.grids {
            let handle = load_context.add_labeled_asset(label.clone(), grid);
            file.grids.push(handle.clone());
            file.named_grids.insert(label, handle);
        }
        for (label, grid) in decoded.vector_grids {
            let handle = load_context.add_labeled_asset(label.clone(), grid);
            file.vector_grids.insert(label, handle);
        }
        Ok(file)
    }

    fn extensions(&self) -> &[&str] {
        &["vdb"]
    }
}

impl VdbLoaderSettings {
    fn check(&self) -> Result<(), VdbLoaderError> {
        match (self.half_width, self.render_as) {
            (Some(width), _) if width.is_nan() || width < 2.0 => Err(VdbLoaderError::Settings(
                format!("half_width is {width}; it must be 2 or more voxels"),
            )),
            (_, VdbRenderAs::Surface { iso }) if !iso.is_finite() => {
                Err(VdbLoaderError::Settings(format!("iso is {iso}; it must be a finite number")))
            }
            _ => Ok(()),
        }
    }
}

struct Decoded {
    file: vdb_core::VdbFile,
    grids: Vec<(String, VdbGrid)>,
    vector_grids: Vec<(String, VdbVectorGrid)>,
    /// Grids left out, with the reason.
    problems: Vec<String>,
}

fn decode(
    bytes: &[u8],
    settings: &VdbLoaderSettings,
    report: Arc<ProgressFn>,
    pack: PackOptions,
) -> Result<Decoded, VdbLoaderError> {
    let options = ReadOptions {
        limits: pack.limits.clone(),
        grids: settings.grids.clone().map_or(GridSelection::All, GridSelection::Names),
        progress: Some(report),
    };
    let mut file = vdb_core::VdbFile::read(bytes, &options)?;
    let skipped = file.skipped.iter();
    let mut problems: Vec<String> = skipped
        .map(|grid| format!("grid '{}' was skipped: {}", grid.unique_name, grid.reason))
        .collect();
    let (mut grids, mut vector_grids) = (Vec::new(), Vec::new());
    let mut shared = Shared::new(pack);
    for grid in std::mem::take(&mut file.grids) {
        let label = grid.unique_name.clone();
        match prepare(grid, settings, &mut shared) {
            Ok(Prepared::Floats(grid)) => grids.push((label, grid)),
            Ok(Prepared::Vectors(grid)) => vector_grids.push((label, grid)),
            Err(reason) => problems.push(format!("grid '{label}' was skipped: {reason}")),
        }
    }
    if grids.is_empty() && vector_grids.is_empty() && !problems.is_empty() {
        return Err(VdbLoaderError::NothingToShow(problems));
    }
    Ok(Decoded { file, grids, vector_grids, problems })
}

/// Trees that have been packed: instances have one tree, which is packed once.
struct Shared {
    options: PackOptions,
    /// By the address of the tree that was read, how it meets rays, and the half-width of its band.
    floats: HashMap<(usize, [u32; 3]), Floats>,
    /// By the address of the tree.
    vectors: HashMap<usize, Vectors>,
}

/// The tree that was read, which keeps its address from others; what is shown of it; and that packed.
type Floats = (Arc<Vdb543<f32>>, Arc<Vdb543<f32>>, Result<Arc<PackedGrid>, PackError>);
type Vectors = (Arc<Vdb543<[f32; 3]>>, Result<[Arc<PackedGrid>; 3], PackError>);

impl Shared {
    fn new(options: PackOptions) -> Self {
        Self { options, floats: HashMap::default(), vectors: HashMap::default() }
    }

    /// What is shown of a tree, packed. The band of a level set is narrowed to a half-width in the units
    /// of its values.
    fn floats(
        &mut self,
        tree: Arc<Vdb543<f32>>,
        kind: PackKind,
        half_width: Option<f32>,
    ) -> Result<(Arc<Vdb543<f32>>, Arc<PackedGrid>), PackError> {
        let (kind_code, iso) = match kind {
            PackKind::Surface { iso } => (0, iso),
            PackKind::Smooth { iso } => (1, iso),
            PackKind::Fog => (2, 0.0),
        };
        let width_bits = half_width.map_or(u32::MAX, f32::to_bits);
        let key = (Arc::as_ptr(&tree).addr(), [kind_code, iso.to_bits(), width_bits]);
        let (_, shown, packed) = self.floats.entry(key).or_insert_with(|| {
            let shown = match half_width {
                Some(half_width) => Arc::new(trim_narrow_band(&tree, half_width)),
                None => tree.clone(),
            };
            let packed = PackedGrid::with_options(&shown, kind, &self.options).map(Arc::new);
            (tree, shown, packed)
        });
        Ok((shown.clone(), packed.clone()?))
    }

    /// The components of a tree of vectors, packed.
    fn vectors(
        &mut self,
        tree: &Arc<Vdb543<[f32; 3]>>,
    ) -> Result<[Arc<PackedGrid>; 3], PackError> {
        let (_, packed) = self
            .vectors
            .entry(Arc::as_ptr(tree).addr())
            .or_insert_with(|| (tree.clone(), VdbVectorGrid::pack(tree, &self.options)));
        packed.clone()
    }
}

enum Prepared {
    Floats(VdbGrid),
    Vectors(VdbVectorGrid),
}

fn prepare(
    grid: Grid,
    settings: &VdbLoaderSettings,
    shared: &mut Shared,
) -> Result<Prepared, VdbGridError> {
    let world_from_index = grid.transform.linear().ok_or_else(|| {
        VdbGridError::Transform(format!(
            "a transform of type {} cannot be shown; export the grid with a linear transform",
            grid.transform.map_type()
        ))
    })?;
    let (name, values) = (grid.name.into(), settings.values);
    let tree = match grid.tree {
        AnyTree::Float(tree) => tree,
        AnyTree::Vec3s(tree) => {
            let (place, metadata) = (world_from_index, grid.metadata);
            let packed = shared.vectors(&tree)?;
            return VdbVectorGrid::from_parts(name, place, metadata, tree, packed)
                .map(Prepared::Vectors);
        }
        _ => return Err(VdbGridError::Type(grid.type_name)),
    };
    let kind = match settings.render_as {
        VdbRenderAs::Surface { iso } => PackKind::Surface { iso },
        VdbRenderAs::Fog => PackKind::Fog,
        VdbRenderAs::Auto => PackKind::suited(grid.class, &tree),
    };
    let kind = match kind {
        PackKind::Surface { iso } if settings.smooth => PackKind::Smooth { iso },
        kind => kind,
    };
    let half_width = match kind {
        PackKind::Surface { iso: 0.0 } | PackKind::Smooth { iso: 0.0 } => {
            let voxel = grid.transform.voxel_size().min_element() as f32;
            settings.half_width.map(|half_width| half_width * voxel)
        }
        _ => None,
    };
    let (tree, packed) = shared.floats(tree, kind, half_width)?;
    let (class, metadata) = (grid.class, grid.metadata);
    VdbGrid::from_parts(name, class, world_from_index, metadata, tree, values, packed)
        .map(Prepared::Floats)
}
