//! Costs of the features of a camera: the time of its passes with a feature, minus the time
//! without.

use bevy::diagnostic::DiagnosticsStore;
use bevy::platform::time::Instant;
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;

use crate::quality::diagnostics::gpu_time;
use crate::quality::features::{FEATURES, Feature, Features};
use crate::{VdbCameraReport, VdbDiagnostics};

/// Measures the costs of the features of a camera. Over several hundred frames, each feature is
/// visibly turned off in turn; then this component is replaced by [`VdbFeatureCosts`]. The app's
/// settings are unchanged, and a [`VdbDial`](crate::VdbDial) pauses meanwhile. Several cameras are
/// measured one after the other. The scene should not change.
#[derive(Clone, Component, Copy, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Clone, Debug, Default, PartialEq)]
#[require(Measuring, LeftOut)]
pub struct VdbMeasureFeatures;

/// The costs of the features of a camera, left by [`VdbMeasureFeatures`].
#[derive(Clone, Component, Debug, Default, PartialEq)]
pub struct VdbFeatureCosts {
    /// Milliseconds per frame with all features.
    pub total_ms: f64,
    /// The cost of each optional feature, named as in
    /// [`VdbFeatureReport`](crate::VdbFeatureReport). The costs need not add up to the total,
    /// because features overlap.
    pub features: Vec<VdbFeatureCost>,
    /// Whether these are GPU times of the volume passes of all cameras. Without Bevy's
    /// `RenderDiagnosticsPlugin`, or on an adapter without timestamps, they are times between
    /// frames.
    pub is_gpu_time: bool,
}

/// The cost of a feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VdbFeatureCost {
    /// The name, such as `fog`.
    pub name: &'static str,
    /// Milliseconds per frame, a difference of medians. Negative if the feature saves time.
    pub ms: f64,
}

/// The features that are currently turned off for a camera.
#[derive(Clone, Component, Copy, Debug, Default, ExtractComponent)]
pub(crate) struct LeftOut(pub Features);

/// The state of a measurement.
#[derive(Clone, Component, Debug, Default)]
pub(crate) struct Measuring {
    /// Each feature to be left out in turn; `None`, for all features, before and after each.
    plan: Vec<Option<&'static Feature>>,
    medians: Vec<f64>,
    samples: Vec<f64>,
    skipped: usize,
    last: Option<Instant>,
    /// The number of consecutive frames without a GPU time.
    untold: usize,
}

/// The number of times skipped after each step, because GPU times arrive frames late.
const SKIPPED: usize = 16;
/// The number of times whose median is taken.
const TAKEN: usize = 17;
/// The number of frames without a GPU time after which none is expected.
const PATIENCE: usize = 30;

impl Measuring {
    fn begin(&mut self, report: Option<&VdbCameraReport>) {
        let is_there = |name: &str| report.is_some_and(|report| report.has(name));
        let own = FEATURES.iter().filter(|feature| feature.without.is_some());
        let own = own.filter(|feature| is_there(feature.name));
        let own = own.flat_map(|feature| [Some(feature), None]);
        self.plan = [None].into_iter().chain(own).collect();
    }

    /// Adds a time; returns whether this step of the plan is complete.
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
        // Compared with the times of all features just before and after, to cancel the drift of the
        // GPU's clock rate.
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

/// Advances a measurement.
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

    /// A simulated GPU whose features have known costs, with delayed times and outliers.
    #[test]
    fn what_each_feature_adds_is_found() {
        let names = ["fog", "shadows", "beam optimisation"];
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
            // The GPU slows down a little with each frame.
            slower += 1e-3;
            late.push_back(ms_without(*part) + slow + slower);
            let ms = late.pop_front().unwrap();
            measuring.take(ms);
            assert!(frame < 1000);
        }
        let costs = measuring.costs();
        let expected = [("fog", 4.0), ("beam optimisation", -1.0), ("shadows", 1.5)];
        assert_eq!(costs.features.len(), expected.len());
        for (cost, (name, ms)) in costs.features.iter().zip(expected) {
            assert!(cost.name == name && (cost.ms - ms).abs() < 5e-3, "{cost:?}, not {ms}");
        }
        assert!((costs.total_ms - 6.0).abs() < slower, "{costs:?}");
    }
}
