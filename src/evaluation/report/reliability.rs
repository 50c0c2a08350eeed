//! How often the best candidate is right, over the confidence in it: points on the diagonal say that the
//! confidence is a probability. Below, how many frames each bin holds.

use plotters::prelude::*;

use super::canvas::{Area, Axes, Chart, Drawn, Frame, Refusal, centred, draw, draw_axes};
use super::palette::{AXIS, color, label};
use super::{ReportError, cells};
use crate::evaluation::metrics::ReliabilityBin;
use crate::evaluation::results::MethodResult;

const SIZE: (u32, u32) = (520, 570);
/// Height of the upper part in the same pixels.
const UPPER: u32 = 395;

/// The diagram of one method, or `None` where no bin holds a frame.
pub(super) fn plot(result: &MethodResult) -> Result<Option<String>, ReportError> {
    let bins: Vec<&ReliabilityBin> = result.calibration.bins.iter().filter(|bin| is_drawable(bin)).collect();
    if bins.is_empty() {
        return Ok(None);
    }
    let description = describe(result, &bins);
    let frame = Frame { plot: "reliability diagram", description: &description, size: SIZE };
    draw(&frame, |area| {
        let (upper, lower) = area.split_vertically(UPPER);
        paint_accuracy(&upper, result, &bins)?;
        paint_counts(&lower, result, &bins)
    })
    .map(Some)
}

fn is_drawable(bin: &ReliabilityBin) -> bool {
    bin.n > 0 && [bin.low, bin.high].iter().all(|edge| (0.0..=1.0).contains(edge))
}

fn describe(result: &MethodResult, bins: &[&ReliabilityBin]) -> String {
    let mut sentences = vec![format!("Reliability of {}.", label(result))];
    for bin in bins {
        let accuracy = bin.accuracy.as_ref().map_or(f64::NAN, |accuracy| accuracy.rate);
        sentences.push(format!(
            "Confidence {:.1} to {:.1}: {} right of {}.",
            bin.low,
            bin.high,
            cells::decimal(accuracy),
            cells::thousands(bin.n)
        ));
    }
    sentences.join(" ")
}

fn paint_accuracy(area: &Area<'_>, result: &MethodResult, bins: &[&ReliabilityBin]) -> Drawn {
    let mut chart = chart(area, 1.0, 30)?;
    draw_axes(&mut chart, &Axes { x: "", y: "Share that is right", x_labels: 6, y_labels: 6, decimals: 1 })?;
    chart.draw_series(DashedLineSeries::new([(0.0, 0.0), (1.0, 1.0)], 6, 6, AXIS.stroke_width(2)))?;
    let color = color(result.method);
    for bin in bins {
        let (Some(confidence), Some(accuracy)) = (bin.mean_confidence, bin.accuracy.as_ref()) else {
            continue;
        };
        let ends = [(confidence, accuracy.low), (confidence, accuracy.high)];
        let shares = [confidence, accuracy.low, accuracy.high, accuracy.rate];
        if shares.iter().all(|share| (0.0..=1.0).contains(share)) {
            chart.draw_series([PathElement::new(ends, color.stroke_width(3))])?;
            chart.draw_series([Circle::new((confidence, accuracy.rate), 7, color.filled())])?;
        }
    }
    Ok(())
}

fn paint_counts(area: &Area<'_>, result: &MethodResult, bins: &[&ReliabilityBin]) -> Drawn {
    let most = bins.iter().map(|bin| bin.n).max().unwrap_or(1) as f64;
    // Room for the numbers over the bars.
    let mut chart = chart(area, most * 1.3, 50)?;
    draw_axes(&mut chart, &Axes { x: "Confidence", y: "Frames", x_labels: 6, y_labels: 0, decimals: 1 })?;
    for bin in bins {
        let gap = (bin.high - bin.low) * 0.08;
        let bar = [(bin.low + gap, 0.0), (bin.high - gap, bin.n as f64)];
        chart.draw_series([Rectangle::new(bar, color(result.method).mix(0.55).filled())])?;
        let middle = f64::midpoint(bin.low, bin.high);
        chart.draw_series([Text::new(cells::thousands(bin.n), (middle, bin.n as f64), centred())])?;
    }
    Ok(())
}

/// Both parts stand over each other, so that their confidences line up.
fn chart<'a, 'b>(area: &'a Area<'b>, top: f64, x_labels_px: u32) -> Result<Chart<'a, 'b>, Refusal> {
    Ok(ChartBuilder::on(area)
        .margin_top(12)
        .margin_right(24)
        .margin_left(8)
        .x_label_area_size(x_labels_px)
        .y_label_area_size(58)
        .build_cartesian_2d(0.0..1.0, 0.0..top)?)
}
