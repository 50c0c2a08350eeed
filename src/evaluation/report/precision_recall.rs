//! Precision over recall at every threshold, all methods in one plot, with the shipped threshold
//! marked. The line is the step function whose area is the AUC of the table.

use plotters::prelude::*;

use super::canvas::{Area, Axes, Chart, Drawn, Frame, draw, draw_axes};
use super::palette::{Marker, color, corners, is_dashed, label, marker};
use super::{ReportError, cells};
use crate::evaluation::metrics::PrecisionRecall;
use crate::evaluation::results::MethodResult;

const SIZE: (u32, u32) = (860, 560);
/// Points of a curve closer than this in recall are drawn as one column.
const COLUMN: f64 = 1.0 / 1000.0;

/// The plot, or `None` where no method has a curve.
pub(super) fn plot(results: &[MethodResult]) -> Result<Option<String>, ReportError> {
    let curves: Vec<(&MethodResult, Vec<(f64, f64)>)> = results
        .iter()
        .map(|result| (result, steps(&result.precision_recall)))
        .filter(|(_, steps)| !steps.is_empty())
        .collect();
    if curves.is_empty() {
        return Ok(None);
    }
    let description = describe(&curves);
    let frame = Frame { plot: "precision-recall curves", description: &description, size: SIZE };
    draw(&frame, |area| paint(area, &curves)).map(Some)
}

fn describe(curves: &[(&MethodResult, Vec<(f64, f64)>)]) -> String {
    let mut sentences = vec!["Precision over recall.".to_owned()];
    for (result, _) in curves {
        let auc = result.figures.auc.as_ref().map_or(f64::NAN, |auc| auc.value);
        sentences.push(format!("{}: area {}.", label(result), cells::decimal(auc)));
    }
    sentences.join(" ")
}

fn paint(area: &Area<'_>, curves: &[(&MethodResult, Vec<(f64, f64)>)]) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .margin(14)
        .x_label_area_size(52)
        .y_label_area_size(62)
        .build_cartesian_2d(0.0..1.02, 0.0..1.02)?;
    draw_axes(&mut chart, &Axes { x: "Recall", y: "Precision", x_labels: 6, y_labels: 6, decimals: 1 })?;
    for (result, steps) in curves {
        let style = color(result.method).stroke_width(3);
        if is_dashed(result.database) {
            chart.draw_series(DashedLineSeries::new(steps.iter().copied(), 12, 7, style))?;
        } else {
            chart.draw_series(LineSeries::new(steps.iter().copied(), style))?;
        }
    }
    for (result, _) in curves {
        if let Some(point) = operating_point(result) {
            paint_mark(&mut chart, point, result)?;
        }
    }
    Ok(())
}

/// A mark in a white ring, which keeps marks apart that lie over each other; hollow where lines are dashed.
fn paint_mark(chart: &mut Chart<'_, '_>, point: (f64, f64), result: &MethodResult) -> Drawn {
    let area = chart.plotting_area();
    let shape = marker(result.method);
    let core = if is_dashed(result.database) { WHITE } else { color(result.method) };
    let layers = match shape {
        Marker::Circle => [(11, WHITE), (9, color(result.method)), (5, core)],
        Marker::Triangle => [(16, WHITE), (12, color(result.method)), (5, core)],
        Marker::Square => [(12, WHITE), (10, color(result.method)), (6, core)],
    };
    for (radius, fill) in layers {
        if shape == Marker::Circle {
            area.draw(&Circle::new(point, radius, fill.filled()))?;
        } else {
            area.draw(&(EmptyElement::at(point) + Polygon::new(corners(shape, radius), fill.filled())))?;
        }
    }
    Ok(())
}

/// Recall and precision at the shipped threshold.
fn operating_point(result: &MethodResult) -> Option<(f64, f64)> {
    let recall = result.figures.recall.as_ref().filter(|recall| recall.n > 0)?;
    let precision = result.figures.precision.as_ref().filter(|precision| precision.n > 0)?;
    Some((recall.rate, precision.rate)).filter(|&(x, y)| is_share(x) && is_share(y))
}

fn is_share(value: f64) -> bool {
    (0.0..=1.0).contains(&value)
}

/// Corners of the step function, from the highest threshold to the lowest: between two recalls, the
/// precision of the larger one. Columns narrower than a pixel keep their ends and extremes alone.
fn steps(curve: &PrecisionRecall) -> Vec<(f64, f64)> {
    let mut points: Vec<_> =
        curve.points.iter().filter(|point| is_share(point.recall) && is_share(point.precision)).collect();
    points.sort_by(|a, b| b.threshold.total_cmp(&a.threshold));
    let mut corners = Vec::new();
    let mut recall = 0.0;
    for point in points {
        corners.push((recall, point.precision));
        corners.push((point.recall, point.precision));
        recall = point.recall;
    }
    thin(&corners)
}

/// In each run of corners within one column: the first, the lowest, the highest and the last, in order.
fn thin(corners: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut thinned: Vec<(f64, f64)> = Vec::new();
    for run in corners.chunk_by(|a, b| (a.0 / COLUMN).floor() == (b.0 / COLUMN).floor()) {
        let by_precision = |a: &usize, b: &usize| run[*a].1.total_cmp(&run[*b].1);
        let lowest = (0..run.len()).min_by(by_precision).unwrap_or(0);
        let highest = (0..run.len()).max_by(by_precision).unwrap_or(0);
        let mut kept = vec![0, lowest, highest, run.len() - 1];
        kept.sort_unstable();
        kept.dedup();
        thinned.extend(kept.into_iter().map(|index| run[index]));
    }
    thinned.dedup();
    thinned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::metrics::PrecisionRecallPoint;

    fn curve(points: &[(f64, f64, f64)]) -> PrecisionRecall {
        let point = |&(threshold, precision, recall)| PrecisionRecallPoint { threshold, precision, recall };
        PrecisionRecall { points: points.iter().map(point).collect() }
    }

    #[test]
    fn the_area_under_the_steps_is_the_average_precision() {
        let steps = steps(&curve(&[(0.2, 0.5, 0.6), (0.9, 1.0, 0.2), (0.5, 0.75, 0.6)]));
        assert_eq!(steps, [(0.0, 1.0), (0.2, 1.0), (0.2, 0.75), (0.6, 0.75), (0.6, 0.5)]);
    }

    #[test]
    fn a_curve_that_is_no_curve_is_left_out() {
        assert!(steps(&curve(&[])).is_empty());
        assert!(steps(&curve(&[(0.5, f64::NAN, 0.1)])).is_empty());
        assert_eq!(steps(&curve(&[(0.5, 1.0, 0.25)])), [(0.0, 1.0), (0.25, 1.0)]);
    }

    #[test]
    fn a_long_curve_is_drawn_with_bounded_points_and_keeps_its_dips() {
        let many: Vec<(f64, f64, f64)> = (0..200_000_u32)
            .map(|index| {
                let share = f64::from(index) / 200_000.0;
                (1.0 - share, if index == 77_777 { 0.1 } else { 0.9 }, share)
            })
            .collect();
        let steps = steps(&curve(&many));
        assert!(steps.len() <= 4 * 1001, "{}", steps.len());
        assert!(steps.iter().any(|&(_, precision)| precision < 0.2));
    }
}
