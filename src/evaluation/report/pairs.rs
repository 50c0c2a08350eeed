//! The worst mistakes as pictures: the query beside its reference in one SVG, a line for each inlier.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::{cells, text};
use crate::evaluation::results::{ImagePair, Mistake, Picture};

/// Height of both pictures in the SVG's pixels.
const HEIGHT_PX: f64 = 300.0;
const GAP_PX: f64 = 8.0;
/// Lines beyond this hide the pictures and swell the file.
const MAX_LINES: usize = 150;

/// A figure with both pictures and what is known of the mistake.
pub(super) fn figure(pair: &ImagePair) -> String {
    let lines = drawable_lines(pair);
    let (tag, class) = match pair.mistake {
        Mistake::FalseAccept => ("False accept", "accept"),
        Mistake::Miss => ("Miss", "miss"),
    };
    let omitted = if lines.len() > MAX_LINES {
        format!(" ({MAX_LINES} of {} lines drawn)", cells::thousands(lines.len() as u64))
    } else {
        String::new()
    };
    format!(
        "<figure class=\"pair\">\n{}<figcaption><span class=\"tag {class}\">{tag}</span> \
         <code>{}</code> <span class=\"quiet\">beside</span> <code>{}</code><br/>\
         confidence {}, {} effective inliers{omitted}: {}</figcaption>\n</figure>\n",
        picture_svg(pair, &lines[..lines.len().min(MAX_LINES)]),
        text::html(&pair.query.name),
        text::html(&pair.reference.name),
        cells::decimal(pair.confidence),
        cells::thousands(pair.effective_inliers.into()),
        text::html(&pair.reason),
    )
}

fn drawable_lines(pair: &ImagePair) -> Vec<[f32; 4]> {
    let within = |line: &&[f32; 4]| line.iter().all(|share| (0.0..=1.0).contains(share));
    pair.inliers.iter().filter(within).copied().collect()
}

fn picture_svg(pair: &ImagePair, lines: &[[f32; 4]]) -> String {
    let left = shown_width_px(&pair.query);
    let right = shown_width_px(&pair.reference);
    let offset = left + GAP_PX;
    let width = offset + right;
    let alt = text::html(&format!("Query {} beside reference {}", pair.query.name, pair.reference.name));
    let mut svg = format!(
        "<svg viewBox=\"0 0 {width:.0} {HEIGHT_PX:.0}\" role=\"img\" aria-label=\"{alt}\" \
         style=\"max-width:{width:.0}px\">\n"
    );
    svg += &image(&pair.query, 0.0, left);
    svg += &image(&pair.reference, offset, right);
    let (path, ends) = line_paths(lines, left, (offset, right));
    if !lines.is_empty() {
        // Black under yellow is seen on bright and on dark pictures.
        let _ = write!(
            svg,
            "<path class=\"under\" d=\"{path}\"/>\n<path class=\"inlier\" d=\"{path}\"/>\n\
             <path class=\"end\" d=\"{ends}\"/>\n"
        );
    }
    svg += "</svg>\n";
    svg
}

/// Width at the common height; pictures of odd shapes are kept between 1:3 and 3:1.
fn shown_width_px(picture: &Picture) -> f64 {
    let aspect = f64::from(picture.width_px.max(1)) / f64::from(picture.height_px.max(1));
    (HEIGHT_PX * aspect.clamp(1.0 / 3.0, 3.0)).round()
}

fn image(picture: &Picture, x: f64, width: f64) -> String {
    if picture.jpeg.is_empty() {
        return format!(
            "<rect class=\"missing\" x=\"{x:.0}\" y=\"0\" width=\"{width:.0}\" height=\"{HEIGHT_PX:.0}\"/>\n"
        );
    }
    format!(
        "<image x=\"{x:.0}\" y=\"0\" width=\"{width:.0}\" height=\"{HEIGHT_PX:.0}\" preserveAspectRatio=\"none\" \
         href=\"data:image/jpeg;base64,{}\"/>\n",
        STANDARD.encode(&picture.jpeg)
    )
}

/// All lines as one path, and all their ends as another of dots.
fn line_paths(lines: &[[f32; 4]], left: f64, (offset, right): (f64, f64)) -> (String, String) {
    let (mut path, mut ends) = (String::new(), String::new());
    for line in lines {
        let [query_x, query_y, reference_x, reference_y] = line.map(f64::from);
        let (x1, y1) = (query_x * left, query_y * HEIGHT_PX);
        let (x2, y2) = (offset + reference_x * right, reference_y * HEIGHT_PX);
        let _ = write!(path, "M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}");
        let _ = write!(ends, "M{x1:.1} {y1:.1}h0M{x2:.1} {y2:.1}h0");
    }
    (path, ends)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(inliers: Vec<[f32; 4]>) -> ImagePair {
        let picture =
            |name: &str| Picture { name: name.into(), jpeg: vec![0xff, 0xd8], width_px: 40, height_px: 30 };
        ImagePair {
            mistake: Mistake::Miss,
            query: picture("q"),
            reference: picture("<r>"),
            confidence: 0.25,
            reason: "too few inliers".into(),
            effective_inliers: 7,
            inliers,
        }
    }

    #[test]
    fn lines_join_the_shares_of_both_pictures() {
        let figure = figure(&pair(vec![[0.5, 0.5, 1.0, 0.0]]));
        assert!(figure.contains("M200.0 150.0L808.0 0.0"), "{figure}");
        assert!(figure.contains("data:image/jpeg;base64,/9g="));
        assert!(figure.contains("&lt;r&gt;") && !figure.contains("<r>"));
    }

    #[test]
    fn lines_outside_the_pictures_are_not_drawn() {
        let figure = figure(&pair(vec![[f32::NAN, 0.5, 0.5, 0.5], [0.5, 0.5, 1.5, 0.0]]));
        assert!(!figure.contains("<path"));
    }

    #[test]
    fn lines_beyond_the_most_are_told() {
        let figure = figure(&pair(vec![[0.5; 4]; MAX_LINES + 50]));
        assert!(figure.contains("(150 of 200 lines drawn)"));
    }

    #[test]
    fn a_picture_without_size_or_bytes_is_a_grey_box() {
        let mut pair = pair(vec![]);
        pair.query = Picture { name: "q".into(), jpeg: vec![], width_px: 0, height_px: 0 };
        assert!(figure(&pair).contains("class=\"missing\" x=\"0\" y=\"0\" width=\"300\""));
    }
}
