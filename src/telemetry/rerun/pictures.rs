//! Pictures that take each other's place.
//!
//! rerun 0.36 takes the JPEGs of an entity for one video: all have the size and sampling of the first, the last one
//! goes on being shown though it was cleared, and a row without a picture breaks the viewer. So each kind of picture
//! has an entity of its own, the first one the path itself, `camera/image`, further ones `camera/images/1` and so on;
//! what is on show lies above all others, and above a black cover, `camera/images/cover`.

use std::collections::HashMap;

use ::rerun::{
    AsComponents, ColorModel, EncodedImage, Image, RecordingStream, RecordingStreamResult, Transform3D,
};

use super::jpeg::{self, JpegKind};

/// The lowest of all, far below what is drawn on pictures; every other kind and cover lies one above the one before. A
/// number of 32 bits counts so far without a gap.
const LOWEST: f32 = -16_000_000.0;
/// Where pictures would reach what is drawn on them.
const HIGHEST: f32 = -1000.0;
/// Kinds that are shown; pictures of further ones are not.
const MOST_KINDS: usize = 64;

/// What the pictures of an entity have in common.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    Jpeg(JpegKind),
    Raw,
}

/// Where a picture lies: its upper left corner, and how large a pixel of it is.
#[derive(Clone, Copy)]
pub(super) struct Area {
    pub(super) corner: [f32; 2],
    pub(super) scale: [f32; 2],
}

impl Area {
    /// At the origin, pixel for pixel.
    pub(super) const PLAIN: Self = Self { corner: [0.0; 2], scale: [1.0; 2] };

    fn transform(self) -> Transform3D {
        let Self { corner: [x, y], scale: [width, height] } = self;
        Transform3D::from_translation([x, y, 0.0]).with_scale([width, height, 1.0])
    }
}

/// Pictures at a path.
pub(super) struct Pictures {
    path: String,
    /// Kinds, numbered in the order in which they came.
    kinds: HashMap<Kind, usize>,
    /// The kind that is on show.
    shown: Option<Kind>,
    order: f32,
    /// From the uppermost and leftmost corner to the lowest and rightmost one of all pictures so far.
    extent: [[f32; 2]; 2],
}

impl Pictures {
    /// None yet.
    pub(super) fn new(path: impl Into<String>) -> Self {
        Self {
            path: path.into(),
            kinds: HashMap::new(),
            shown: None,
            order: LOWEST,
            extent: [[f32::INFINITY; 2], [f32::NEG_INFINITY; 2]],
        }
    }

    /// Shows a JPEG instead of the picture before; bytes that are none show nothing.
    pub(super) fn show_jpeg(
        &mut self,
        stream: &RecordingStream,
        jpeg: &[u8],
        area: Area,
    ) -> RecordingStreamResult<()> {
        let Some(kind) = jpeg::kind(jpeg) else { return self.hide(stream) };
        let Some(path) = self.uncover(stream, Kind::Jpeg(kind), kind.size_px(), area)? else { return Ok(()) };
        let image = EncodedImage::new(jpeg).with_media_type("image/jpeg").with_draw_order(self.order);
        let placed = area.transform();
        stream.log(path, &[&placed as &dyn AsComponents, &image])
    }

    /// Shows a picture that is no JPEG.
    pub(super) fn show_raw(
        &mut self,
        stream: &RecordingStream,
        image: Image,
        size_px: [f32; 2],
    ) -> RecordingStreamResult<()> {
        let Some(path) = self.uncover(stream, Kind::Raw, size_px, Area::PLAIN)? else { return Ok(()) };
        stream.log(path, &image.with_draw_order(self.order))
    }

    /// Shows none.
    pub(super) fn hide(&mut self, stream: &RecordingStream) -> RecordingStreamResult<()> {
        if self.shown.take().is_none() {
            return Ok(());
        }
        self.order += 1.0;
        let [[left, top], [right, bottom]] = self.extent;
        let area = Area { corner: [left, top], scale: [right - left, bottom - top] };
        let black =
            Image::from_color_model_and_bytes(vec![0], [1, 1], ColorModel::L, ::rerun::ChannelDatatype::U8);
        let (placed, black) = (area.transform(), black.with_draw_order(self.order));
        stream.log(format!("{}s/cover", self.path), &[&placed as &dyn AsComponents, &black])
    }

    /// Makes ready for a picture of this kind, which lies there; its path, unless there are too many kinds.
    fn uncover(
        &mut self,
        stream: &RecordingStream,
        kind: Kind,
        size_px: [f32; 2],
        area: Area,
    ) -> RecordingStreamResult<Option<String>> {
        let kinds = self.kinds.len();
        if kinds >= MOST_KINDS && !self.kinds.contains_key(&kind) {
            self.hide(stream)?;
            return Ok(None);
        }
        let number = *self.kinds.entry(kind).or_insert(kinds);
        if self.shown != Some(kind) {
            self.hide(stream)?;
            self.shown = Some(kind);
            self.order = if self.order < HIGHEST { self.order + 1.0 } else { LOWEST };
        }
        let [least, greatest] = &mut self.extent;
        for axis in 0..2 {
            least[axis] = least[axis].min(area.corner[axis]);
            greatest[axis] = greatest[axis].max(area.corner[axis] + area.scale[axis] * size_px[axis]);
        }
        Ok(Some(if number == 0 { self.path.clone() } else { format!("{}s/{number}", self.path) }))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{chunks_of, rows, values};
    use super::*;
    use crate::codec;
    use crate::raster::RgbImage;

    #[test]
    fn every_kind_of_picture_has_an_entity_and_a_cover_hides_what_is_not_on_show() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pictures.rrd");
        let stream = ::rerun::RecordingStreamBuilder::new("pictures").save(&file).unwrap();
        let mut pictures = Pictures::new("camera/image");
        pictures.hide(&stream).unwrap();
        for width in [64, 64, 32, 64] {
            pictures.show_jpeg(&stream, &codec::jpeg(&RgbImage::new(width, 48)), Area::PLAIN).unwrap();
        }
        pictures.hide(&stream).unwrap();
        pictures.hide(&stream).unwrap();
        stream.flush_blocking().unwrap();
        drop(stream);
        let chunks = chunks_of(&file);
        assert_eq!((rows(&chunks, "camera/image"), rows(&chunks, "camera/images/1")), (3, 1));
        assert_eq!(rows(&chunks, "camera/images/cover"), 3);
        let scale = values(&chunks, "camera/images/cover", "Transform3D:scale");
        assert!(scale.contains("64.0") && scale.contains("48.0"), "{scale}");
        // Each lies above all before it.
        for (path, component, orders) in [
            ("camera/image", "EncodedImage:draw_order", ["-15999999.0", "-15999995.0"]),
            ("camera/images/cover", "Image:draw_order", ["-15999998.0", "-15999994.0"]),
            ("camera/images/1", "EncodedImage:draw_order", ["-15999997.0", "-15999997.0"]),
        ] {
            let told = values(&chunks, path, component);
            assert!(orders.iter().all(|order| told.contains(order)), "{path}: {told}");
        }
    }

    #[test]
    fn what_is_no_jpeg_shows_nothing_and_neither_does_one_kind_too_many() {
        let stream = RecordingStream::disabled();
        let mut pictures = Pictures::new("camera/image");
        pictures.show_jpeg(&stream, b"no picture", Area::PLAIN).unwrap();
        assert!(pictures.shown.is_none());
        for width in 1..=MOST_KINDS {
            pictures.show_jpeg(&stream, &codec::jpeg(&RgbImage::new(width, 1)), Area::PLAIN).unwrap();
            assert!(pictures.shown.is_some());
        }
        pictures.show_jpeg(&stream, &codec::jpeg(&RgbImage::new(99, 1)), Area::PLAIN).unwrap();
        assert!(pictures.shown.is_none());
    }
}
