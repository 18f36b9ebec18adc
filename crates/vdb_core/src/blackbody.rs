//! Black-body colours: Planck's law integrated with the CIE 1931 standard observer.

/// The second radiation constant, m·K: Planck's constant times the speed of light over Boltzmann's
/// constant, all three of which are exact in the SI of 2019.
const SECOND: f64 = PLANCK * LIGHT / BOLTZMANN;
const PLANCK: f64 = 6.626_070_15e-34;
const LIGHT: f64 = 299_792_458.0;
const BOLTZMANN: f64 = 1.380_649e-23;
/// Luminous efficacy, lm/W, where the eye is most sensitive.
const LUMENS: f64 = 683.002;

/// Planck's law: the spectral radiance of a black body, W / (m² · sr · m), at a wavelength in
/// metres.
fn planck(wavelength: f64, kelvin: f64) -> f64 {
    let first = 2.0 * PLANCK * LIGHT * LIGHT;
    first / wavelength.powi(5) / (SECOND / (wavelength * kelvin)).exp_m1()
}

/// The colour of a black body in linear Rec.709, as Bevy uses it, in cd/m². Its luminance is
/// `0.2126 R + 0.7152 G + 0.0722 B`. Below about 1,900 K the colour lies outside the gamut, and the
/// blue component is negative.
///
/// Planck's law times the CIE 1931 colour matching functions, summed in steps of 5 nm. From 1,000 K
/// upwards this is within 0.1 % of the sum in steps of 1 nm.
pub fn blackbody(kelvin: f64) -> [f64; 3] {
    if kelvin.is_nan() || kelvin <= 0.0 {
        return [0.0; 3];
    }
    let mut xyz = [0.0; 3];
    for (i, sensitivity) in CIE_1931.iter().enumerate() {
        let wavelength = (FIRST_NM + STEP_NM * i as f64) * 1e-9;
        let power = LUMENS * planck(wavelength, kelvin) * STEP_NM * 1e-9;
        for (sum, sensitivity) in xyz.iter_mut().zip(sensitivity) {
            *sum += power * sensitivity;
        }
    }
    REC_709_FROM_XYZ.map(|row| row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2])
}

/// The luminance of a linear Rec.709 colour.
fn luminance(color: [f64; 3]) -> f64 {
    0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
}

/// A look-up table of [`blackbody`], for `assets/shaders/trace/emission.wgsl`.
///
/// Temperatures are evenly spaced on a logarithmic scale. Each entry holds the colour at a
/// luminance of 1, and the logarithm of the luminance: both are nearly linear between entries.
#[derive(Clone, Debug)]
pub struct BlackbodyTable {
    entries: Vec<[f32; 4]>,
}

impl Default for BlackbodyTable {
    fn default() -> Self {
        let entry = |i: u32| {
            let share = f64::from(i) / f64::from(Self::ENTRIES - 1);
            let kelvin = Self::COLDEST * (Self::HOTTEST / Self::COLDEST).powf(share);
            let color = blackbody(kelvin);
            let luminance = luminance(color);
            let [r, g, b] = color.map(|c| (c / luminance) as f32);
            [r, g, b, luminance.ln() as f32]
        };
        Self { entries: (0..Self::ENTRIES).map(entry).collect() }
    }
}

impl BlackbodyTable {
    /// The number of entries.
    pub const ENTRIES: u32 = 1024;
    /// The temperature of the first entry, in kelvin. Anything colder is black: at this temperature
    /// the luminance is 10⁻⁷ cd/m².
    pub const COLDEST: f64 = 500.0;
    /// The temperature of the last entry, in kelvin. Anything hotter has the same colour.
    pub const HOTTEST: f64 = 40_000.0;

    /// The entries, from the coldest to the hottest.
    pub fn entries(&self) -> &[[f32; 4]] {
        &self.entries
    }

    /// The colour at a temperature, cd/m², with negative components clamped to zero: the twin of
    /// `blackbody` in `assets/shaders/trace/emission.wgsl`.
    pub fn look_up(&self, kelvin: f32) -> [f32; 3] {
        if kelvin.is_nan() || kelvin < Self::COLDEST as f32 {
            return [0.0; 3];
        }
        let steps = (Self::ENTRIES - 1) as f32 / (Self::HOTTEST / Self::COLDEST).ln() as f32;
        let at = (kelvin / Self::COLDEST as f32).ln() * steps;
        let at = at.clamp(0.0, (Self::ENTRIES - 1) as f32);
        let first = (at.floor() as usize).min(self.entries.len() - 2);
        let (low, high) = (self.entries[first], self.entries[first + 1]);
        let part = at - first as f32;
        let [r, g, b, log] = std::array::from_fn(|i| low[i] + part * (high[i] - low[i]));
        [r, g, b].map(|c: f32| c.max(0.0) * log.exp())
    }
}

/// From CIE 1931 tristimulus values to linear Rec.709 with a D65 white point (ITU-R BT.709-6).
const REC_709_FROM_XYZ: [[f64; 3]; 3] = [
    [3.240_969_942, -1.537_383_178, -0.498_610_760],
    [-0.969_243_636, 1.875_967_502, 0.041_555_057],
    [0.055_630_080, -0.203_976_959, 1.056_971_514],
];

/// The first wavelength of [`CIE_1931`] and the distance between wavelengths, nanometres.
const FIRST_NM: f64 = 380.0;
const STEP_NM: f64 = 5.0;

/// The colour matching functions x̄, ȳ and z̄ of the CIE 1931 standard observer (2°), CIE 018:2019.
#[rustfmt::skip]
const CIE_1931: [[f64; 3]; 81] = [
    [0.001_368, 0.000_039, 0.006_450_001],
    [0.002_236, 0.000_064, 0.010_549_99],
    [0.004_243, 0.000_12, 0.020_050_01],
    [0.007_65, 0.000_217, 0.036_21],
    [0.014_31, 0.000_396, 0.067_850_01],
    [0.023_19, 0.000_64, 0.110_2],
    [0.043_51, 0.001_21, 0.207_4],
    [0.077_63, 0.002_18, 0.371_3],
    [0.134_38, 0.004, 0.645_6],
    [0.214_77, 0.007_3, 1.039_050_1],
    [0.283_9, 0.011_6, 1.385_6],
    [0.328_5, 0.016_84, 1.622_96],
    [0.348_28, 0.023, 1.747_06],
    [0.348_06, 0.029_8, 1.782_6],
    [0.336_2, 0.038, 1.772_11],
    [0.318_7, 0.048, 1.744_1],
    [0.290_8, 0.06, 1.669_2],
    [0.251_1, 0.073_9, 1.528_1],
    [0.195_36, 0.090_98, 1.287_64],
    [0.142_1, 0.112_6, 1.041_9],
    [0.095_64, 0.139_02, 0.812_950_1],
    [0.057_950_01, 0.169_3, 0.616_2],
    [0.032_01, 0.208_02, 0.465_18],
    [0.014_7, 0.258_6, 0.353_3],
    [0.004_9, 0.323, 0.272],
    [0.002_4, 0.407_3, 0.212_3],
    [0.009_3, 0.503, 0.158_2],
    [0.029_1, 0.608_2, 0.111_7],
    [0.063_27, 0.71, 0.078_249_99],
    [0.109_6, 0.793_2, 0.057_250_01],
    [0.165_5, 0.862, 0.042_16],
    [0.225_749_9, 0.914_850_1, 0.029_84],
    [0.290_4, 0.954, 0.020_3],
    [0.359_7, 0.980_3, 0.013_4],
    [0.433_449_9, 0.994_950_1, 0.008_749_999],
    [0.512_050_1, 1.0, 0.005_749_999],
    [0.594_5, 0.995, 0.003_9],
    [0.678_4, 0.978_6, 0.002_749_999],
    [0.762_1, 0.952, 0.002_1],
    [0.842_5, 0.915_4, 0.001_8],
    [0.916_3, 0.87, 0.001_650_001],
    [0.978_6, 0.816_3, 0.001_4],
    [1.026_3, 0.757, 0.001_1],
    [1.056_7, 0.694_9, 0.001],
    [1.062_2, 0.631, 0.000_8],
    [1.045_6, 0.566_8, 0.000_6],
    [1.002_6, 0.503, 0.000_34],
    [0.938_4, 0.441_2, 0.000_24],
    [0.854_449_9, 0.381, 0.000_19],
    [0.751_4, 0.321, 0.000_1],
    [0.642_4, 0.265, 0.000_05],
    [0.541_9, 0.217, 0.000_03],
    [0.447_9, 0.175, 0.000_02],
    [0.360_8, 0.138_2, 0.000_01],
    [0.283_5, 0.107, 0.0],
    [0.218_7, 0.081_6, 0.0],
    [0.164_9, 0.061, 0.0],
    [0.121_2, 0.044_58, 0.0],
    [0.087_4, 0.032, 0.0],
    [0.063_6, 0.023_2, 0.0],
    [0.046_77, 0.017, 0.0],
    [0.032_9, 0.011_92, 0.0],
    [0.022_7, 0.008_21, 0.0],
    [0.015_84, 0.005_723, 0.0],
    [0.011_359_16, 0.004_102, 0.0],
    [0.008_110_916, 0.002_929, 0.0],
    [0.005_790_346, 0.002_091, 0.0],
    [0.004_109_457, 0.001_484, 0.0],
    [0.002_899_327, 0.001_047, 0.0],
    [0.002_049_19, 0.000_74, 0.0],
    [0.001_439_971, 0.000_52, 0.0],
    [0.000_999_949_3, 0.000_361_1, 0.0],
    [0.000_690_078_6, 0.000_249_2, 0.0],
    [0.000_476_021_3, 0.000_171_9, 0.0],
    [0.000_332_301_1, 0.000_12, 0.0],
    [0.000_234_826_1, 0.000_084_8, 0.0],
    [0.000_166_150_5, 0.000_06, 0.0],
    [0.000_117_413, 0.000_042_4, 0.0],
    [0.000_083_075_3, 0.000_03, 0.0],
    [0.000_058_706_5, 0.000_021_2, 0.0],
    [0.000_041_509_9, 0.000_014_99, 0.0],
];

#[cfg(test)]
mod tests {
    use super::*;

    /// The chromaticity of a linear Rec.709 colour, through the inverse of the matrix.
    fn chromaticity([r, g, b]: [f64; 3]) -> [f64; 2] {
        let x = 0.412_390_8 * r + 0.357_584_3 * g + 0.180_480_8 * b;
        let y = 0.212_639_0 * r + 0.715_168_7 * g + 0.072_192_3 * b;
        let z = 0.019_330_8 * r + 0.119_194_8 * g + 0.950_532_2 * b;
        [x / (x + y + z), y / (x + y + z)]
    }

    #[test]
    fn black_bodies_have_the_luminance_and_the_colours_that_are_known() {
        // The candela was once defined by this: platinum at its freezing point, 2,041.4 K, has 60
        // cd/cm².
        let platinum = luminance(blackbody(2041.4));
        assert!((platinum / 600_000.0 - 1.0).abs() < 0.01, "{platinum}");
        // CIE illuminant A is a black body of 2,856 K (2,848 K by the constants of its day).
        let [x, y] = chromaticity(blackbody(2855.5));
        assert!((x - 0.447_57).abs() < 2e-4 && (y - 0.407_45).abs() < 2e-4, "{x}, {y}");
        // Wien's displacement law: 2897.8 µm·K.
        for kelvin in [1000.0, 3000.0, 6000.0] {
            let peak = 2.897_771_955e-3 / kelvin;
            let beside = [0.99, 1.01].map(|by| planck(peak * by, kelvin));
            assert!(beside.iter().all(|&beside| beside < planck(peak, kelvin)), "{kelvin}");
        }
        // The Stefan–Boltzmann law: the integral over all wavelengths is σT⁴/π.
        let step = 1e-9;
        let all: f64 = (1..100_000).map(|i| planck(f64::from(i) * step, 3000.0) * step).sum();
        let exact = 5.670_374_419e-8 * 3000.0_f64.powi(4) / std::f64::consts::PI;
        assert!((all / exact - 1.0).abs() < 1e-3, "{all} {exact}");
        // An equal-energy spectrum has equal sums: the colour matching functions are normalised to
        // that.
        let sums = [0, 1, 2].map(|i| CIE_1931.iter().map(|row| row[i]).sum::<f64>() * STEP_NM);
        assert!(sums.iter().all(|sum| (sum / 106.857 - 1.0).abs() < 1e-4), "{sums:?}");
        assert_eq!(blackbody(f64::NAN), [0.0; 3]);
        assert_eq!(blackbody(-5.0), [0.0; 3]);
    }

    #[test]
    fn the_table_is_the_integral() {
        let table = BlackbodyTable::default();
        let mut worst = 0.0_f64;
        for i in 0..20_000 {
            let kelvin = 505.0 * (39_900.0_f64 / 505.0).powf(f64::from(i) / 20_000.0);
            let (exact, kept) = (blackbody(kelvin), table.look_up(kelvin as f32));
            let largest = exact.iter().copied().fold(0.0, f64::max);
            for (exact, kept) in exact.iter().zip(kept) {
                worst = worst.max((exact.max(0.0) - f64::from(kept)).abs() / largest);
            }
        }
        println!("the table is off by {worst:.2e} of the largest component");
        assert!(worst < 5e-4, "{worst}");
        assert_eq!(table.look_up(f32::NAN), [0.0; 3]);
        assert_eq!(table.look_up(0.0), [0.0; 3]);
        assert!(table.look_up(1e30).iter().all(|c| c.is_finite()));
        assert_eq!(table.look_up(1e30), table.look_up(40_000.0));
    }
}
