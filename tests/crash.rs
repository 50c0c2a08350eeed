//! `loci run` killed with SIGKILL again and again, in a process of its own: `make test-crash`.
//!
//! What a line on stdout has said is acknowledged and must be in the map that the killed process left. Each map is
//! looked at in a copy, so that the next run finds it as the last one left it and may be killed while it recovers.
//! The map gives experiences up by rules that leave a loss nowhere to hide: where a place has a hundred, one for each
//! further one; near its budget, no more than five for each one that it learns; never a place's last one; and none
//! ever comes back. All others that were acknowledged must be there.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::{Duration, Instant};

use loci::place_map::{ExperienceId, MapError, MapOptions, PlaceId, PlaceMap};
use loci::source;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::Value;

const DURABILITIES: [&str; 3] = ["every", "interval=200ms", "none"];
const LIVES: usize = 24;
const WORLDS: u64 = 6;
const FRAMES_A_WORLD: usize = 60;
/// Shares of an undisturbed run: when it has begun to answer, and when it is about to end.
const STARTED: f64 = 0.1;
const ENDING: f64 = 0.9;
/// Within so long after its last answer a run closes its map.
const CLOSING: Duration = Duration::from_millis(5);
const SLOWEST_RECOVERY: Duration = Duration::from_secs(1);
/// Experiences of a place that is full.
const FULL_PLACE: usize = 100;
/// Experiences that are given up for one that is learnt: one of its place and four for the budget.
const GIVEN_UP_AT_ONCE: usize = 5;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Budget {
    /// Never reached: nothing may be missing but of places that are full.
    Ample,
    /// Soon reached: segments are emptied and experiences given up.
    Small,
}

impl Budget {
    /// How often its robot is killed before the next map begins.
    fn kills(self) -> usize {
        match self {
            Self::Ample => 24,
            Self::Small => 30,
        }
    }

    fn disk_mib(self) -> u64 {
        match self {
            Self::Ample => 16,
            Self::Small => 3,
        }
    }

    fn options(self) -> MapOptions {
        MapOptions { disk_bytes: self.disk_mib() << 20, ..MapOptions::default() }
    }

    /// Whether a map of so many bytes that count may have given something up: above 70 % of its budget, less what
    /// giving up just freed.
    fn is_near(self, live_bytes: u64) -> bool {
        self == Self::Small && live_bytes + (256 << 10) > (self.disk_mib() << 20) * 7 / 10
    }
}

/// When a run is killed.
enum Moment {
    /// So long after its start.
    After(Duration),
    /// So long after its last answer.
    Closing(Duration),
}

impl Moment {
    /// A third of them hit the start and the recovery, a sixth the closing of the map, the others the run.
    fn draw(random: &mut Pcg64, undisturbed: Duration) -> Self {
        let share = match random.random_range(0..6) {
            0 | 1 => random.random_range(0.0..STARTED),
            2 => return Self::Closing(CLOSING.mul_f64(random.random())),
            _ => random.random_range(STARTED..ENDING),
        };
        Self::After(undisturbed.mul_f64(share))
    }

    /// Waits for it; `answers` hears of every answer, and of the end of the run.
    fn wait(self, answers: &Receiver<()>) {
        match self {
            Self::After(delay) => thread::sleep(delay),
            Self::Closing(delay) => {
                for _ in answers.iter().take(FRAMES_A_WORLD) {}
                thread::sleep(delay);
            }
        }
    }
}

/// A line of the table.
#[derive(Default)]
struct Row {
    kills: usize,
    killed_before_first_frame: usize,
    frames: usize,
    experiences: usize,
    lost: usize,
    unopened: usize,
    slowest: Duration,
    largest_bytes: u64,
}

/// What the maps went through while they were killed.
#[derive(Default)]
struct Events {
    /// Kills after the last frame was answered.
    closings: usize,
    torn_tails: usize,
    snapshots: usize,
    deleted_segments: usize,
    given_up: usize,
    complaints: Vec<String>,
}

/// An acknowledged experience.
struct Acknowledged {
    frame: u64,
    place: PlaceId,
}

/// A map's life: what its robot said, over all runs.
struct Life {
    budget: Budget,
    map: PathBuf,
    acknowledged: BTreeMap<ExperienceId, Acknowledged>,
    places: BTreeSet<PlaceId>,
    given_up: BTreeSet<ExperienceId>,
    /// Experiences that there had been when the map was last looked at.
    ever: u32,
}

/// The frames of a synthetic corridor as a folder of JPEGs, from which a run starts in milliseconds.
fn recording(folder: &Path, seed: u64) -> PathBuf {
    let light = ["noon", "dusk", "night"][seed as usize % 3];
    let world = format!(
        "synthetic:corridor?laps=1&light={light}&seed={seed}&frames={FRAMES_A_WORLD}&size=160x160&passers=0"
    );
    let recording = folder.join(format!("world-{seed}"));
    fs::create_dir(&recording).unwrap();
    let mut source = source::open(&world, None).unwrap();
    for frame in std::iter::from_fn(|| source.next_frame()).map(Result::unwrap) {
        fs::write(recording.join(format!("{}.jpg", frame.index)), source::jpeg(&frame.colour)).unwrap();
    }
    recording
}

/// The whole lines that a process wrote before it ended, each of which is `told`; one that was cut off acknowledges
/// nothing.
fn whole_lines(output: ChildStdout, told: &Sender<()>) -> Vec<Value> {
    let mut output = BufReader::new(output);
    let mut lines = Vec::new();
    loop {
        let mut line = Vec::new();
        output.read_until(b'\n', &mut line).unwrap();
        if line.pop() != Some(b'\n') {
            return lines;
        }
        lines.push(serde_json::from_slice(&line).unwrap());
        // Nobody listens when the moment of the kill has come.
        let _ = told.send(());
    }
}

/// `loci run` on `recording` without a CNN, which it looks for in `nowhere`.
fn run(recording: &Path, map: &Path, nowhere: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_loci"));
    command.arg("run").arg(recording).arg("--map").arg(map).arg("--json");
    command.env("HOME", nowhere).env("XDG_CACHE_HOME", nowhere);
    for variable in ["ORT_DYLIB_PATH", "LD_LIBRARY_PATH", "VIRTUAL_ENV", "CONDA_PREFIX"] {
        command.env_remove(variable);
    }
    command
}

/// How long a run takes on this computer when nobody kills it: the median of three.
fn undisturbed(recording: &Path) -> Duration {
    let mut durations = [(); 3].map(|()| {
        let folder = tempfile::tempdir().unwrap();
        let started = Instant::now();
        let ended = run(recording, &folder.path().join("map"), folder.path()).output().unwrap();
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
        started.elapsed()
    });
    durations.sort_unstable();
    durations[1]
}

/// Runs `loci` on `recording`, kills it at `moment`, and answers what it acknowledged and whether the kill came
/// before the end; what it complained of goes to `complaints`.
fn killed_run(
    (recording, life): (&Path, &Life),
    durability: &str,
    moment: Moment,
    complaints: &mut Vec<String>,
) -> (Vec<Value>, bool) {
    let nowhere = tempfile::tempdir().unwrap();
    let errors = nowhere.path().join("stderr");
    let mut command = run(recording, &life.map, nowhere.path());
    command.args(["--durability", durability, "--map-disk", &format!("{}MiB", life.budget.disk_mib())]);
    command.stdout(Stdio::piped()).stderr(File::create(&errors).unwrap());
    let mut process = command.spawn().unwrap();
    let output = process.stdout.take().unwrap();
    let (told, answers) = mpsc::channel();
    let reader = thread::spawn(move || whole_lines(output, &told));
    moment.wait(&answers);
    process.kill().unwrap();
    let status = process.wait().unwrap();
    let lines = reader.join().unwrap();
    let errors = fs::read_to_string(errors).unwrap();
    let is_killed = status.signal() == Some(9);
    // What the kill before tore off is lost, and places alone may fill the little room that the maps here get: a run
    // says so, and with a 3 where it ends.
    let is_expected =
        |line: &str| ["last record was torn", "the map is full"].iter().any(|said| line.contains(said));
    let has_said_why = status.code() == Some(3) && is_expected(&errors);
    if !is_killed && !status.success() && !has_said_why {
        complaints.push(format!("a run ended by itself with {status}: {errors}"));
    }
    if is_killed {
        // What a run says once it is over is no complaint.
        let complaint =
            |line: &&str| line.starts_with("loci: ") && !line.contains("NO CNN") && !is_expected(line);
        complaints.extend(errors.lines().filter(complaint).map(str::to_owned));
    }
    (lines, is_killed)
}

fn copy(from: &Path, to: &Path) -> u64 {
    let files = fs::read_dir(from).unwrap().map(|entry| entry.unwrap());
    files.map(|file| fs::copy(file.path(), to.join(file.file_name())).unwrap()).sum()
}

impl Life {
    fn new(budget: Budget, map: PathBuf) -> Self {
        let (acknowledged, places, given_up) = Default::default();
        Self { budget, map, acknowledged, places, given_up, ever: 0 }
    }

    /// Notes what a run acknowledged, and answers how many experiences that were.
    fn note(&mut self, lines: &[Value], complaints: &mut Vec<String>) -> usize {
        let before = self.acknowledged.len();
        for line in lines {
            let number = |key: &str| line[key].as_u64().map(|number| number as u32);
            let Some(place) = number("place").map(PlaceId) else {
                if line["decision"] == "unknown" {
                    continue;
                }
                complaints.push(format!("a frame without a place: {line}"));
                continue;
            };
            self.places.insert(place);
            let frame = line["frame"].as_u64().unwrap();
            if let Some(id) = number("experience").map(ExperienceId) {
                self.acknowledged.insert(id, Acknowledged { frame, place });
            }
        }
        self.acknowledged.len() - before
    }

    /// How many acknowledged facts `map` has lost.
    fn lost(&mut self, map: &PlaceMap) -> usize {
        let ever = map.experiences_ever();
        let has_ever = self.acknowledged.keys().next_back().is_none_or(|latest| latest.0 < ever);
        let has_place = |&&id: &&PlaceId| map.place(id).is_some_and(|place| !place.experiences.is_empty());
        let mut lost =
            usize::from(!has_ever) + self.places.len() - self.places.iter().filter(has_place).count();
        let mut missing = BTreeSet::new();
        for (&id, acknowledged) in &self.acknowledged {
            match map.experience(id).is_some() {
                true => lost += usize::from(!is_whole(map, id, acknowledged).is_ok_and(|is_whole| is_whole)),
                false => drop(missing.insert(id)),
            }
        }
        let given_up_now: Vec<_> = missing.difference(&self.given_up).collect();
        let is_of_full_place = |id: &&&ExperienceId| {
            map.place(self.acknowledged[id].place).is_some_and(|place| place.experiences.len() == FULL_PLACE)
        };
        let learnt = ever.saturating_sub(self.ever) as usize;
        let may_give_up = match self.budget.is_near(map.summary().live_bytes) {
            // Room is made before the experience is written for which it is.
            true => GIVEN_UP_AT_ONCE * (1 + learnt),
            false => given_up_now.iter().filter(is_of_full_place).count().min(learnt),
        };
        lost += given_up_now.len().saturating_sub(may_give_up) + self.given_up.difference(&missing).count();
        (self.given_up, self.ever) = (missing, ever);
        lost
    }
}

/// Whether an experience is the one that was acknowledged, and all of it can be read.
fn is_whole(map: &PlaceMap, id: ExperienceId, acknowledged: &Acknowledged) -> Result<bool, MapError> {
    let experience = map.experience(id).ok_or(MapError::NoExperience { experience: id.0 })?;
    let is_findable = !experience.is_keyframe
        || !map.features(id)?.descriptors.is_empty()
            && map.traits(id)?.words.iter().any(|v| !v.words.is_empty());
    Ok(is_findable
        && experience.learnt_as == acknowledged.place
        && map.origin(id)?.frame_index == acknowledged.frame
        && map.thumbnail_jpeg(id)?.starts_with(b"\xff\xd8"))
}

/// The whole trial: what was tried so far, and what came of it.
struct Trial {
    recordings: Vec<PathBuf>,
    /// What a run takes that nobody kills.
    undisturbed: Duration,
    random: Pcg64,
    rows: [Row; 3],
    events: Events,
}

impl Trial {
    fn kills(&self) -> usize {
        self.rows.iter().map(|row| row.kills).sum()
    }

    /// Kills the robot of one map again and again.
    fn live(&mut self, life: &mut Life) {
        for _ in 0..life.budget.kills() {
            let turn = self.kills() % DURABILITIES.len();
            let moment = Moment::draw(&mut self.random, self.undisturbed);
            let recording = &self.recordings[self.random.random_range(0..self.recordings.len())];
            let complaints = &mut self.events.complaints;
            let (lines, is_killed) = killed_run((recording, life), DURABILITIES[turn], moment, complaints);
            self.events.closings += usize::from(is_killed && lines.len() == FRAMES_A_WORLD);
            let row = &mut self.rows[turn];
            row.kills += usize::from(is_killed);
            row.killed_before_first_frame += usize::from(lines.is_empty());
            row.frames += lines.len();
            row.experiences += life.note(&lines, complaints);
            if !self.look_at(life, turn) {
                break;
            }
        }
        self.events.snapshots += usize::from(life.map.join("snapshot.loci").exists());
        self.events.deleted_segments += usize::from(!life.map.join("journal-000001.loci").exists());
        self.events.given_up += life.given_up.len();
    }

    /// Opens a copy of the map that a killed run left, and holds it against what was acknowledged; whether it opens.
    fn look_at(&mut self, life: &mut Life, turn: usize) -> bool {
        let (row, events) = (&mut self.rows[turn], &mut self.events);
        let copied = tempfile::tempdir().unwrap();
        if life.map.is_dir() {
            row.largest_bytes = row.largest_bytes.max(copy(&life.map, copied.path()));
        }
        let started = Instant::now();
        let opened = PlaceMap::open(copied.path(), life.budget.options());
        row.slowest = row.slowest.max(started.elapsed());
        match opened {
            Ok(map) => {
                let lost = life.lost(&map);
                if lost > 0 {
                    events.complaints.push(format!("{lost} lost: {:?}", map.summary()));
                }
                row.lost += lost;
                events.torn_tails += usize::from(map.summary().torn_bytes > 0);
                true
            }
            Err(error) => {
                row.unopened += 1;
                events.complaints.push(error.to_string());
                false
            }
        }
    }
}

fn table(rows: &[Row; 3]) -> String {
    let mut table =
        "| Durability | Kills | before the first frame | Frames acknowledged | Experiences acknowledged | \
                     Lost | Maps that did not open | Slowest recovery, ms | Largest map, MiB |\n\
                     |---|---:|---:|---:|---:|---:|---:|---:|---:|\n"
            .to_owned();
    for (durability, row) in DURABILITIES.iter().zip(rows) {
        let mib = row.largest_bytes as f64 / f64::from(1 << 20);
        table += &format!(
            "| `{durability}` | {} | {} | {} | {} | {} | {} | {:.1} | {mib:.1} |\n",
            row.kills,
            row.killed_before_first_frame,
            row.frames,
            row.experiences,
            row.lost,
            row.unopened,
            row.slowest.as_secs_f64() * 1e3,
        );
    }
    table
}

#[test]
#[ignore = "takes minutes: `make test-crash`"]
fn what_a_killed_run_acknowledged_is_never_lost() {
    let folder = tempfile::tempdir().unwrap();
    let recordings: Vec<PathBuf> = (0..WORLDS).map(|seed| recording(folder.path(), seed)).collect();
    let (undisturbed, random) = (undisturbed(&recordings[0]), Pcg64::seed_from_u64(5));
    println!("a run that nobody kills takes {:.0} ms", undisturbed.as_secs_f64() * 1e3);
    let (rows, events) = Default::default();
    let mut trial = Trial { recordings, undisturbed, random, rows, events };
    for index in 0..LIVES {
        let budget = if index % 2 == 0 { Budget::Ample } else { Budget::Small };
        trial.live(&mut Life::new(budget, folder.path().join(format!("map-{index}"))));
    }
    let Trial { rows, events, .. } = &trial;
    println!("{}", table(rows));
    println!(
        "{LIVES} maps: {} kills behind the last frame, {} torn tails cut off, {} maps with a snapshot, {} whose first segment was emptied and deleted, \
         {} acknowledged experiences given up for the budget",
        events.closings, events.torn_tails, events.snapshots, events.deleted_segments, events.given_up
    );
    assert!(events.complaints.is_empty(), "{:#?}", events.complaints);
    assert!(rows.iter().all(|row| row.lost + row.unopened == 0), "something was lost");
    assert!(rows.iter().all(|row| row.slowest <= SLOWEST_RECOVERY), "recovery is slow");
    assert!(trial.kills() >= 500 && rows.iter().all(|row| row.experiences >= 200), "too little was tried");
    assert!(events.snapshots == LIVES && events.deleted_segments > 0, "maps were not old enough");
    assert!(events.given_up > 0, "nothing was given up");
    assert!(events.closings > 20, "no map was being closed");
}
