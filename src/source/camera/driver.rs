//! What is wanted of V4L2, as traits: the recovery of a camera is tested without one.

use std::io;
use std::path::Path;
use std::time::Instant;

use v4l::buffer::Metadata;

use super::device::{self, Delivery};
use super::search::{Identity, Node};
use super::spec::CameraSpec;
use super::stream::BufferStream;

/// Where cameras are found and opened.
pub(super) trait Driver: Send {
    /// What an open camera is.
    type Stream: Stream + Send;

    /// What is at `path`; `None` if nothing is.
    fn node(&self, path: &Path) -> Option<Node>;

    /// All nodes that there are.
    fn nodes(&self) -> Vec<Node>;

    /// Opens the camera at `path` and sets it up; the error is the reason without the device.
    fn open(&self, path: &Path, spec: &CameraSpec) -> Result<Connected<Self::Stream>, String>;
}

/// A camera that was opened.
pub(super) struct Connected<S> {
    pub(super) stream: S,
    pub(super) delivery: Delivery,
    pub(super) identity: Identity,
    /// What it is and gives, in words.
    pub(super) description: String,
}

/// The frames of an open camera. It is closed when this is dropped.
pub(super) trait Stream {
    /// The bytes of the next frame, waiting until `deadline`. After an error the next call opens the stream anew.
    fn next(&mut self, deadline: Instant) -> io::Result<(&[u8], Metadata)>;

    /// Whether the device is not there any more.
    fn is_gone(&self) -> bool;

    /// Whether it gives something else by now than what was agreed on.
    fn has_changed(&self, delivery: &Delivery) -> bool;
}

/// The kernel's cameras.
pub(super) struct V4l2;

impl Driver for V4l2 {
    type Stream = BufferStream;

    fn node(&self, path: &Path) -> Option<Node> {
        Node::at(path)
    }

    fn nodes(&self) -> Vec<Node> {
        Node::all()
    }

    fn open(&self, path: &Path, spec: &CameraSpec) -> Result<Connected<BufferStream>, String> {
        device::open(path, spec)
    }
}
