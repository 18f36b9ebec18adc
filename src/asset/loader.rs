//! The loader of whole files: from the bytes of a `.vdb` file, or of a cooked one, to a [`VdbFile`]
//! with its [`VdbGrid`]s, off the main thread.

use std::io::SeekFrom;
use std::sync::Arc;

use bevy::asset::io::Reader;
use bevy::asset::{AssetLoader, AsyncReadExt, AsyncSeekExt, LoadContext};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use vdb_core::cooked::CookedFile;
use vdb_core::display::escaped;
use vdb_core::pack::{PackError, PackKind, PackOptions, PackedGrid, PackedTogether};
use vdb_core::tree::{Vdb543, trim_narrow_band};
use vdb_core::{
    AnyTree, ConvertedGrid, FileBuffer, Grid, GridClass, GridSelection, Limits, ProgressFn,
    ReadOptions, Transform,
};

use super::background;
use super::colors::join_colors;
use super::common::{VdbGridError, linear};
use super::cooked;
use super::decoded::Decoded;
use super::error::{VdbLoaderError, few};
use super::file::VdbFile;
use super::grid::VdbGrid;
use super::labels::labels;
use super::loaded::{LoadedFile, LoadedFiles};
use super::parts::{VELOCITIES, is};
use super::points;
use super::progress::{Job, Running, VdbLoadProgress};
use super::settings::{VdbLoaderSettings, VdbRenderAs};
use super::vector_grid::VdbVectorGrid;

/// Loads `.vdb`, `.nvdb` and cooked `.vdbc` files as [`VdbFile`]s, with a labelled asset for each
/// grid. Registered by [`VdbRenderPlugin`](crate::VdbRenderPlugin). In `.meta` files it is
/// `"bevy_vdb::VdbLoader"`.
#[derive(Clone, Default, TypePath)]
#[type_path = "bevy_vdb"]
pub struct VdbLoader {
    progress: VdbLoadProgress,
    loaded: LoadedFiles,
}

impl VdbLoader {
    pub(crate) fn new(progress: VdbLoadProgress, loaded: LoadedFiles) -> Self {
        Self { progress, loaded }
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
        let decoded = load_with(&self.progress, reader, settings, load_context, decode).await?;
        let path = load_context.path().clone_owned();
        for problem in few(&decoded.problems) {
            warn!("{}: {problem}", escaped(&path.to_string()));
        }
        self.loaded.push(LoadedFile {
            path: path.without_label().into_owned(),
            grids: decoded.grids.iter().map(|(label, _)| label.clone()).collect(),
            vector_grids: decoded.vector_grids.iter().map(|(label, _)| label.clone()).collect(),
        });
        let mut file = VdbFile {
            grids: Vec::new(),
            named_grids: HashMap::default(),
            vector_grids: HashMap::default(),
            metadata: decoded.metadata,
            skipped: decoded.skipped,
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
        EXTENSIONS
    }
}

/// Reads a file and processes it off the main thread.
pub(crate) async fn load_with<T: Send + Sync + 'static>(
    progress: &VdbLoadProgress,
    reader: &mut dyn Reader,
    settings: &VdbLoaderSettings,
    load_context: &LoadContext<'_>,
    make: fn(Vec<u8>, &VdbLoaderSettings, &Arc<Job>) -> Result<T, VdbLoaderError>,
) -> Result<T, VdbLoaderError> {
    settings.check()?;
    let length = length(reader).await?;
    let path = load_context.path().clone_owned();
    let running = Running::new(progress, &path, length.unwrap_or_default());
    let bytes = take_in(reader, length, &settings.limits).await?;
    let (settings, job) = (settings.clone(), running.job());
    job.begin_decoding(bytes.len() as u64);
    background::run(move || make(bytes, &settings, &job)).await
}

impl VdbLoaderSettings {
    pub(super) fn check(&self) -> Result<(), VdbLoaderError> {
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

/// The bytes of a file: only those that contain its grids, and only the first few if it is not a VDB
/// file.
pub(super) async fn take_in(
    reader: &mut dyn Reader,
    length: Option<u64>,
    limits: &Limits,
) -> Result<Vec<u8>, VdbLoaderError> {
    let mut buffer = FileBuffer::new(limits.clone(), length);
    while let Some(room) = buffer.room()? {
        let count = reader.read(room).await?;
        buffer.filled(count);
    }
    Ok(buffer.into_bytes())
}

/// The length of a file, if its source knows it.
async fn length(reader: &mut dyn Reader) -> Result<Option<u64>, std::io::Error> {
    let Ok(reader) = reader.seekable() else { return Ok(None) };
    let Ok(end) = reader.seek(SeekFrom::End(0)).await else { return Ok(None) };
    reader.seek(SeekFrom::Start(0)).await?;
    // Devices report a length of 0.
    Ok(Some(end).filter(|end| *end > 0))
}

/// The extensions of files that are loaded: those of OpenVDB and NanoVDB, and cooked ones.
pub(super) const EXTENSIONS: &[&str] = &["vdb", "nvdb", vdb_core::cooked::EXTENSION];

/// Float grids, reports about grids that cannot be read, and the grids that were converted to floats.
pub(super) type ReadGrids = (vdb_core::VdbFile, Vec<String>, Vec<ConvertedGrid>);

/// The grids selected by the settings, converted to floats if necessary.
pub(super) fn read(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    progress: Option<Arc<ProgressFn>>,
) -> Result<ReadGrids, VdbLoaderError> {
    let options = ReadOptions {
        limits: settings.limits.clone(),
        grids: settings.grids.clone().map_or(GridSelection::All, GridSelection::Names),
        progress,
    };
    let mut file = vdb_core::VdbFile::read(&bytes, &options)?;
    // Frees the memory for packing.
    drop(bytes);
    let converted = file.convert_to_floats(&settings.limits);
    let skipped = file.skipped.iter();
    let mut problems: Vec<String> = skipped
        .map(|grid| format!("grid '{}' was skipped: {}", escaped(&grid.unique_name), grid.reason))
        .collect();
    for points in std::mem::take(&mut file.points) {
        let reason = match points::volume(&points, settings) {
            Some(Ok(grid)) => {
                file.grids.push(grid);
                continue;
            }
            Some(Err(error)) => error.to_string(),
            None => {
                let count = points.points.len();
                format!("it has {count} points, which `VdbLoaderSettings::points` can display")
            }
        };
        let name = escaped(&points.unique_name);
        problems.push(format!("grid '{name}' was skipped: {reason}"));
    }
    Ok((file, problems, converted))
}

fn decode(
    bytes: Vec<u8>,
    settings: &VdbLoaderSettings,
    job: &Arc<Job>,
) -> Result<Decoded, VdbLoaderError> {
    if CookedFile::is_cooked(&bytes) {
        return cooked::decode(bytes, settings, job);
    }
    let (mut file, mut problems, converted) = read(bytes, settings, Some(job.decoding()))?;
    problems.extend(join_colors(&mut file.grids, &settings.limits));
    let (mut grids, mut vector_grids) = (Vec::new(), Vec::new());
    let mut shared = Shared::new(settings, job);
    job.begin_packing(file.grids.len());
    let labels = labels(file.grids.iter().map(|grid| &*grid.unique_name));
    for (grid, label) in std::mem::take(&mut file.grids).into_iter().zip(labels) {
        match prepare(grid, settings, &mut shared) {
            Ok(Prepared::Floats(grid)) => grids.push((label, grid)),
            Ok(Prepared::Vectors(grid)) => vector_grids.push((label, grid)),
            Err(reason) => problems.push(format!("grid '{label}' was skipped: {reason}")),
        }
        job.end_grid();
    }
    if grids.is_empty() && vector_grids.is_empty() && !problems.is_empty() {
        return Err(VdbLoaderError::NothingToShow(problems));
    }
    tell_of_conversions(&converted, &mut problems);
    let (metadata, skipped) = (file.metadata, file.skipped);
    Ok(Decoded { metadata, skipped, grids, vector_grids, problems })
}

/// Adds one line for all grids that were converted: the first one, because [`few`] leaves out the last.
pub(super) fn tell_of_conversions(converted: &[ConvertedGrid], problems: &mut Vec<String>) {
    if !converted.is_empty() {
        let lines: Vec<String> = converted.iter().map(ToString::to_string).collect();
        problems.insert(0, lines.join("; "));
    }
}

/// Packed trees: instances share one tree, which is packed once.
pub(crate) struct Shared {
    options: PackOptions,
    /// By the address of the tree, its kind, and the half-width of its band.
    floats: HashMap<(usize, [u32; 3]), Floats>,
    /// By the address of the tree.
    vectors: HashMap<usize, Vectors>,
}

/// The tree that was read, held so that no other tree can have its address; the displayed tree; and
/// the packed tree.
type Floats = (Arc<Vdb543<f32>>, Arc<Vdb543<f32>>, Result<Arc<PackedGrid>, PackError>);
type Vectors = (Arc<Vdb543<[f32; 3]>>, Result<[Arc<PackedGrid>; 3], PackError>);

impl Shared {
    pub fn new(settings: &VdbLoaderSettings, job: &Arc<Job>) -> Self {
        let options = PackOptions {
            format: settings.values.into(),
            limits: settings.limits.clone(),
            progress: Some(job.packing()),
            together: Some(PackedTogether::default()),
            ..PackOptions::default()
        };
        Self { options, floats: HashMap::default(), vectors: HashMap::default() }
    }

    /// The displayed part of a tree, packed. The band of a level set is narrowed to a half-width in
    /// the units of its values.
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

    /// The components of a vector tree, packed.
    fn vectors(&mut self, tree: &Arc<Vdb543<[f32; 3]>>) -> Result<[Arc<PackedGrid>; 3], PackError> {
        let (_, packed) = self
            .vectors
            .entry(Arc::as_ptr(tree).addr())
            .or_insert_with(|| (tree.clone(), VdbVectorGrid::pack(tree, &self.options)));
        packed.clone()
    }
}

pub(crate) enum Prepared {
    Floats(VdbGrid),
    Vectors(VdbVectorGrid),
}

/// The kind, surface or fog, as which a float grid is displayed.
pub(crate) fn kind(tree: &Vdb543<f32>, class: GridClass, settings: &VdbLoaderSettings) -> PackKind {
    let kind = match settings.render_as {
        VdbRenderAs::Surface { iso } => PackKind::Surface { iso },
        VdbRenderAs::Fog => PackKind::Fog,
        VdbRenderAs::Auto => PackKind::suited(class, tree),
    };
    match kind {
        PackKind::Surface { iso } if settings.smooth => PackKind::Smooth { iso },
        kind => kind,
    }
}

/// The half-width to which the band of a level set is narrowed, in the units of its values.
pub(super) fn half_width(
    transform: &Transform,
    kind: PackKind,
    settings: &VdbLoaderSettings,
) -> Option<f32> {
    match kind {
        PackKind::Surface { iso: 0.0 } | PackKind::Smooth { iso: 0.0 } => {
            let voxel = transform.voxel_size().min_element() as f32;
            settings.half_width.map(|half_width| half_width * voxel)
        }
        _ => None,
    }
}

pub(crate) fn prepare(
    grid: Grid,
    settings: &VdbLoaderSettings,
    shared: &mut Shared,
) -> Result<Prepared, VdbGridError> {
    let world_from_index = linear(&grid.transform)?;
    let (name, values): (Arc<str>, _) = (grid.name.into(), settings.values);
    let tree = match grid.tree {
        AnyTree::Float(tree) => tree,
        AnyTree::Vec3s(tree) => {
            let (place, metadata) = (world_from_index, grid.metadata);
            // Velocities are used for their lattice, which is made here, in a task, rather than when a
            // frame waits for it.
            let is_velocity = VELOCITIES.iter().any(|own| is(&name, own));
            let packed = if is_velocity { None } else { Some(shared.vectors(&tree)?) };
            let options = PackOptions {
                format: settings.values.into(),
                limits: settings.limits.clone(),
                ..PackOptions::default()
            };
            let grid = VdbVectorGrid::from_parts(name, place, metadata, tree, packed, options)?;
            if is_velocity {
                grid.lattice();
            }
            return Ok(Prepared::Vectors(grid));
        }
        _ => return Err(VdbGridError::Type(grid.type_name)),
    };
    let kind = kind(&tree, grid.class, settings);
    let half_width = half_width(&grid.transform, kind, settings);
    let (tree, packed) = shared.floats(tree, kind, half_width)?;
    let (class, metadata, limits) = (grid.class, grid.metadata, settings.limits.clone());
    VdbGrid::from_parts(name, class, world_from_index, metadata, Some(tree), packed, values, limits)
        .map(Prepared::Floats)
}
