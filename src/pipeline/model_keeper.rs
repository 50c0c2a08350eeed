//! The thread that looks after models while a robot drives: it describes keyframes that the running model has not
//! seen, and brings a model that was deployed meanwhile into use.
//!
//! A new model is opened beside the old one, describes every keyframe of the map, and must pass its self-test; only
//! then is it offered to the stage that describes frames. Whatever fails on the way is said once, and the old one goes
//! on.
//!
//! There is no portable way to a lower priority, and a runtime's own threads would keep it once the model is in use. So
//! this thread rests as long as it has worked.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, bounded, select};

use super::Watcher;
use super::desk::{Desk, EXHIBITS, ORDERS, Order, Shown};
use super::exchange::{Exchange, Replaced};
use super::folder_watch::FolderWatch;
use super::self_test::SelfTest;
use crate::cnn::{CARD_FILE, CnnError, Descriptor, DescriptorModel, ModelCard, OnnxRuntime};
use crate::place_map::Appearance;
use crate::recognition::Exhibit;
use crate::source::decode;

/// Time between two looks at the model's folder.
const LOOK_INTERVAL: Duration = Duration::from_secs(1);
/// Time after a model took over in which nothing is opened: the frames that it describes first have the computer for
/// themselves.
const SETTLING: Duration = Duration::from_secs(30);
/// Longest rest: the end of the stream waits for it.
const LONGEST_REST: Duration = Duration::from_millis(250);

/// Where a model is opened, and is looked for when another one was deployed.
#[derive(Clone, Debug)]
pub struct ModelFolder {
    /// The folder.
    pub path: PathBuf,
    /// What runs it.
    pub runtime: OnnxRuntime,
    /// Threads that it runs on.
    pub threads: usize,
}

impl ModelFolder {
    /// Opens the model that is in the folder now.
    ///
    /// # Errors
    /// Those of [`DescriptorModel::open`].
    pub fn open(&self) -> Result<DescriptorModel, CnnError> {
        DescriptorModel::open(&self.path, &self.runtime, self.threads)
    }
}

/// What is being done.
enum Job {
    /// Nothing: every keyframe has a descriptor of the model in use.
    Rest,
    /// Describing what the model in use has not seen, by a second instance of it.
    Complete(Instance),
    /// Describing everything by the model that is to take over.
    Prepare(Box<DescriptorModel>, SelfTest),
    /// Waiting for what comes of the model that was offered.
    Wait(Arc<ModelCard>),
}

/// A second instance of the model in use.
enum Instance {
    /// It was not needed yet.
    Unopened,
    Open(Box<DescriptorModel>),
    /// Another model lies where it came from.
    Gone,
}

impl Instance {
    /// The instance, opened if it was not.
    fn opened(&mut self, folder: &ModelFolder, hash: &str) -> Option<&mut DescriptorModel> {
        if matches!(self, Self::Unopened) {
            let model = folder.open().ok().filter(|model| model.card().sha256 == hash);
            *self = model.map_or(Self::Gone, |model| Self::Open(Box::new(model)));
        }
        match self {
            Self::Open(model) => Some(model),
            _ => None,
        }
    }
}

/// Looks after models.
pub(super) struct ModelKeeper<'a> {
    folder: ModelFolder,
    watch: FolderWatch,
    watcher: &'a dyn Watcher,
    in_use: Arc<ModelCard>,
    job: Job,
    orders: Sender<Order>,
    shown: Receiver<Shown>,
    offers: Sender<DescriptorModel>,
    replaced: Receiver<Replaced>,
    /// When to describe what was learnt while a model took over.
    completes_at: Option<Instant>,
    is_over: bool,
}

impl<'a> ModelKeeper<'a> {
    /// A keeper of the model of `card`, which came from `folder`; with the counters at which it meets recognition and
    /// the stage that describes frames.
    pub(super) fn new(
        folder: ModelFolder,
        card: &ModelCard,
        watcher: &'a dyn Watcher,
    ) -> (Self, Desk, Exchange) {
        let (orders, ordered) = bounded(ORDERS);
        let (to_shown, shown) = bounded(EXHIBITS);
        let (offers, offered) = bounded(1);
        let (to_replaced, replaced) = bounded(1);
        let keeper = Self {
            watch: FolderWatch::new(folder.path.clone()),
            folder,
            watcher,
            in_use: Arc::new(card.clone()),
            job: Job::Rest,
            orders,
            shown,
            offers,
            replaced,
            completes_at: None,
            is_over: false,
        };
        (keeper, Desk::new(ordered, to_shown), Exchange { offered, replaced: to_replaced })
    }

    /// Looks after models until recognition ends.
    pub(super) fn run(mut self) {
        self.complete();
        let mut next_look = Instant::now();
        while !self.is_over {
            select! {
                recv(self.shown) -> shown => match shown {
                    Ok(shown) => self.take(shown),
                    Err(_) => return,
                },
                recv(self.replaced) -> replaced => match replaced {
                    Ok(replaced) => self.close(replaced),
                    Err(_) => return,
                },
                default(next_look.saturating_duration_since(Instant::now())) => {}
            }
            if self.completes_at.is_some_and(|at| at <= Instant::now()) {
                self.complete();
            }
            if next_look <= Instant::now() {
                self.look();
                next_look = Instant::now() + LOOK_INTERVAL;
            }
        }
    }

    /// Has the keyframes shown that the model in use has not described.
    fn complete(&mut self) {
        self.completes_at = None;
        self.job = Job::Complete(Instance::Unopened);
        self.order(Order::Show(hash(&self.in_use)));
    }

    /// Recognition takes orders after every frame, and none once it has ended.
    fn order(&mut self, order: Order) {
        self.is_over |= self.orders.send(order).is_err();
    }

    fn take(&mut self, shown: Shown) {
        let started = Instant::now();
        match shown {
            Shown::Keyframe(model, exhibit) => self.describe(&model, &exhibit),
            Shown::All(model) => self.end_job(&model),
        }
        rest(started);
    }

    /// Describes a keyframe by the model of that hash, unless that is not wanted any more.
    fn describe(&mut self, wanted: &str, exhibit: &Exhibit) {
        // Whoever looks at the picture itself says that it is damaged.
        let Ok(image) = decode(&exhibit.thumbnail_jpeg, "thumbnail") else { return };
        let described = match &mut self.job {
            Job::Complete(instance) if *wanted == *self.in_use.sha256 => {
                let model = instance.opened(&self.folder, wanted);
                Ok(model.and_then(|model| model.describe(&image).ok()))
            }
            Job::Prepare(model, test) if *wanted == *model.card().sha256 => {
                tested(model, test, |model| model.describe(&image))
            }
            _ => return,
        };
        match described {
            Ok(None) => {}
            Ok(Some(descriptor)) => {
                let appearance = Appearance { model: wanted.to_owned(), descriptor: (&descriptor).into() };
                if let Job::Prepare(_, test) = &mut self.job {
                    test.count(exhibit, &appearance.descriptor);
                }
                self.order(Order::Renew(exhibit.keyframe, appearance));
            }
            Err(reason) => self.refuse(wanted, &reason),
        }
    }

    /// All keyframes were shown for the model of that hash.
    fn end_job(&mut self, model: &str) {
        match std::mem::replace(&mut self.job, Job::Rest) {
            Job::Complete(_) if *model == *self.in_use.sha256 => {}
            Job::Prepare(new, test) if *model == *new.card().sha256 => match test.verdict() {
                Ok(()) => {
                    self.job = Job::Wait(Arc::new(new.card().clone()));
                    // There is room: the one before was taken. At the end nobody takes it.
                    let _ = self.offers.try_send(*new);
                }
                Err(reason) => self.refuse(model, &reason),
            },
            job => self.job = job,
        }
    }

    /// A model is used no more: the one before, or the new one that failed on frames.
    fn close(&mut self, replaced: Replaced) {
        let Job::Wait(new) = std::mem::replace(&mut self.job, Job::Rest) else { return };
        match replaced.failure {
            None => {
                self.in_use = new;
                drop(replaced.model);
                self.completes_at = Some(Instant::now() + SETTLING);
            }
            Some(failure) => self.refuse(&new.sha256, &format!("it fails on frames: {failure}")),
        }
    }

    /// The model of that hash is not used, or no more; the one in use goes on.
    fn refuse(&mut self, model: &str, reason: &str) {
        self.order(Order::Forget(model.into()));
        self.watcher.model_refused(&format!("{}: {reason}", self.folder.path.display()), &self.in_use);
        self.complete();
    }

    /// Looks whether another model was deployed.
    fn look(&mut self) {
        if matches!(self.job, Job::Prepare(..) | Job::Wait(_)) || !self.watch.has_news() {
            return;
        }
        let started = Instant::now();
        let card = ModelCard::read(&self.folder.path.join(CARD_FILE));
        if card.as_ref().is_ok_and(|card| card.sha256 == self.in_use.sha256) {
            return;
        }
        match card.and_then(|_| self.folder.open()) {
            Ok(new) => {
                self.order(Order::Show(hash(new.card())));
                let test = SelfTest::new(new.card());
                self.completes_at = None;
                self.job = Job::Prepare(Box::new(new), test);
            }
            // It names its file.
            Err(error) => self.watcher.model_refused(&error.to_string(), &self.in_use),
        }
        rest(started);
    }
}

fn hash(card: &ModelCard) -> Arc<str> {
    card.sha256.as_str().into()
}

/// What `describe` gives, twice the same where the test asks; nothing of an image that has no descriptor.
fn tested(
    model: &mut DescriptorModel,
    test: &mut SelfTest,
    describe: impl Fn(&mut DescriptorModel) -> Result<Descriptor, CnnError>,
) -> Result<Option<Descriptor>, String> {
    let descriptor = match describe(model) {
        Err(CnnError::Degenerate { .. }) => {
            test.count_failure();
            return Ok(None);
        }
        described => described.map_err(|error| error.to_string())?,
    };
    if test.asks_again() {
        let again = describe(model).map_err(|error| error.to_string())?;
        test.compare(&descriptor, &again)?;
    }
    Ok(Some(descriptor))
}

/// Rests as long as was worked since `started`.
fn rest(started: Instant) {
    thread::sleep(started.elapsed().min(LONGEST_REST));
}
