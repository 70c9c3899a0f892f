"""The command ``bench build``: the way from recordings to C, a stored run or model at each step."""

from __future__ import annotations

import shlex
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.options import keys, limits_of, parse_words, settings
from bench.outcomes.scene import Scene, boards, read_scene
from bench.progress import console, span
from bench.scratch import home
from bench.words import SATURATED, quoted

FULL = 0.25  # share of saturated frames beyond which readings tell too little of touch
STEPS = 6


class Progress:
    """Lines of the steps, with the time left for comparisons."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.began, self.step = seconds, time.monotonic(), 0

    @property
    def left(self) -> float:
        """Seconds left to compare systems."""
        return self.seconds - (time.monotonic() - self.began)

    def begin(self, what: str) -> None:
        """Begin the next step."""
        self.step += 1
        line = f"step {self.step} of {STEPS}, after {span(self.seconds - self.left)}: {what}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def build(arguments: list[str]) -> int:
    """Build C with a certificate from recordings, or check a build on other people."""
    words, values = parse_words(arguments, keys("build"), 2)
    try:
        if words[:1] == ["check"]:
            from touchbench_builder.check import checked

            return checked(words[1:], values)
        if len(words) > 1:
            raise InputError(
                f"bench build {words[1]}: give one file; other files become corpora with bench data import"
            )
        return _built(words, values, shlex.join(["bench", "build", *arguments]))
    except KeyboardInterrupt as e:
        said = str(e) or "interrupted; finished steps are stored, and the same command continues from there"
        raise KeyboardInterrupt(said) from e


def _built(words: list[str], values: dict[str, str], command: str) -> int:
    from bench.commands.printing import say, then
    from touchbench_builder.certificate import certificate, line
    from touchbench_builder.choice import compared
    from touchbench_builder.folder import new_build, write

    given = settings("build", values)
    if not given["out"]:
        raise InputError("bench build needs out=, the folder for the C, such as out=robot")
    out, scene = new_build(Path(given["out"]), given["replace"]), _scene(given)
    progress = Progress(given["seconds"])
    progress.begin("recordings")
    on: dict[str, Any] = {key: value for key, value in values.items() if key.partition(".")[0] == "data"}
    on |= {"where": values["where"]} if "where" in values else {}
    if words:
        on["data"] = _imported(Path(words[0]), given, on)
    corpus = _captures(on)
    scene.reactions.of(sorted({*corpus.gestures.astype(str)}))  # refuses others before anything is run
    warnings = surveyed(corpus)
    for warning in warnings:
        console.print(f"warning: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    jobs = {"jobs": values["jobs"]} if "jobs" in values else {}
    chosen = compared(corpus, on | jobs, scene, limits_of(given), progress)
    built = certificate(corpus, on | jobs, warnings, scene, chosen, command, progress)
    progress.begin("C and its tests")
    write(out, built, corpus, given["replace"])
    say(*line(built.facts))
    then(f"make -C {quoted(str(out))} test", f"bench build check {quoted(str(out))} data=newpeople")
    return 0


def _scene(given: Mapping[str, Any]) -> Scene:
    """The needs of the robot; a board that is named replaces that of the scene."""
    scene = read_scene(given["scene"]) if given["scene"] else Scene()
    if name := given["board"]:
        if name not in boards():
            from bench.errors import nearest

            raise InputError(f"board={name}: no board has this name; {nearest(name, boards())}")
        board = replace(boards()[name], share=scene.board.share if scene.board else 1.0)
        scene = replace(scene, board=board, values={**scene.values, **board.budgets(timed=False)})
    for key, what in (("max_decision", "the time of a decision"), ("max_predict", "computing time")):
        if key in scene.values:
            raise InputError(f"scene={given['scene']}: bench build does not measure {what}; leave its budget out")
    return scene


def _imported(file: Path, given: Mapping[str, Any], on: Mapping[str, object]) -> str:
    """The corpus of a file; it is read again only if it, or what is said of it, has changed."""
    from bench.commands.corpora import read
    from bench.corpora.library import stored_value

    if on.keys() & {"data"}:
        raise InputError(f"data={on['data']}: give a file or data=, not both")
    words = "".join(c if c.isalnum() and c.isascii() else "_" for c in file.name.partition(".")[0]).strip("_")
    name = given["name"] or words or "recordings"
    options = {key: f"{given[key]:g}" if isinstance(given[key], float) else given[key] for key in FILE if given[key]}
    with suppress(InputError, OSError):
        stored = stored_value(name)
        asked = {"grid": "x".join(map(str, stored.grid)), "rate_hz": f"{stored.rate_hz:g}"}
        asked |= {"full_scale": f"{stored.full_scale:g}"}
        since = (home() / "corpora" / name / "current").stat().st_mtime
        alike = stored.info.get("format") == given["format"] and options.items() <= asked.items()
        if alike and stored.info.get("source", file.name) == file.name and file.stat().st_mtime < since:
            console.print(f"{file} is already imported as {name}", markup=False, highlight=False)
            return name
    read(given["format"], file, options | {"name": name})
    return name


FILE = ("grid", "rate_hz", "full_scale")


def _captures(on: Mapping[str, Any]) -> Corpus:
    """The captures to learn from, if they can teach a recogniser for people who were not recorded."""
    import bench

    corpus = bench.corpus(**{key.replace("data.", ""): value for key, value in on.items()})
    where = f"data={corpus.name}"
    from bench.corpora.doubts import doubts

    for doubt in doubts(corpus):
        if "differ by case" in doubt:
            raise InputError(f"{where}: {doubt}")
    if (people := len(set(corpus.subjects))) < 2:
        raise InputError(f"{where}: {people} subject; record two at least, as each is left out of training in turn")
    if len(names := sorted(set(corpus.gestures))) < 2:
        raise InputError(f"{where}: the only gesture is {names[0]}; record another one, or captures without touch")
    if (share := saturated(corpus)) > FULL:
        raise InputError(
            f"{where}: the sensor saturates: in {100 * share:.0f} % of frames, a tenth of the taxels is at "
            f"{corpus.full_scale:g}; lower its gain and record again, or correct full_scale="
        )
    return corpus


def saturated(corpus: Corpus) -> float:
    """Share of frames with a tenth of the taxels at full scale."""
    least = -(-corpus.grid[0] * corpus.grid[1] // SATURATED)
    frames = sum(int(((f >= corpus.full_scale).sum(axis=(1, 2)) >= least).sum()) for f in corpus)
    return frames / int(corpus.lengths.sum())


def surveyed(corpus: Corpus) -> list[str]:
    """Warnings of ``bench data show`` that could spoil the result."""
    from bench.corpora.doubts import doubts
    from bench.corpora.survey import Survey

    survey = Survey(corpus)
    lines = [*doubts(corpus), *map(str, corpus.info.get("warnings", []))]
    lines += [text for text in map(str, survey.seams) if "cut" in text]
    lines += survey.taxel_lines()[:1] if len(survey.odd_taxels) else []
    lines += survey.duplicate_lines()[:1] if len(survey.duplicates) else []
    missing = pd.crosstab(corpus.subjects.astype(str), corpus.gestures.astype(str)) == 0
    for subject, gesture in missing.stack()[lambda each: each].index[:3]:
        lines.append(f"subject {subject} has no capture of {gesture}")
    if (share := saturated(corpus)) > 0.01:
        lines.append(f"{100 * share:.0f} % of frames have a tenth of the taxels at full scale")
    return list(dict.fromkeys(lines))
