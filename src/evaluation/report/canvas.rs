//! A drawing area that ends as an SVG within the page, with a name for those who do not see it.

use std::error::Error;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::palette::{AXIS, GRID, INK};
use super::{ReportError, text};

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Refusal = Box<dyn Error + Send + Sync>;
pub(super) type Drawn = Result<(), Refusal>;
pub(super) type Chart<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

/// Size of text in a plot, in its own pixels.
pub(super) const TEXT_PX: i32 = 17;

/// What a plot is called and how large it is.
pub(super) struct Frame<'a> {
    /// Its kind, for errors.
    pub(super) plot: &'static str,
    /// What it shows, in words.
    pub(super) description: &'a str,
    /// Width and height in its own pixels.
    pub(super) size: (u32, u32),
}

/// Draws on a white area and wraps the SVG as an image with its description.
pub(super) fn draw(frame: &Frame<'_>, paint: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String, ReportError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, frame.size).into_drawing_area();
        let painted = paint(&area).and_then(|()| Ok(area.present()?));
        painted.map_err(|source| ReportError::Plot { plot: frame.plot, source })?;
    }
    let description = text::html(frame.description);
    Ok(format!("<div class=\"plot\" role=\"img\" aria-label=\"{description}\">\n{svg}</div>\n"))
}

/// Text of the plots.
pub(super) fn label_style() -> TextStyle<'static> {
    ("sans-serif", TEXT_PX).into_font().color(&INK)
}

/// Small text that stands on its point.
pub(super) fn centred() -> TextStyle<'static> {
    ("sans-serif", TEXT_PX - 3).into_font().color(&INK).pos(Pos::new(HPos::Center, VPos::Bottom))
}

/// Names of the axes and about how many labels they carry.
pub(super) struct Axes<'a> {
    /// Below.
    pub(super) x: &'a str,
    /// At the left.
    pub(super) y: &'a str,
    /// Labels along x.
    pub(super) x_labels: usize,
    /// Labels along y.
    pub(super) y_labels: usize,
    /// Decimals of the labels of both.
    pub(super) decimals: usize,
}

/// Draws the grid and the axes.
pub(super) fn draw_axes(chart: &mut Chart<'_, '_>, axes: &Axes<'_>) -> Drawn {
    let decimals = axes.decimals;
    let format = move |value: &f64| format!("{value:.decimals$}");
    chart
        .configure_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(AXIS)
        .label_style(label_style())
        .axis_desc_style(label_style())
        .x_desc(axes.x)
        .y_desc(axes.y)
        .x_labels(axes.x_labels)
        .y_labels(axes.y_labels)
        .x_label_formatter(&format)
        .y_label_formatter(&format)
        .draw()?;
    Ok(())
}
