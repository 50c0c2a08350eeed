//! Positions: degrees and file names to metres, and frames at least so far apart.

use std::path::Path;

use super::error::GroundTruthError;
use super::file::{self, MAX_BINARY_BYTES, MAX_FRAMES};
use super::mat::MatFile;

/// Semi-major axis of the WGS84 ellipsoid in metres, and its first eccentricity squared.
const WGS84: (f64, f64) = (6_378_137.0, 6.694_379_990_141_316e-3);

/// Metres east and north of `origin` (latitude and longitude in degrees), by the radii of curvature at
/// its latitude. Good to some centimetres over the few kilometres of a traverse.
#[must_use]
pub fn metres_from_degrees(latitude: f64, longitude: f64, origin: [f64; 2]) -> [f64; 2] {
    let (semi_major, eccentricity_squared) = WGS84;
    let sine = origin[0].to_radians().sin();
    let w = (1.0 - eccentricity_squared * sine * sine).sqrt();
    let meridian = semi_major * (1.0 - eccentricity_squared) / w.powi(3);
    let normal = semi_major / w;
    let east = (longitude - origin[1]).to_radians() * normal * origin[0].to_radians().cos();
    let north = (latitude - origin[0]).to_radians() * meridian;
    [east, north]
}

/// The UTM position, in metres, in a file name `@EASTING@NORTHING@….jpg`, as the visual geo-localization
/// benchmark names its images.
#[must_use]
pub fn from_file_name(name: &str) -> Option<[f64; 2]> {
    let mut parts = name.strip_prefix('@')?.split('@');
    let mut metres = || parts.next()?.parse::<f64>().ok().filter(|metres| metres.is_finite());
    Some([metres()?, metres()?])
}

/// The pairs of numbers in a variable of a MATLAB file, a pair a row or a pair a column.
///
/// # Errors
/// If the file cannot be read or has no such variable of two rows or columns.
pub fn pairs_from_mat(path: &Path, variable: &str) -> Result<Vec<[f64; 2]>, GroundTruthError> {
    let bytes = file::read(path, MAX_BINARY_BYTES)?;
    let malformed = |reason: String| GroundTruthError::malformed(path, reason);
    let file = MatFile::read(&bytes).map_err(malformed)?;
    let matrices = file.matrices().map_err(malformed)?;
    let missing = || malformed(format!("no full matrix {variable} of two columns"));
    let matrix = matrices.iter().find(|matrix| matrix.name == variable).ok_or_else(missing)?;
    let (count, is_a_pair_a_row) = match (matrix.rows, matrix.columns) {
        (rows, 2) => (rows, true),
        (2, columns) => (columns, false),
        _ => return Err(missing()),
    };
    if count > MAX_FRAMES {
        return Err(malformed(file::too_many_frames()));
    }
    let pair = |index: usize| {
        let at = |which: usize| {
            if is_a_pair_a_row { matrix.get(index, which) } else { matrix.get(which, index) }
        };
        Some([at(0)?, at(1)?])
    };
    (0..count).map(pair).collect::<Option<Vec<[f64; 2]>>>().ok_or_else(missing)
}

/// The indices of positions that lie at least `spacing_metres` from the one kept before, the first one
/// always.
#[must_use]
pub fn spaced(positions: &[[f64; 2]], spacing_metres: f64) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for (index, at) in positions.iter().enumerate() {
        let is_far = kept.last().is_none_or(|&last| {
            (at[0] - positions[last][0]).hypot(at[1] - positions[last][1]) >= spacing_metres
        });
        if is_far {
            kept.push(index);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_minute_of_latitude_is_about_a_sea_mile_and_longitude_shrinks_towards_the_poles() {
        // Length of a degree on WGS84 (NGA, Standardization Document 8350.2): at latitude 0 a degree of
        // longitude is 111,320 m; at 45 one of latitude 111,132 m and one of longitude 78,847 m.
        let degree = |latitude: f64, dlat: f64, dlon: f64| {
            let metres = metres_from_degrees(latitude + dlat * 1e-3, 7.0 + dlon * 1e-3, [latitude, 7.0]);
            metres[0].hypot(metres[1]) * 1e3
        };
        assert!((degree(0.0, 0.0, 1.0) - 111_320.0).abs() < 1.0);
        assert!((degree(45.0, 1.0, 0.0) - 111_132.0).abs() < 1.0);
        assert!((degree(45.0, 0.0, 1.0) - 78_847.0).abs() < 1.0);
        assert!((degree(-27.5, 0.0, 1.0) - degree(27.5, 0.0, 1.0)).abs() < 1e-6);
    }

    #[test]
    fn file_names_of_the_benchmark_carry_metres() {
        let name = "@0502345.67@6957012.30@56@J@-027.4953@0153.0145@@@@@@2010090@@.jpg";
        assert_eq!(from_file_name(name), Some([502_345.67, 6_957_012.3]));
        for other in ["0001.jpg", "@one@two@.jpg", "@1", "@nan@1@.jpg"] {
            assert_eq!(from_file_name(other), None, "{other}");
        }
    }

    proptest! {
        #[test]
        fn kept_positions_are_spaced_and_dropped_ones_were_too_near(
            steps in proptest::collection::vec((-4.0..4.0_f64, -4.0..4.0_f64), 1..60),
        ) {
            let mut at = [0.0, 0.0];
            let positions: Vec<[f64; 2]> =
                steps.iter().map(|step| { at = [at[0] + step.0, at[1] + step.1]; at }).collect();
            let kept = spaced(&positions, 5.0);
            prop_assert_eq!(kept[0], 0);
            let apart = |a: usize, b: usize| {
                (positions[a][0] - positions[b][0]).hypot(positions[a][1] - positions[b][1])
            };
            for index in 0..positions.len() {
                let before = kept.iter().rev().find(|&&kept| kept < index);
                let is_kept = kept.contains(&index);
                prop_assert_eq!(is_kept, before.is_none_or(|&before| apart(index, before) >= 5.0));
            }
        }
    }
}
