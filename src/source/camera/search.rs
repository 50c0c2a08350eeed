//! Which cameras there are, and which of them is one that was lost: it may come back under another number.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::{device, query};

/// How long the camera that was lost is waited for before another one at the same path is taken for its replacement. A
/// hub that comes back brings its cameras one by one.
const BEFORE_REPLACEMENT: Duration = Duration::from_secs(5);

/// What a camera is known by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub(super) card: String,
    pub(super) bus: String,
    /// Which of a camera's nodes it is, if the kernel says so: one may give colour, the next infrared.
    pub(super) index: Option<u32>,
}

impl Identity {
    /// Whether it is the same kind of camera, in another port perhaps.
    fn is_like(&self, other: &Self) -> bool {
        (&self.card, self.index) == (&other.card, other.index)
    }
}

/// A node under /dev.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Node {
    pub(super) path: PathBuf,
    /// `None` of what is not a camera, or does not say who it is.
    pub(super) camera: Option<Identity>,
}

impl Node {
    /// What is at `path`, or where that leads to; `None` if nothing is.
    pub(super) fn at(path: &Path) -> Option<Self> {
        let path = fs::canonicalize(path).ok()?;
        let camera = identity_at(&path);
        Some(Self { path, camera })
    }

    /// All video nodes, by number.
    pub(super) fn all() -> Vec<Self> {
        paths().iter().filter_map(|path| Self::at(path)).collect()
    }
}

/// The paths of all video nodes, by number.
pub(super) fn paths() -> Vec<PathBuf> {
    let entries = fs::read_dir("/dev").into_iter().flatten().flatten();
    let numbers = entries.filter_map(|entry| {
        let number = entry.file_name().to_str()?.strip_prefix("video")?.parse::<u32>().ok()?;
        Some((number, entry.path()))
    });
    let mut numbers: Vec<(u32, PathBuf)> = numbers.collect();
    numbers.sort();
    numbers.into_iter().map(|(_, path)| path).collect()
}

fn identity_at(path: &Path) -> Option<Identity> {
    let device = device::open_node(path).ok()?;
    let card = query::card(&device).ok().filter(|card| card.is_camera)?;
    Some(identity(card, path))
}

/// Who the camera at `path` is, which says that it is `card`.
pub(super) fn identity(card: query::Card, path: &Path) -> Identity {
    let index = || {
        let node = fs::canonicalize(path).ok()?;
        let file = Path::new("/sys/class/video4linux").join(node.file_name()?).join("index");
        fs::read_to_string(file).ok()?.trim().parse().ok()
    };
    let index = index();
    Identity { card: card.name, bus: card.bus, index }
}

/// The search for a camera that was lost.
#[derive(Debug)]
pub(super) struct Search {
    lost: Identity,
    /// Cameras that were there while it was away: another one of its kind that the robot has, too, is not it.
    others: Vec<Identity>,
    since: Instant,
}

impl Search {
    /// Begins the search for `lost`, `nodes` being there without it.
    pub(super) fn begin(lost: Identity, nodes: Vec<Node>) -> Self {
        let others =
            nodes.into_iter().filter_map(|node| node.camera).filter(|other| *other != lost).collect();
        Self { lost, others, since: Instant::now() }
    }

    /// Begins the search for the same camera, which was lost again.
    pub(super) fn begin_again(&mut self, nodes: Vec<Node>) {
        *self = Self::begin(self.lost.clone(), nodes);
    }

    /// Where the camera is now, which was named by the path of `named`, `nodes` being there; `None` while it is away.
    pub(super) fn found<'a>(&self, named: Option<&'a Node>, nodes: &'a [Node]) -> Option<&'a Path> {
        let is_it = |node: &&Node| node.camera.as_ref() == Some(&self.lost);
        let is_like_it = |node: &&Node| {
            node.camera
                .as_ref()
                .is_some_and(|other| other.is_like(&self.lost) && !self.others.contains(other))
        };
        // What does not say who it is, for want of permission perhaps, is opened for the reason.
        let replaces_it = |node: &&Node| node.camera.is_none() || self.since.elapsed() >= BEFORE_REPLACEMENT;
        let alone = || {
            let mut alike = nodes.iter().filter(is_like_it);
            alike.next().filter(|_| alike.next().is_none())
        };
        let found = named
            .filter(is_it)
            .or_else(|| nodes.iter().find(is_it))
            .or_else(|| named.filter(is_like_it))
            .or_else(alone)
            .or_else(|| named.filter(replaces_it));
        found.map(|node| node.path.as_path())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(card: &str, bus: &str) -> Identity {
        Identity { card: card.to_owned(), bus: bus.to_owned(), index: Some(0) }
    }

    fn node(number: u32, camera: Option<Identity>) -> Node {
        Node { path: format!("/dev/video{number}").into(), camera }
    }

    fn search(others: &[Node]) -> Search {
        Search::begin(camera("C920", "usb-1"), others.to_vec())
    }

    fn found(search: &Search, named: Option<&Node>, nodes: &[Node]) -> Option<String> {
        search.found(named, nodes).map(|path| path.display().to_string())
    }

    #[test]
    fn the_camera_itself_is_taken_wherever_it_is() {
        let (it, other) = (camera("C920", "usb-1"), camera("C920", "usb-2"));
        let nodes = [node(0, Some(other.clone())), node(2, Some(it.clone()))];
        assert_eq!(found(&search(&[]), Some(&nodes[0]), &nodes).unwrap(), "/dev/video2");
        assert_eq!(found(&search(&[]), Some(&nodes[1]), &nodes).unwrap(), "/dev/video2");
        assert_eq!(found(&search(&[]), None, &nodes).unwrap(), "/dev/video2");
    }

    #[test]
    fn in_another_port_it_is_known_by_its_card_if_that_is_the_only_one() {
        let elsewhere = node(4, Some(camera("C920", "usb-7")));
        let another = node(6, Some(camera("C920", "usb-8")));
        let foreign = node(0, Some(camera("vivid", "platform")));
        let both = [elsewhere.clone(), another.clone()];
        assert_eq!(found(&search(&[]), None, &[foreign.clone(), elsewhere]).unwrap(), "/dev/video4");
        assert_eq!(found(&search(&[]), None, &both), None);
        assert_eq!(found(&search(&[]), Some(&both[1]), &both).unwrap(), "/dev/video6");
        assert_eq!(found(&search(std::slice::from_ref(&another)), None, &both).unwrap(), "/dev/video4");
        assert_eq!(found(&search(std::slice::from_ref(&another)), None, &both[1..]), None);
        assert_eq!(found(&search(&[]), None, &[foreign]), None);
    }

    #[test]
    fn another_node_of_the_same_camera_is_not_it() {
        let infrared = Identity { index: Some(2), ..camera("C920", "usb-1") };
        assert_eq!(found(&search(&[]), None, &[node(1, None), node(2, Some(infrared))]), None);
    }

    #[test]
    fn another_camera_replaces_it_only_where_it_was_named_and_after_a_while() {
        let other = node(0, Some(camera("vivid", "platform")));
        let mut search = search(&[]);
        assert_eq!(found(&search, Some(&other), std::slice::from_ref(&other)), None);
        search.since = Instant::now().checked_sub(BEFORE_REPLACEMENT).unwrap();
        assert_eq!(found(&search, Some(&other), std::slice::from_ref(&other)).unwrap(), "/dev/video0");
        assert_eq!(found(&search, None, &[other]), None);
    }

    #[test]
    fn what_is_named_but_does_not_say_who_it_is_is_tried() {
        let silent = node(0, None);
        assert_eq!(found(&search(&[]), Some(&silent), std::slice::from_ref(&silent)).unwrap(), "/dev/video0");
        assert_eq!(found(&search(&[]), None, &[silent]), None);
    }

    #[test]
    fn no_file_that_is_not_a_device_is_a_camera() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert_eq!(Node::at(file.path()).unwrap().camera, None);
        assert_eq!(Node::at(Path::new("/dev/null")).unwrap().camera, None);
        assert_eq!(Node::at(Path::new("/dev/video-of-nobody")), None);
    }
}
