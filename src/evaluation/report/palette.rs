//! One look for each method in all plots: colours of Okabe and Ito (2008), which colour-blind readers
//! tell apart, and a shape and a dash beside them, so that no colour is needed.

use plotters::style::RGBColor;

use crate::evaluation::results::{Database, Method, MethodResult};

/// Text in plots.
pub(super) const INK: RGBColor = RGBColor(0x33, 0x3a, 0x42);
/// Axes and reference lines.
pub(super) const AXIS: RGBColor = RGBColor(0x8a, 0x92, 0x9a);
/// Lines of the grid.
pub(super) const GRID: RGBColor = RGBColor(0xe6, 0xe9, 0xec);

/// Marks of a method where it stands at one point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Marker {
    Circle,
    Triangle,
    Square,
}

/// The method's colour.
pub(super) const fn color(method: Method) -> RGBColor {
    match method {
        Method::Cnn => RGBColor(0x00, 0x72, 0xb2),
        Method::BowHv => RGBColor(0xd5, 0x5e, 0x00),
        Method::CnnBowHv => RGBColor(0x00, 0x9e, 0x73),
    }
}

/// The method's mark.
pub(super) const fn marker(method: Method) -> Marker {
    match method {
        Method::Cnn => Marker::Circle,
        Method::BowHv => Marker::Triangle,
        Method::CnnBowHv => Marker::Square,
    }
}

/// Whether lines over this database are dashed, and its marks hollow.
pub(super) const fn is_dashed(database: Database) -> bool {
    matches!(database, Database::Map)
}

/// Corners of a mark of `radius` around the origin; none for a circle.
pub(super) fn corners(marker: Marker, radius: i32) -> Vec<(i32, i32)> {
    match marker {
        Marker::Circle => Vec::new(),
        Marker::Triangle => vec![(0, -radius), (radius, radius * 3 / 4), (-radius, radius * 3 / 4)],
        Marker::Square => {
            let half = radius * 5 / 6;
            vec![(-half, -half), (half, -half), (half, half), (-half, half)]
        }
    }
}

/// `cnn · frames`
pub(super) fn label(result: &MethodResult) -> String {
    format!("{} · {}", result.method.as_str(), result.database.as_str())
}

/// A small SVG of the line and mark, for legends and the heads of rows.
pub(super) fn key(method: Method, database: Database) -> String {
    let RGBColor(red, green, blue) = color(method);
    let dash = if is_dashed(database) { " stroke-dasharray=\"5 3\"" } else { "" };
    let fill = if is_dashed(database) { "#fff" } else { "currentColor" };
    let mark = match marker(method) {
        Marker::Circle => format!("<circle cx=\"16\" cy=\"7\" r=\"4\" fill=\"{fill}\" stroke-width=\"2\"/>"),
        shape => {
            let points: Vec<String> =
                corners(shape, 5).iter().map(|(x, y)| format!("{},{}", 16 + x, 7 + y)).collect();
            format!("<polygon points=\"{}\" fill=\"{fill}\" stroke-width=\"2\"/>", points.join(" "))
        }
    };
    format!(
        "<svg class=\"key\" viewBox=\"0 0 32 14\" width=\"32\" height=\"14\" aria-hidden=\"true\" \
         color=\"#{red:02x}{green:02x}{blue:02x}\" stroke=\"currentColor\">\
         <line x1=\"0\" y1=\"7\" x2=\"32\" y2=\"7\" stroke-width=\"2\"{dash}/>{mark}</svg>"
    )
}
