//! The counter between recognition, which alone touches the map, and the thread that looks after models.
//!
//! Over it go thumbnails of keyframes that are to be described, and back come their descriptors. Recognition looks
//! after it with every frame, a little at a time, and never waits for it.

use std::sync::Arc;

use crossbeam_channel::{Receiver, Sender};

use super::QUEUE_FRAMES;
use crate::place_map::{Appearance, ExperienceId};
use crate::recognition::{Exhibit, Recogniser, Walk};

/// Orders that wait at most: all of them are carried out with the next frame.
pub(super) const ORDERS: usize = 16;
/// Keyframes that wait to be described at most. They are shown after a frame, so at three frames a second hundreds are
/// described within a minute.
pub(super) const EXHIBITS: usize = 8;

/// Frames that were described and not decided yet, at most: those of a queue, and one at either end of it.
const UNDECIDED: usize = QUEUE_FRAMES + 2;

/// What the one who looks after models wants.
pub(super) enum Order {
    /// To be shown all keyframes that have no descriptor of the model of this hash, and no others any more.
    Show(Arc<str>),
    /// That a keyframe gets this descriptor.
    Renew(ExperienceId, Appearance),
    /// That the descriptors made for the model of this hash are forgotten.
    Forget(Arc<str>),
}

/// What is shown for the model of that hash.
pub(super) enum Shown {
    /// One keyframe.
    Keyframe(Arc<str>, Exhibit),
    /// Those were all.
    All(Arc<str>),
}

/// Recognition's side of the counter.
pub(super) struct Desk {
    orders: Receiver<Order>,
    shown: Sender<Shown>,
    walk: Option<(Arc<str>, Walk)>,
    /// Models that are to be forgotten, and after how many frames: of what they described some waits to be decided.
    forgotten: Vec<(Arc<str>, usize)>,
}

impl Desk {
    pub(super) fn new(orders: Receiver<Order>, shown: Sender<Shown>) -> Self {
        Self { orders, shown, walk: None, forgotten: Vec::new() }
    }

    /// Carries out what was ordered: before a frame is decided, since whoever offered the model that described it had
    /// ordered all that it is compared with.
    pub(super) fn take_orders(&mut self, recogniser: &mut Recogniser) {
        for (model, frames_left) in &mut self.forgotten {
            *frames_left -= 1;
            if *frames_left == 0 {
                recogniser.forget_renewed(model);
            }
        }
        self.forgotten.retain(|(_, frames_left)| *frames_left > 0);
        for order in self.orders.try_iter().take(ORDERS) {
            match order {
                Order::Show(model) => self.walk = Some((Arc::clone(&model), Walk::new(model.to_string()))),
                Order::Renew(keyframe, appearance) => recogniser.renew(keyframe, appearance),
                Order::Forget(model) => self.forgotten.push((model, UNDECIDED)),
            }
        }
    }

    /// Shows as many keyframes as there is room for.
    pub(super) fn show(&mut self, recogniser: &mut Recogniser) {
        while !self.shown.is_full() {
            let Some((model, walk)) = &mut self.walk else { return };
            let shown = match recogniser.walk_on(walk) {
                Some(exhibit) => Shown::Keyframe(Arc::clone(model), exhibit),
                None if walk.is_over() => Shown::All(Arc::clone(model)),
                None => return,
            };
            if matches!(shown, Shown::All(_)) {
                self.walk = None;
            }
            // Nobody else sends, so there is room; at the end nobody listens.
            let _ = self.shown.try_send(shown);
        }
    }
}
