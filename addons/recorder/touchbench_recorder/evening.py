"""An evening with one person: the sensor is checked, each prompt becomes a capture."""

from __future__ import annotations

import math
import random
import shlex
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.commands.printing import print_lines, print_next_commands
from bench.corpora.doubts import find_doubts
from bench.corpora.read.table import parse_grid, read
from bench.corpora.survey import Survey
from bench.errors import InputError
from bench.ground.progress import console, warn
from bench.values.result import format_count
from touchbench_recorder.checks import check_corner, check_rest, check_strokes, measure_rate
from touchbench_recorder.files import Files
from touchbench_recorder.screen import Keys, Screen, draw_screen
from touchbench_streams import sensor_frames
from touchbench_streams.recordings import DOUBT
from touchbench_streams.sensor import open_sensor
from touchbench_streams.sensor_frames import Frame, Receiver, make_decoder
from touchbench_streams.show import draw_map

NO_TOUCH = "notouch"  # a gesture whose prompt is to keep off
BACKLOG_S = 1.0  # in which frames arrive that waited for the command
RECENT_S = 2.0  # of frames whose rate is shown
LOOK_S = 0.04  # between two looks at what has arrived
MOST_LOST = 0.05  # share of the frames of a capture; with more it is prompted again
MOST_TRIES = 3
CHECKS = (  # seconds and prompts of the checks before the evening
    (3.0, "keep your hands off the skin"),
    (6.0, "stroke over the whole skin"),
    (4.0, "press the corner at the end of the first row (top right)"),
)


@dataclass(frozen=True)
class Evening:
    """What to record; the keys of ``bench record``."""

    path: Path
    subject: str
    gestures: tuple[str, ...]
    conditions: dict[str, str]
    format: str
    grid: str
    full_scale: float
    rate_hz: float | None
    repetitions: int
    seconds: float
    rest: float
    background: float
    check: bool

    def prompts(self) -> list[tuple[str, int]]:
        """Gestures and repetitions in the order of this person: each round in an order of its own.

        The order depends on the person and the conditions, so that a continued evening has it, too.
        """
        draw = random.Random(f"{self.subject} {sorted(self.conditions.items())}")
        prompts = []
        for repetition in range(1, self.repetitions + 1):
            gestures = draw.sample(self.gestures, len(self.gestures))
            prompts += [(gesture, repetition) for gesture in gestures]
        return prompts


class Stopped(Exception):
    """The person has pressed q."""


class Again(Exception):
    """The person has pressed r."""


class Stage:
    """The sensor, the files and the screen, while a prompt is shown."""

    def __init__(
        self, evening: Evening, files: Files, receiver: Receiver, screen: Screen, keys: Keys
    ) -> None:
        self.evening, self.files, self.receiver = evening, files, receiver
        self.screen, self.keys = screen, keys
        self.grid = parse_grid(evening.grid)
        self.recent: list[Frame] = []
        self.lost, self.count, self.begin = 0, 0, math.inf
        self.warnings: list[str] = []
        self.last_seen = time.monotonic()

    def collect(self, seconds: float, prompt: str, label: str, is_go: bool = False) -> list[Frame]:
        """Show a prompt for some seconds; write and return the frames that arrive meanwhile.

        Raises:
            InputError: the sensor sends nothing, or nothing readable.
            Stopped, Again: a key was pressed.
        """
        end, frames, is_paused = time.monotonic() + seconds, [], False
        if not self.screen.console.is_terminal:
            self.screen.say(prompt)
        while is_paused or time.monotonic() < end:
            arrived = self.receiver.take()
            for frame in arrived:
                self._write(frame, DOUBT if is_paused else label)
            frames += arrived
            self._check_silence(arrived)
            if (key := self.keys.take()) == "q":
                raise Stopped
            if key == "r":
                raise Again
            if key == " ":
                is_paused = not is_paused
                if is_go or is_paused:  # a capture that was interrupted begins anew
                    frames = []
                end = time.monotonic() + seconds
            left = seconds if is_paused else end - time.monotonic()
            words = f"{prompt} (paused)" if is_paused else prompt
            self._show(words, max(0.0, left), seconds, is_go and not is_paused)
            time.sleep(LOOK_S)
        self.files.flush()
        return frames

    def wait_for_frames(self) -> list[Frame]:
        """Write and return the next frames."""
        while not (arrived := self.receiver.take()):
            self._check_silence(arrived)
            time.sleep(LOOK_S)
        for frame in arrived:
            self._write(frame, DOUBT)
        self._check_silence(arrived)
        return arrived

    def _write(self, frame: Frame, label: str) -> None:
        if frame.lost or frame.is_restart:  # what comes next does not continue the recording
            self.files.recording += 1
            self.lost += frame.lost
        self.begin = min(self.begin, frame.seconds + BACKLOG_S)
        if frame.seconds > self.begin:
            self.count += 1 + frame.lost
        self.files.add_frame(self.evening.subject, label, frame.values)

    def measure_rate(self) -> float:
        """Frames per second since the beginning, lost ones included."""
        seconds = self.last_seen - self.begin
        return self.count / seconds if seconds > 0 else 0.0

    def _check_silence(self, arrived: list[Frame]) -> None:
        """Refuse a sensor that has sent no frame for a while."""
        now = time.monotonic()
        self.recent = [f for f in [*self.recent, *arrived] if f.seconds > now - RECENT_S]
        if arrived:
            self.last_seen = now
        elif now - self.last_seen > sensor_frames.SILENCE_S:
            reason = self.receiver.describe_silence()
            raise InputError(f"no frame for {sensor_frames.SILENCE_S:g} s: {reason}")

    def _show(self, prompt: str, left: float, seconds: float, is_go: bool) -> None:
        if not self.screen.console.is_terminal or not self.recent:
            return
        values, full_scale = self.recent[-1].values, self.evening.full_scale
        facts = {
            "rate": f"{measure_rate(self.recent):.1f} Hz",
            "lost frames": str(self.lost),
            "bad lines": str(self.receiver.decoder.bad),
            "mean level": f"{100 * values.mean() / full_scale:.1f} %",
            "at full scale": str(int((values >= full_scale).sum())),
            "captures": str(len(self.files.done)),
        }
        picture = draw_map(values, self.grid, full_scale)
        self.screen.show(draw_screen(prompt, left, seconds, is_go, facts, picture, self.warnings))

    def say(self, line: str) -> None:
        """Print a line that stays on the screen."""
        self.screen.say(line)
        self.warnings = [*self.warnings[-3:], line]


def record_evening(evening: Evening, sensor: dict[str, Any]) -> int:
    """Check the sensor, prompt the person, write the files; print what to do next."""
    rows, cols = parse_grid(evening.grid)
    decoder = make_decoder(evening.format, rows * cols, evening.full_scale)
    settings = {
        "format": evening.format,
        "grid": evening.grid,
        "full_scale": evening.full_scale,
        "rate_hz": evening.rate_hz,
        "columns": evening.conditions,
    }
    stream = open_sensor(**sensor)
    files = Files(evening.path, settings, rows * cols)
    screen, keys = Screen(console), Keys()
    receiver = Receiver(decoder, stream)
    stage = Stage(evening, files, receiver, screen, keys)
    try:
        with screen.open(), keys.open():
            _check_sensor(stage)
            _prompt_person(stage)
    except Stopped:
        screen.say("stopped; the same command continues")
    except KeyboardInterrupt as e:
        raise KeyboardInterrupt("interrupted; the same command continues") from e
    finally:
        files.close()
    _print_end(evening, files, evening.rate_hz or stage.measure_rate())
    return 0


def _check_sensor(stage: Stage) -> None:
    """Wait for the sensor; check it if asked to."""
    evening = stage.evening
    stage.collect(BACKLOG_S, "the sensor is measured", DOUBT)
    if not evening.check:
        return
    rest, strokes, press = (stage.collect(*phase, DOUBT) for phase in CHECKS)
    for name, frames in (("rest", rest), ("strokes", strokes), ("press", press)):
        if len(frames) < 2:
            raise InputError(f"too few frames at {name}; check the sensor, or give check=no")
    lines = [
        *check_rest(rest, evening.rate_hz, evening.full_scale),
        *check_strokes(strokes, stage.grid, evening.full_scale),
        *check_corner(rest, press, stage.grid, evening.full_scale),
    ]
    for line in lines:
        warn(f"warning: {line}")
    stage.warnings = lines


def _prompt_person(stage: Stage) -> None:
    """Prompt for all captures that are missing, and for background at the end."""
    evening, files = stage.evening, stage.files
    own = [entry for entry in files.done if entry["subject"] == evening.subject]
    done = Counter((entry["gesture"], entry["repetition"]) for entry in own)
    waiting = [prompt for prompt in evening.prompts() if not done[prompt]]
    while waiting:
        gesture, repetition = waiting[0]
        try:
            _record_capture(stage, gesture, repetition)
            waiting.pop(0)
        except Again:
            if own_last := files.done and files.done[-1]["subject"] == evening.subject:
                last = files.take_back()
                waiting.insert(0, (last["gesture"], last["repetition"]))
            stage.say("again" if own_last else "nothing to repeat yet")
    if evening.background:
        prompt = "background: move the robot, turn it, walk; do not touch the skin"
        try:
            stage.collect(evening.background, prompt, "")
        except Again:
            stage.say("background ended")


def _record_capture(stage: Stage, gesture: str, repetition: int) -> None:
    """Prompt for a capture and write it; prompt again if too many frames are lost.

    Raises:
        InputError: frames were lost `MOST_TRIES` times.
    """
    evening = stage.evening
    words = "keep off the skin" if gesture == NO_TOUCH else gesture
    name = f"{words}, repetition {repetition} of {evening.repetitions}"
    label = "" if gesture == NO_TOUCH else gesture
    for trial in range(1, MOST_TRIES + 1):
        stage.collect(evening.rest, f"get ready: {name}", DOUBT)
        frames = stage.collect(evening.seconds, f"go: {name}", label, is_go=True)
        after = stage.wait_for_frames()  # they tell whether the end of the capture was lost
        lost = sum(frame.lost for frame in [*frames, after[0]])
        is_whole = not any(frame.is_restart for frame in frames[1:])
        if frames and is_whole and lost <= MOST_LOST * len(frames):
            values = [frame.values for frame in frames]
            stage.files.add_capture(evening.subject, gesture, repetition, values)
            return
        reason = f"{lost} frames were lost" if is_whole else "the sensor restarted"
        reason = reason if frames else "no frame arrived"
        stage.say(f"{reason}; {name} is repeated ({trial} of {MOST_TRIES})")
    raise InputError(f"{name}: frames were lost {MOST_TRIES} times; check the cable, then continue")


def _print_end(evening: Evening, files: Files, rate_hz: float) -> None:
    """Print the captures by gesture, what looks wrong with them, and the next commands."""
    counts = Counter(entry["gesture"] for entry in files.done)
    people = {entry["subject"] for entry in files.done}
    captures, persons = (
        format_count(len(files.done), "capture"),
        format_count(len(people), "subject"),
    )
    print_lines(f"{files.path}: {captures} of {persons}")
    for gesture, count in sorted(counts.items()):
        print_lines(f"  {gesture}: {count}")
    if not files.done:
        return
    rate = f"{rate_hz:.3g}"
    corpus = read(files.path, float(rate), evening.grid, evening.full_scale)
    doubts = [*Survey(corpus).repeat_warnings(), *find_doubts(corpus), *corpus.info["warnings"]]
    for line in doubts:
        warn(f"warning: {line}")
    layout = f"grid={evening.grid} rate_hz={rate} full_scale={evening.full_scale:g}"
    path, stream = shlex.quote(str(files.path)), shlex.quote(str(files.stream_path))
    name = shlex.quote(files.path.stem)
    print_next_commands(
        f"bench data import table {path} name={name} {layout}",
        f"bench data import recording {stream} name={name}-stream {layout}",
        f"bench build {path} name={name} {layout} out=robot",
    )
