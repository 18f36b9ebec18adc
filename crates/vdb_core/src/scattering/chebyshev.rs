//! Relaxation factors that make sweeps converge.

use std::f64::consts::PI;

/// The factors of Richardson's iteration in `steps` steps, for a system whose eigenvalues lie between `lowest`
/// and `highest`: the inverse roots of a Chebyshev polynomial (Young 1953, "On Richardson's method for solving
/// linear systems with positive definite matrices").
///
/// Some factors are large, and errors grow until others damp them. So each factor is, of those that are left,
/// the one that keeps the errors smallest: the root farthest from those used, by the product of distances (Leja's
/// order).
pub fn relaxation_factors(steps: usize, [lowest, highest]: [f64; 2]) -> Vec<f32> {
    let root = |i: usize| {
        let cosine = (PI * (i as f64 + 0.5) / steps as f64).cos();
        0.5 * (highest + lowest) + 0.5 * (highest - lowest) * cosine
    };
    // The largest root comes first.
    let mut left: Vec<f64> = (0..steps).map(root).collect();
    let mut used: Vec<f64> = Vec::with_capacity(steps);
    while !left.is_empty() {
        let distance = |root: f64| used.iter().map(|other| (root - other).abs()).product::<f64>();
        let farthest = (1..left.len())
            .fold(0, |best, i| if distance(left[i]) > distance(left[best]) { i } else { best });
        used.push(left.remove(farthest));
    }
    used.iter().map(|root| (1.0 / root) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Those that docs/internals/notebook.md gives to three decimals; of roots that are equally far, another may
    /// be first.
    #[test]
    fn the_factors_are_those_of_the_notebook() {
        let coarse =
            [1.004, 41.336, 1.742, 4.724, 1.237, 3.101, 1.113, 17.452, 1.434, 1.039, 8.247, 2.242];
        let middle = [1.009, 16.913, 1.619, 3.83, 1.268, 7.689, 1.087, 2.313];
        let fine = [1.009, 9.204, 2.164, 1.25, 3.333, 1.082, 5.687, 1.568];
        for (lowest, expected) in [(0.02, &coarse[..]), (0.05, &middle), (0.1, &fine)] {
            let mut found = relaxation_factors(expected.len(), [lowest, 1.0]);
            assert!((found[0] - expected[0]).abs() < 6e-4 && (found[1] - expected[1]).abs() < 6e-4);
            let mut expected = expected.to_vec();
            found.sort_by(f32::total_cmp);
            expected.sort_by(f32::total_cmp);
            for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
                assert!((found - expected).abs() < 6e-4, "factor {i} of {lowest}: {found}");
            }
        }
    }

    /// For any eigenvalue, the error that is left is at most the inverse of the Chebyshev polynomial's
    /// value at 0, and on the way there it never exceeds that after the second, largest factor.
    #[test]
    fn all_eigenvalues_converge() {
        for (steps, [lowest, highest]) in
            [(12, [0.02, 1.0]), (8, [0.05, 1.0]), (8, [0.1, 1.0]), (12, [0.02, 1.9])]
        {
            let factors = relaxation_factors(steps, [lowest, highest]);
            let at_zero: f64 = (highest + lowest) / (highest - lowest);
            let bound = 1.0 / (steps as f64 * at_zero.acosh()).cosh();
            let (mut left, mut most) = (0.0_f64, 0.0_f64);
            for i in 0..=1000 {
                let eigenvalue = lowest + (highest - lowest) * f64::from(i) / 1000.0;
                let mut error = 1.0;
                for factor in &factors {
                    error *= 1.0 - f64::from(*factor) * eigenvalue;
                    most = most.max(error.abs());
                }
                left = left.max(error.abs());
            }
            // The factors are rounded to 24 bits; the largest is 41.
            assert!((left - bound).abs() < 1e-4, "{steps}, {lowest}: {left}, not {bound}");
            println!("{steps}, {lowest}: {most} on the way, of {}", factors[1]);
            assert!(most < f64::from(factors[1]), "{steps}, {lowest}: {most} on the way");
        }
    }
}
