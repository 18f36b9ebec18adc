//! What each feature of a camera costs: the time that its passes take with it, less the time without it.

use std::time::Instant;

use bevy::diagnostic::DiagnosticsStore;
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;

use crate::quality::diagnostics::gpu_time;
use crate::quality::features::{FEATURES, Feature, Features};
use crate::{VdbCameraReport, VdbDiagnostics};

/// Measures what the features of a camera cost: a component of cameras. Over some hundreds of frames each feature
/// is left out in turn, in the picture, too; then this component goes, and [`VdbFeatureCosts`] is there. What
/// the app has set stays as it is, and a [`VdbDial`](crate::VdbDial) stands still meanwhile. Cameras
/// are measured one after the other. The scene should stand still.
#[derive(Clone, Component, Copy, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(Measuring, LeftOut)]
pub struct VdbMeasureFeatures;

/// What the features of a camera cost, when they were measured: a component that [`VdbMeasureFeatures`] leaves.
#[derive(Clone, Component, Debug, Default, PartialEq)]
pub struct VdbFeatureCosts {
    /// Milliseconds of a frame with all features.
    pub total_ms: f64,
    /// What each costs, by the names of [`VdbFeatureReport`](crate::VdbFeatureReport): of those that can be
    /// left out. They need not add up to the total, as one feature may do another's work.
    pub features: Vec<VdbFeatureCost>,
    /// Whether these are times of the GPU for the passes of volumes, of all cameras. Without Bevy's
    /// `RenderDiagnosticsPlugin`, or where the adapter has no timestamps, they are from frame to frame.
    pub is_gpu_time: bool,
}

/// What a feature costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VdbFeatureCost {
    /// Such as `fog`.
    pub name: &'static str,
    /// Milliseconds of a frame: the difference of medians. Below 0, it saves so many.
    pub ms: f64,
}

/// What a camera is without at the moment.
#[derive(Clone, Component, Copy, Debug, Default, ExtractComponent)]
pub(crate) struct LeftOut(pub Features);

/// How far a measurement is.
#[derive(Clone, Component, Debug, Default)]
pub(crate) struct Measuring {
    /// Without each, and before and after that with all.
    plan: Vec<Option<&'static Feature>>,
    medians: Vec<f64>,
    samples: Vec<f64>,
    skipped: usize,
    last: Option<Instant>,
    /// Frames in which the GPU has told nothing at all.
    untold: usize,
}

/// Times that are not counted after something has been left out: they come from the GPU frames late.
const SKIPPED: usize = 16;
/// Times of which the median is taken.
const TAKEN: usize = 17;
/// Frames without a timestamp after which there is none to come.
const PATIENCE: usize = 30;

impl Measuring {
    fn begin(&mut self, report: Option<&VdbCameraReport>) {
        let is_there = |name: &str| report.is_some_and(|report| report.has(name));
        let own = FEATURES.iter().filter(|feature| feature.without.is_some());
        let own = own.filter(|feature| is_there(feature.name));
        let own = own.flat_map(|feature| [Some(feature), None]);
        self.plan = [None].into_iter().chain(own).collect();
    }

    /// Takes a time in; whether it was the last that was needed of this part of the plan.
    fn take(&mut self, ms: f64) -> bool {
        if self.skipped < SKIPPED {
            self.skipped += 1;
            return false;
        }
        self.samples.push(ms);
        if self.samples.len() < TAKEN {
            return false;
        }
        self.samples.sort_by(f64::total_cmp);
        self.medians.push(self.samples[TAKEN / 2]);
        self.start_over();
        true
    }

    fn start_over(&mut self) {
        self.samples.clear();
        self.skipped = 0;
    }

    fn costs(&self) -> VdbFeatureCosts {
        let (with, without): (Vec<_>, Vec<_>) =
            self.plan.iter().zip(&self.medians).partition(|(part, _)| part.is_none());
        let total_ms = with.iter().map(|(_, ms)| *ms).sum::<f64>() / with.len().max(1) as f64;
        // Beside what all took just before and after, so that a clock that slowly changes does not count.
        let features = without.iter().zip(with.windows(2)).filter_map(|((part, ms), with)| {
            let name = (**part)?.name;
            let all = 0.5 * with.iter().map(|(_, ms)| *ms).sum::<f64>();
            Some(VdbFeatureCost { name, ms: all - **ms })
        });
        VdbFeatureCosts {
            total_ms,
            features: features.collect(),
            is_gpu_time: self.untold < PATIENCE,
        }
    }
}

/// Goes on with a measurement.
pub(crate) fn measure_features(
    mut commands: Commands,
    mut cameras: Query<(Entity, &mut Measuring, &mut LeftOut), With<VdbMeasureFeatures>>,
    given_up: Query<Entity, (With<Measuring>, Without<VdbMeasureFeatures>)>,
    diagnostics: Res<VdbDiagnostics>,
    store: Option<Res<DiagnosticsStore>>,
    time: Option<Res<Time<Real>>>,
) {
    for camera in &given_up {
        commands.entity(camera).remove::<(Measuring, LeftOut)>();
    }
    let next = cameras.iter_mut().min_by_key(|(camera, ..)| *camera);
    let Some((camera, mut measuring, mut left_out)) = next else { return };
    let measuring = &mut *measuring;
    let report = diagnostics.camera(camera);
    if report.as_ref().is_some_and(|report| report.is_compiling) {
        measuring.start_over();
        return;
    }
    if measuring.plan.is_empty() {
        measuring.begin(report.as_ref());
    }
    let told = store.as_deref().and_then(gpu_time);
    let ms = match told {
        _ if report.is_none() => Some(0.0),
        Some((at, ms)) => (measuring.last.replace(at) != Some(at)).then_some(f64::from(ms)),
        None if measuring.untold < PATIENCE => {
            measuring.untold += 1;
            None
        }
        None => time.as_deref().map(|time| 1e3 * time.delta_secs_f64()),
    };
    if !ms.is_some_and(|ms| measuring.take(ms)) {
        return;
    }
    match measuring.plan.get(measuring.medians.len()) {
        Some(part) => left_out.0 = part.map_or(Features::empty(), |feature| feature.flag),
        None => {
            let costs = measuring.costs();
            let mut camera = commands.entity(camera);
            camera.remove::<(VdbMeasureFeatures, Measuring, LeftOut)>().insert(costs);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a GPU of which all is known: what each feature adds, whose times come late, with outliers.
    #[test]
    fn what_each_feature_adds_is_found() {
        let names = ["fog", "shadows", "beams"];
        let report = VdbCameraReport {
            features: names
                .map(|name| crate::VdbFeatureReport { name, why: "" })
                .into_iter()
                .collect(),
            ..default()
        };
        let mut measuring = Measuring::default();
        measuring.begin(Some(&report));
        let ms_without = |part: Option<&Feature>| match part.map(|feature| feature.flag) {
            Some(Features::FOG) => 2.0,
            Some(Features::SHADOWS) => 4.5,
            Some(Features::BEAMS) => 7.0,
            _ => 6.0,
        };
        let mut late = std::collections::VecDeque::from([100.0; 10]);
        let (mut frame, mut slower) = (0, 0.0);
        while let Some(part) = measuring.plan.get(measuring.medians.len()) {
            frame += 1;
            let slow = if frame % 7 == 0 { 5.0 } else { 0.0 };
            // Everything takes a little longer with each frame.
            slower += 1e-3;
            late.push_back(ms_without(*part) + slow + slower);
            let ms = late.pop_front().unwrap();
            measuring.take(ms);
            assert!(frame < 1000);
        }
        let costs = measuring.costs();
        let expected = [("fog", 4.0), ("beams", -1.0), ("shadows", 1.5)];
        assert_eq!(costs.features.len(), expected.len());
        for (cost, (name, ms)) in costs.features.iter().zip(expected) {
            assert!(cost.name == name && (cost.ms - ms).abs() < 5e-3, "{cost:?}, not {ms}");
        }
        assert!((costs.total_ms - 6.0).abs() < slower, "{costs:?}");
    }
}
