//! Frames from a driver's buffers, read where they lie.

use std::fmt::Write;

use v4l::buffer::{Flags, Metadata};

use super::device::Delivery;
use super::pixels;
use super::spec::PixelFormat;
use crate::codec::{self, CodecError};
use crate::frame::{Frame, FrameMemory};
use crate::kernel::luma_in;

/// Makes frames of buffers.
pub(super) struct Developer {
    /// The camera as it was named.
    pub(super) device: String,
    pub(super) delivery: Delivery,
}

impl Developer {
    /// The frame in `bytes`, with its number and time of capture; the error is the reason without the device. A JPEG
    /// has the size that it says, whatever was agreed on.
    pub(super) fn frame(
        &self,
        bytes: &[u8],
        metadata: &Metadata,
        (index, capture_nanos): (u64, i64),
        spare: Option<Frame>,
    ) -> Result<Frame, String> {
        let FrameMemory { mut name, colour, grey, jpeg: mut kept } = FrameMemory::of(spare);
        name.clear();
        // Writing to a text does not fail.
        let _ = write!(name, "{}#{index:06}", self.device);
        let spoilt = |reason| format!("frame {index}: {reason}; try another cable or USB port");
        if metadata.flags.contains(Flags::ERROR) {
            return Err(spoilt("the driver says that it is damaged".to_owned()));
        }
        let Delivery { format, layout, range, .. } = self.delivery;
        let jpeg = without_padding(bytes);
        let colour = match format {
            PixelFormat::Mjpg if jpeg.is_empty() => Err("it is empty".to_owned()),
            PixelFormat::Mjpg => codec::decode(jpeg, colour).map_err(what_is_wrong),
            PixelFormat::Yuyv => pixels::rgb_from_yuyv(bytes, layout, range, colour),
            PixelFormat::Nv12 => pixels::rgb_from_nv12(bytes, layout, range, colour),
            PixelFormat::Grey => pixels::rgb_from_grey(bytes, layout, colour),
        };
        let colour = colour.map_err(spoilt)?;
        let grey = luma_in(&colour, grey);
        let jpeg = (format == PixelFormat::Mjpg).then(|| {
            kept.clear();
            kept.extend_from_slice(jpeg);
            kept
        });
        Ok(Frame { index, capture_nanos, name, colour, grey, jpeg, pose: None, true_place: None })
    }
}

/// A JPEG ends with an end marker; some drivers fill up the first buffers behind it with zeros.
fn without_padding(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    &bytes[..end]
}

/// What the decoder says without its advice, which is about files.
fn what_is_wrong(CodecError { reason }: CodecError) -> String {
    reason.split("; ").next().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::RgbImage;
    use crate::source::camera::pixels::{Layout, Range};

    const TAKEN: (u64, i64) = (123, 456);

    fn developer(format: PixelFormat) -> Developer {
        let layout = Layout { width_px: 40, height_px: 32, stride_bytes: 0 };
        let delivery = Delivery { format, layout, range: Range::Limited, fps: None };
        Developer { device: "/dev/video0".to_owned(), delivery }
    }

    #[test]
    fn a_padded_mjpg_frame_becomes_a_frame_with_its_jpeg() {
        let jpeg = codec::jpeg(&RgbImage::new(40, 32));
        let padded = [jpeg.as_slice(), &[0; 100]].concat();
        let frame = developer(PixelFormat::Mjpg).frame(&padded, &Metadata::default(), TAKEN, None).unwrap();
        assert_eq!(frame.jpeg, Some(jpeg));
        assert_eq!((frame.index, frame.capture_nanos, frame.name.as_str()), (123, 456, "/dev/video0#000123"));
        assert_eq!((frame.colour.width(), frame.grey.height()), (40, 32));
    }

    #[test]
    fn a_frame_is_the_same_in_the_memory_of_another_one() {
        let jpeg = codec::jpeg(&RgbImage::new(40, 32));
        let raw = [90; 2560];
        let formats = [
            (PixelFormat::Mjpg, jpeg.as_slice()),
            (PixelFormat::Yuyv, &raw[..]),
            (PixelFormat::Nv12, &raw[..1920]),
            (PixelFormat::Grey, &raw[..1280]),
        ];
        let other = Frame { jpeg: Some(vec![1; 9]), name: "other".to_owned(), ..Frame::numbered(7) };
        for (format, bytes) in formats {
            let frame = |spare| {
                let frame = developer(format).frame(bytes, &Metadata::default(), TAKEN, spare).unwrap();
                (frame.name, frame.colour, frame.grey, frame.jpeg)
            };
            assert_eq!(frame(Some(other.clone())), frame(None));
        }
    }

    #[test]
    fn a_jpeg_of_another_size_than_agreed_is_taken_as_it_is() {
        let jpeg = codec::jpeg(&RgbImage::new(64, 48));
        let frame = developer(PixelFormat::Mjpg).frame(&jpeg, &Metadata::default(), TAKEN, None).unwrap();
        assert_eq!((frame.colour.width(), frame.grey.height()), (64, 48));
    }

    #[test]
    fn a_broken_frame_is_reported_with_its_number() {
        let jpeg = codec::jpeg(&RgbImage::new(40, 32));
        let cases = [
            (PixelFormat::Mjpg, &jpeg[..jpeg.len() - 2], "the JPEG is cut off"),
            (PixelFormat::Mjpg, &[0; 50], "it is empty"),
            (PixelFormat::Yuyv, &[0; 2559], "the frame is cut off: 2559 of 2560 bytes arrived"),
            (PixelFormat::Nv12, &[0; 1919], "the frame is cut off: 1919 of 1920 bytes arrived"),
            (PixelFormat::Grey, &[0; 1279], "the frame is cut off: 1279 of 1280 bytes arrived"),
        ];
        for (format, bytes, what) in cases {
            let error = developer(format).frame(bytes, &Metadata::default(), TAKEN, None).unwrap_err();
            let expected = format!("frame 123: {what}; try another cable or USB port");
            assert_eq!(error, expected);
        }
        let damaged = Metadata { flags: Flags::ERROR, ..Metadata::default() };
        let error = developer(PixelFormat::Grey).frame(&[0; 1280], &damaged, TAKEN, None).unwrap_err();
        assert!(error.contains("frame 123: the driver says that it is damaged"), "{error}");
    }

    #[test]
    fn raw_frames_have_the_luma_of_the_camera() {
        let frame =
            developer(PixelFormat::Grey).frame(&[77; 1280], &Metadata::default(), TAKEN, None).unwrap();
        assert_eq!((frame.grey.get(39, 31), frame.colour.row(31)[119]), (77, 77));
        assert!(frame.jpeg.is_none());
        for (format, bytes) in [(PixelFormat::Yuyv, &[128; 2560][..]), (PixelFormat::Nv12, &[128; 1920])] {
            let frame = developer(format).frame(bytes, &Metadata::default(), TAKEN, None).unwrap();
            assert_eq!((frame.grey.get(39, 31), frame.colour.row(31)[119]), (130, 130));
        }
    }
}
