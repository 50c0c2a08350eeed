//! Degrees of latitude and longitude as metres in a frame that drives of different days share.

/// Semi-major axis of the WGS 84 ellipsoid in metres, and its first eccentricity squared.
const SEMI_MAJOR_METRES: f64 = 6_378_137.0;
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_14e-3;

/// East, north and up at a point of whole degrees: a rigid frame, so distances in it are true ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalFrame {
    /// Latitude and longitude of the origin in radians.
    origin_radians: [f64; 2],
    /// The origin seen from the centre of the earth, in metres.
    origin_metres: [f64; 3],
}

impl LocalFrame {
    /// The frame for positions around this latitude and longitude in degrees.
    pub(super) fn near(degrees: [f64; 2]) -> Self {
        let origin_radians = degrees.map(|degree| degree.round().to_radians());
        Self { origin_radians, origin_metres: from_centre(origin_radians, 0.0) }
    }

    /// Metres to the east and to the north of the origin, and above its plane.
    pub(super) fn metres(&self, degrees: [f64; 2], altitude_metres: f64) -> [f64; 3] {
        let there = from_centre(degrees.map(f64::to_radians), altitude_metres);
        let [x, y, z] = std::array::from_fn(|axis| there[axis] - self.origin_metres[axis]);
        let [(sin_lat, cos_lat), (sin_lon, cos_lon)] = self.origin_radians.map(f64::sin_cos);
        let outward = cos_lon * x + sin_lon * y;
        [cos_lon * y - sin_lon * x, cos_lat * z - sin_lat * outward, cos_lat * outward + sin_lat * z]
    }
}

/// A position on the ellipsoid in metres from the centre of the earth.
fn from_centre([latitude, longitude]: [f64; 2], altitude_metres: f64) -> [f64; 3] {
    let (sin, cos) = latitude.sin_cos();
    let normal = SEMI_MAJOR_METRES / (1.0 - ECCENTRICITY_SQUARED * sin * sin).sqrt();
    let outward = (normal + altitude_metres) * cos;
    let upward = (normal * (1.0 - ECCENTRICITY_SQUARED) + altitude_metres) * sin;
    [outward * longitude.cos(), outward * longitude.sin(), upward]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn a_degree_of_latitude_and_of_longitude_are_as_long_as_tables_say() {
        // Lengths at 45° on WGS 84: 111,131.7 m of meridian and 78,846.8 m of parallel a degree.
        let frame = LocalFrame::near([45.2, 8.9]);
        let [east, north, up] = frame.metres([45.01, 9.0], 100.0);
        assert!(east.abs() < 1e-6 && (north - 1_111.32).abs() < 0.05 && (up - 99.9).abs() < 0.01);
        let [east, north, _] = frame.metres([45.0, 9.01], 0.0);
        assert!((east - 788.468).abs() < 0.01 && north.abs() < 0.1, "{east} {north}");
    }

    #[test]
    fn distances_are_the_same_in_frames_of_different_origin() {
        let (a, b) = ([51.49, -0.12], [51.52, -0.1]);
        let [one, other] = [[51.0, 0.0], [52.0, -1.0]].map(LocalFrame::near);
        let far = |frame: &LocalFrame| distance(frame.metres(a, 20.0), frame.metres(b, 5.0));
        assert!((far(&one) - far(&other)).abs() < 1e-6);
        assert!((far(&one) - 3_613.0).abs() < 20.0, "{}", far(&one));
    }

    #[test]
    fn the_date_line_is_no_border() {
        let frame = LocalFrame::near([0.0, 179.9]);
        assert!(distance(frame.metres([0.0, 179.999], 0.0), frame.metres([0.0, -179.999], 0.0)) < 230.0);
    }
}
