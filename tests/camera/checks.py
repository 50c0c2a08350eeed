"""Judges what loci said in the virtual machine: `checks.py SHARE`, the folder that the machine shared with its host.

Every check is a sentence that is true or not; all that are not are printed, and then the exit code is 1.
"""

import json
import re
import sys
from pathlib import Path

# How soon after a camera came back there must be a frame that is answered.
RECOVERY_S = 2.0
# How old a frame may be when its answer comes. That much, for every instruction is translated, on a busy machine.
LATE_S = 10.0
# How far it may seem to be taken after its answer. Clocks are compared when the first frame arrives, late as that may be.
EARLY_S = 0.5


class Run:
    """What one loci said: its answers with the times when they came, everything else, and how it ended."""

    def __init__(self, out, name):
        lines = [line.split(" ", 1) for line in text(out / f"{name}.json").splitlines()]
        self.answers = [dict(json.loads(line), said=float(said)) for said, line in lines]
        self.messages = text(out / f"{name}.err")
        self.exit = text(out / f"{name}.exit").strip()

    def values(self, key):
        return [answer[key] for answer in self.answers]


class Verdict:
    """Counts and prints which sentences hold."""

    def __init__(self):
        self.failures = 0

    def check(self, holds, sentence, seen=""):
        print(f"{'ok    ' if holds else 'FAILED'} {sentence}" + (f" ({seen})" if str(seen) else ""))
        self.failures += not holds


def text(path):
    return path.read_text(errors="replace") if path.exists() else ""


def rises(values):
    return all(earlier < later for earlier, later in zip(values, values[1:]))


def capture_s(answer):
    return answer["capture_nanos"] / 1e9


def check_frames(verdict, name, run, least):
    """Frames came, with numbers and times that make sense."""
    verdict.check(len(run.answers) >= least, f"{name}: at least {least} frames are answered", len(run.answers))
    verdict.check(rises(run.values("frame")), f"{name}: frame numbers rise")
    verdict.check(rises(run.values("capture_nanos")), f"{name}: times of capture rise")
    ages = [answer["said"] - capture_s(answer) for answer in run.answers]
    span = f"{min(ages):.2f} to {max(ages):.2f} s" if ages else "none"
    sane = bool(ages) and all(-EARLY_S < age < LATE_S for age in ages)
    verdict.check(sane, f"{name}: frames were taken just before they are answered, by the wall clock", span)


def check_formats(verdict, out):
    """vivid in two formats and sizes; what is learnt in one is found again in the other."""
    for name, size in ("yuyv", "320×180"), ("grey", "640×360"):
        run = Run(out, name)
        check_frames(verdict, name, run, 8)
        verdict.check(f"gives {name}, {size} px" in run.messages, f"{name}: {size} px are said to come")
        verdict.check(run.exit == "0", f"{name}: it ends in order", f"exit code {run.exit}")
    founded = Run(out, "yuyv").values("decision")[:1]
    verdict.check(founded == ["new_place"], "yuyv: the pattern is a new place", founded)
    found = {(answer["decision"], answer["place"]) for answer in Run(out, "grey").answers}
    verdict.check(found == {("revisited", 0)}, "grey: it is the place that was learnt in yuyv", found)


def events(out):
    return [(float(line.split(" ", 1)[0]), line.split(" ", 1)[1]) for line in text(out / "events").splitlines()]


def check_replug(verdict, out):
    """A camera is unplugged twice under one loci and comes back, the second time under another number."""
    run = Run(out, "replug")
    check_frames(verdict, "replug", run, 18)
    happened = events(out)
    gone = [time for time, event in happened if event == "vivid is unplugged"]
    plugged = [time for time, event in happened if event == "vivid is plugged in"]
    back = [(time, event.split()[-1]) for time, event in happened if event.startswith("vivid is back as ")]
    first = [event.split()[-1] for _, event in happened if event.startswith("vivid is video")]
    verdict.check(
        len(gone) == 2 and [number[:5] for _, number in back] == ["video"] * 2,
        "replug: the camera was unplugged and came back twice",
    )
    for left, joined, (came, number) in zip(gone, plugged, back):
        during = [answer for answer in run.answers if left + EARLY_S < capture_s(answer) < joined]
        verdict.check(not during, f"replug: nothing is made up while there is no camera, before {number}", len(during))
        after = [answer for answer in run.answers if capture_s(answer) > joined][:1]
        verdict.check(
            after and capture_s(after[0]) - came < RECOVERY_S,
            f"replug: a frame of the first {RECOVERY_S:g} s at {number} is answered",
            " ".join(f"of {capture_s(answer) - came:.2f} s, at {answer['said'] - came:.2f} s" for answer in after),
        )
        is_said = re.search(rf"it is back at /dev/{number}: vivid on platform:vivid-000", run.messages)
        verdict.check(is_said, f"replug: it is said to be back at /dev/{number}")
    elsewhere = len(back) == 2 and first and back[1][1] != first[0]
    verdict.check(elsewhere, "replug: the second time it has another number", (first, [number for _, number in back]))
    verdict.check("no frame yet" not in run.messages, "replug: while it is away, nothing else is said")
    count = run.messages.count("it was unplugged; waiting for it to come back")
    verdict.check(count == 2, "replug: each time is said once", count)
    places = {answer["place"] for answer in run.answers}
    verdict.check(places == {0}, "replug: the pattern stays the same place", places)


def check_controls(verdict, out):
    """What a control does not take is refused; what it does is set again on a camera that came back."""
    message = text(out / "refused.err").strip()
    is_refused = message.endswith("brightness=256 is not allowed; brightness takes 0 to 255")
    code = text(out / "refused.exit").strip()
    verdict.check(is_refused and code == "1", "controls: what one does not take is refused", (message, code))
    brightness = re.findall(r"^ +brightness +(0 to 255, .*)$", text(out / "devices"), re.M)
    is_set = brightness == ["0 to 255, default 128, now 100"]
    verdict.check(is_set, "controls: brightness is set again after the camera came back", brightness)


def check_drive(verdict, out):
    """A drive of two laps in MJPG: founded in the first, recognised in the second, one frame broken."""
    run = Run(out, "drive")
    fed = [(float(line.split()[0]), Path(line.split()[1]).stem) for line in text(out / "feed").splitlines()]
    # On a busy machine frames give way to newer ones.
    check_frames(verdict, "drive", run, max(20, len(fed) // 2))
    # The frame that was fed last before an answer's capture, which is stamped as it is written.
    for answer in run.answers:
        before = [name for time, name in fed if time <= capture_s(answer) + 0.02]
        answer["lap"], answer["step"] = map(int, before[-1].split("-")) if before else (0, 0)
    first, second = ([answer for answer in run.answers if answer["lap"] == lap] for lap in (1, 2))
    founded = {answer["place"]: answer["step"] for answer in first if answer["decision"] == "new_place"}
    verdict.check(len(founded) >= 3, "drive: the first lap founds at least 3 places", len(founded))
    known = [answer for answer in second if answer["decision"] in ("revisited", "recognised")]
    again = [answer for answer in known if answer["place"] in founded]
    share = f"{len(again)} of {len(second)}"
    is_known = second and len(again) >= 0.5 * len(second)
    verdict.check(is_known, "drive: the second lap is recognised, by 50 % at least", share)
    places = {answer["place"] for answer in again}
    known_again = f"{len(places)} of {len(founded)}"
    verdict.check(len(places) * 4 >= len(founded) * 3 > 0, "drive: as are three places in four", known_again)
    check_broken_frame(verdict, run)


def check_broken_frame(verdict, run):
    """The one frame of which half arrived is reported, and those behind it are answered."""
    broken = [int(number) for number in re.findall(r"frame (\d+): the JPEG is cut off", run.messages)]
    verdict.check(len(broken) == 1, "drive: the broken frame is reported, once", broken)
    after = [number for number in run.values("frame") if broken and number > broken[0]]
    verdict.check(len(after) >= 10, "drive: the frames behind it are answered", len(after))
    verdict.check(broken and broken[0] not in run.values("frame"), "drive: it has no answer itself")
    verdict.check(run.exit == "3", "drive: the exit code says that something was lost", f"exit code {run.exit}")


def check_devices(verdict, out):
    """The cameras of the machine are listed with what they give."""
    listed = text(out / "devices")
    number = [event.split()[-1] for _, event in events(out) if event.startswith("vivid is back as ")][-1:]
    verdict.check(number and f"/dev/{number[0]}  vivid" in listed, "devices: vivid is listed where it is", number)
    verdict.check(re.search(r"^/dev/video7  drive$", listed, re.M), "devices: the camera of the drive is listed")
    for name in "yuyv", "grey", "mjpg":
        verdict.check(re.search(rf"^  format +{name} ", listed, re.M), f"devices: {name} is among what they give")


def main():
    out = Path(sys.argv[1]) / "out"
    verdict = Verdict()
    verdict.check([event for _, event in events(out)][-1:] == ["done"], "the machine did all that it was to do")
    check_formats(verdict, out)
    check_replug(verdict, out)
    check_controls(verdict, out)
    check_drive(verdict, out)
    check_devices(verdict, out)
    sys.exit(1 if verdict.failures else 0)


main()
