//! A training as a page: how it stands, how every epoch went, and how large the clusters are.
//!
//! One file that loads nothing from anywhere.

use std::fmt::Write as _;

use plotters::prelude::*;

use super::clusters::Clusters;
use super::fitting::Epoch;
use super::pictures::Pictures;
use super::standing::{Standing, figure};
use super::trained_model::TrainedModel;

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;\
    color:#1c2230;background:#fff}table{border-collapse:collapse;margin:1rem 0}th,td{text-align:right;\
    padding:.3rem .8rem;border-bottom:1px solid #d5dae3}th:first-child,td:first-child{text-align:left}\
    svg{max-width:100%;height:auto}p.verdict{padding:.6rem 1rem;border-left:4px solid #0a6d4f;background:#eef7f3}\
    p.refused{border-color:#b3261e;background:#fbeeed}";
const SIZE: (u32, u32) = (860, 300);
const LINE: RGBColor = RGBColor(10, 109, 79);
/// Bars of a histogram at most.
const MOST_BARS: usize = 40;

/// What the page is about.
pub struct TrainingReport<'a> {
    /// The classes.
    pub clusters: &'a Clusters,
    /// Their images.
    pub pictures: &'a Pictures<'a>,
    /// How every epoch went.
    pub epochs: &'a [Epoch],
    /// What came of it.
    pub model: &'a TrainedModel,
}

impl TrainingReport<'_> {
    /// The page.
    #[must_use]
    pub fn html(&self) -> String {
        let name = escaped(&self.model.card.name);
        let description = escaped(&self.model.card.description);
        let mut page = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\"/>\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
             <title>Training of {name}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n\
             <h1>Training of {name}</h1>\n<p>{description}</p>\n"
        );
        page += &self.verdict();
        page += &self.standings();
        page += &self.epochs();
        page += &self.data();
        page += "</body>\n</html>\n";
        page
    }

    fn verdict(&self) -> String {
        match self.model.fault() {
            None => "<p class=\"verdict\">It does as well on what was held out as the model that it is to take the \
                     place of, and as class means without any training: accepted.</p>\n"
                .to_owned(),
            Some(fault) => format!(
                "<p class=\"verdict refused\">It {fault}: kept aside, unless it was taken all the same.</p>\n"
            ),
        }
    }

    fn standings(&self) -> String {
        let row = |name: &str, standing: &Standing| {
            let (low, high) = standing.recall_interval();
            format!(
                "<tr><td>{name}</td><td>{:.3} ({low:.3} to {high:.3})</td><td>{}</td><td>{:.3}</td>\
                 <td>{}</td></tr>\n",
                standing.recall(),
                figure(standing.precision()),
                standing.recall_at_one(),
                figure(standing.calibration.map(|calibration| calibration.threshold))
            )
        };
        format!(
            "<h2>What was held out</h2>\n<table>\n<tr><th>{} images</th><th>recall (95 %)</th><th>precision</th>\
             <th>R@1</th><th>threshold</th></tr>\n{}{}{}</table>\n\
             <p>At least the latest fifth of every place, which no training saw. An image is recognised if the \
             nearest one that was learnt is of its place, and its cosine above the threshold; that lets one in two \
             hundred images of other places pass among those that training only looked at and those of places with too \
             few, unless these are within two steps along the way. Without training, the nearest class mean is taken, \
             in the descriptors of the backbone or, where there is none, of the model before. Places next to each \
             other are neither right nor wrong for each other.</p>\n",
            self.model.standing.asked,
            row("this model", &self.model.standing),
            row("the one before", &self.model.rivals.current),
            row("without training", &self.model.rivals.prototypes)
        )
    }

    fn epochs(&self) -> String {
        if self.epochs.is_empty() {
            return String::new();
        }
        let points = |value: &dyn Fn(&Epoch) -> f64| -> Vec<(f64, f64)> {
            self.epochs.iter().map(|epoch| (epoch.number as f64, value(epoch))).collect()
        };
        let loss = plot(("epoch", "loss"), &points(&|epoch| epoch.loss), false);
        let recall = plot(("epoch", "recall"), &points(&|epoch| epoch.recall), false);
        let copies = if self.model.has_copies { ", copies in other light included," } else { "" };
        format!(
            "<h2>Epochs</h2>\n{loss}{recall}<p>Recall is the share of what training only looked at{copies} whose own \
             place is the nearest; the best epoch is kept.</p>\n"
        )
    }

    fn data(&self) -> String {
        let Clusters { classes, strangers, sizes, duplicates, joined_by_pose, unreadable, without_image } =
            self.clusters;
        let mut data = format!(
            "<h2>Clusters</h2>\n{}<p>{} places have enough experiences to be learnt, of {}; {} have too few. {} \
             images were learnt, {} only looked at, {} held out, {} of those with too few show what is no class. \
             {duplicates} were left out as duplicates, {joined_by_pose} joined by pose, {} could not be read, \
             {without_image} have no image any more.</p>\n",
            plot(("experiences of a place", "places"), &histogram(sizes), true),
            classes.len(),
            sizes.len(),
            strangers.len(),
            self.pictures.learnt.len(),
            self.pictures.checked.len(),
            self.pictures.held_out.len(),
            self.pictures.strangers.len(),
            unreadable.len()
        );
        data += "<table>\n<tr><th>place</th><th>learnt or looked at</th><th>held out</th></tr>\n";
        for class in classes {
            let name = class.name.as_deref().map(|name| format!(" {}", escaped(name))).unwrap_or_default();
            let (place, learnt, held_out) = (class.place.0, class.learnt.len(), class.held_out.len());
            let _ = writeln!(data, "<tr><td>{place}{name}</td><td>{learnt}</td><td>{held_out}</td></tr>");
        }
        data + "</table>\n"
    }
}

/// How many clusters are so large, in steps of ten or more: the paper's Fig. 2.
fn histogram(sizes: &[usize]) -> Vec<(f64, f64)> {
    let largest = sizes.iter().max().copied().unwrap_or_default();
    let step = largest.div_ceil(MOST_BARS).next_multiple_of(10).max(10);
    let bars = (0..=largest / step).map(|bar| {
        let count = sizes.iter().filter(|&&size| size / step == bar).count();
        (((bar * step) as f64), count as f64)
    });
    bars.collect()
}

/// A plot of `points`, which stand in order, as a line or as bars; nothing if it cannot be drawn.
fn plot(names: (&str, &str), points: &[(f64, f64)], as_bars: bool) -> String {
    let mut svg = String::new();
    let drawn = draw(SVGBackend::with_string(&mut svg, SIZE).into_drawing_area(), names, points, as_bars);
    if drawn.is_ok() { svg } else { String::new() }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw(
    area: Area<'_>,
    (x, y): (&str, &str),
    points: &[(f64, f64)],
    as_bars: bool,
) -> Result<(), Box<dyn std::error::Error>> {
    let step = match points {
        [first, second, ..] => second.0 - first.0,
        _ => 1.0,
    };
    let (first, last) = (points.first().map_or(0.0, |p| p.0), points.last().map_or(0.0, |p| p.0));
    let highest = points.iter().map(|point| point.1).fold(0.0, f64::max).max(1e-3);
    let mut chart = ChartBuilder::on(&area)
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(60)
        .build_cartesian_2d(first..last + step, 0.0..highest * 1.05)?;
    let (whole, decimal) = (|value: &f64| format!("{value:.0}"), |value: &f64| format!("{value:.2}"));
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT).x_desc(x).y_desc(y).x_label_formatter(&whole);
    mesh.y_label_formatter(&decimal).draw()?;
    if as_bars {
        let bar = |&(at, height): &(f64, f64)| {
            Rectangle::new([(at, 0.0), (at + 0.9 * step, height)], LINE.filled())
        };
        chart.draw_series(points.iter().map(bar))?;
    } else {
        chart.draw_series(LineSeries::new(points.iter().copied(), LINE.stroke_width(2)))?;
    }
    area.present()?;
    Ok(())
}

fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            '"' => escaped += "&quot;",
            '\'' => escaped += "&#39;",
            character => escaped.push(character),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cluster_is_in_one_bar_of_the_histogram() {
        assert_eq!(histogram(&[]), [(0.0, 0.0)]);
        assert_eq!(histogram(&[25, 20, 9, 0]), [(0.0, 2.0), (10.0, 0.0), (20.0, 2.0)]);
        let many: Vec<usize> = (0..10_000).collect();
        let bars = histogram(&many);
        assert!(bars.len() <= MOST_BARS && bars.iter().map(|bar| bar.1).sum::<f64>() == 10_000.0);
    }

    #[test]
    fn names_of_places_are_text_and_not_markup() {
        assert_eq!(escaped("<b a=\"1\">'Hall' & yard"), "&lt;b a=&quot;1&quot;&gt;&#39;Hall&#39; &amp; yard");
    }

    #[test]
    fn a_plot_shows_its_axes_whatever_is_in_it() {
        for points in [&[][..], &[(1.0, 0.0)], &[(1.0, f64::NAN), (2.0, 3.0)]] {
            let svg = plot(("epoch", "loss"), points, false);
            assert!(svg.is_empty() || svg.contains("epoch") && svg.contains("loss"), "{svg}");
        }
        assert!(plot(("epoch", "loss"), &[(1.0, 2.0), (2.0, 1.0)], true).contains("<rect"));
    }
}
