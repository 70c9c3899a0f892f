"""The command ``bench build``: the way from recordings to C, a stored run or model at each step."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

import bench
from bench.commands.data import import_and_print
from bench.commands.printing import print_lines, print_next_commands
from bench.corpora.corpus import Corpus
from bench.corpora.doubts import find_doubts
from bench.corpora.library import open_imported
from bench.corpora.survey import Survey
from bench.errors import InputError, suggest_names
from bench.grammar.options import cost_limits, key_options, parse_words, typed_settings
from bench.ground.progress import warn
from bench.ground.typed import quote_value
from bench.reading.scene import Scene, load_boards, read_scene
from touchbench_builder.progress import Progress
from touchbench_streams.recent import find_saturated

FULL = 0.25  # share of saturated frames beyond which readings tell too little of touch
FULL_WARNED = 0.01  # from which on a certificate names it
FILE = ("grid", "rate_hz", "full_scale")  # keys that tell about a file


def build(arguments: list[str]) -> int:
    """Build C with a certificate from recordings, or check a build on other people."""
    words, values = parse_words(arguments, key_options("build"), 2)
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
        message = (
            str(e)
            or "interrupted; finished steps are stored, and the same command continues from there"
        )
        raise KeyboardInterrupt(message) from e


def _built(words: list[str], values: dict[str, str], command: str) -> int:
    from touchbench_builder.certificate import certificate, line
    from touchbench_builder.choice import compared
    from touchbench_builder.folder import new_build, write

    given = typed_settings("build", values)
    if not given["out"]:
        raise InputError("bench build needs out=, the folder for the C, such as out=robot")
    out, scene = new_build(Path(given["out"]), given["replace"]), _scene(given)
    progress = Progress(given["seconds"])
    progress.begin_run("recordings")
    on = {
        key: value
        for key, value in values.items()
        if key in ("where", "jobs") or key.partition(".")[0] == "data"
    }
    if words:
        on["data"] = _imported(Path(words[0]), values, given["format"])
    corpus = _captures({key: value for key, value in on.items() if key != "jobs"})
    scene.reactions.reaction_by_gesture(
        sorted({*corpus.gestures.astype(str)})
    )  # refuses others before anything is run
    warnings = surveyed(corpus)
    for warning in warnings:
        warn(f"warning: {warning}")
    chosen = compared(corpus, on, scene, cost_limits(given), progress)
    recogniser, facts = certificate(corpus, on, warnings, scene, chosen, command, progress)
    progress.begin_run("C and its tests")
    write(out, recogniser, facts, corpus, given["replace"])
    print_lines(*line(facts))
    print_next_commands(
        f"make -C {quote_value(str(out))} test",
        f"bench build check {quote_value(str(out))} data=newpeople",
    )
    return 0


def _scene(given: Mapping[str, Any]) -> Scene:
    """The needs of the robot; a board that is named replaces that of the scene."""
    scene = read_scene(given["scene"]) if given["scene"] else Scene()
    if name := given["board"]:
        if name not in load_boards():
            raise InputError(
                f"board={name}: no board has this name; {suggest_names(name, load_boards())}"
            )
        board = replace(load_boards()[name], share=scene.board.share if scene.board else 1.0)
        scene = replace(
            scene, board=board, values={**scene.values, **board.as_budgets(timed=False)}
        )
    for key, what in (
        ("max_decision", "the time of a decision"),
        ("max_predict", "computing time"),
    ):
        if key in scene.values:
            raise InputError(
                f"scene={given['scene']}: bench build does not measure {what}; leave its budget out"
            )
    return scene


def _imported(file: Path, values: Mapping[str, str], kind: str) -> str:
    """The corpus of a file. It is read again each time: runs stay stored, as long as its content does not change."""
    if "data" in values:
        raise InputError(f"data={values['data']}: give a file or data=, not both")
    words = "".join(
        c if c.isalnum() and c.isascii() else "_" for c in file.name.partition(".")[0]
    ).strip("_")
    name, source = values.get("name") or words or "recordings", file.name
    with suppress(InputError):  # there is none
        source = str(open_imported(name).info.get("source", source))
    if "name" not in values and file.name not in source:
        raise InputError(
            f"{file}: a corpus {name} was imported from {source}; give the new one a name="
        )
    import_and_print(
        kind, file, {key: values[key] for key in FILE if key in values} | {"name": name}
    )
    return name


def _captures(on: Mapping[str, str]) -> Corpus:
    """The captures to learn from, if they can teach a recogniser for people who were not recorded."""
    corpus = bench.corpus(**{key.replace("data.", ""): value for key, value in on.items()})
    where = f"data={corpus.name}"
    for doubt in find_doubts(corpus):
        if "differ by case" in doubt:
            raise InputError(f"{where}: {doubt}")
    if (people := len(set(corpus.subjects))) < 2:
        raise InputError(
            f"{where}: {people} subject; record two at least, as each is left out of training in turn"
        )
    if len(names := sorted(set(corpus.gestures))) < 2:
        raise InputError(
            f"{where}: the only gesture is {names[0]}; record another one, or captures without touch"
        )
    if (share := _share_saturated(corpus)) > FULL:
        raise InputError(
            f"{where}: the sensor saturates: in {100 * share:.0f} % of frames, a tenth of the taxels is at "
            f"{corpus.full_scale:g}; lower its gain and record again, or correct full_scale="
        )
    return corpus


def _share_saturated(corpus: Corpus) -> float:
    return sum(int(find_saturated(frames, corpus.full_scale).sum()) for frames in corpus) / int(
        corpus.lengths.sum()
    )


def surveyed(corpus: Corpus) -> list[str]:
    """Warnings of ``bench data show`` that could spoil the result."""
    survey = Survey(corpus)
    lines = [*find_doubts(corpus), *map(str, corpus.info.get("warnings", []))]
    lines += [text for text in map(str, survey.seams) if "cut" in text]
    lines += (
        [". ".join(map(str.strip, survey.taxel_lines()[:2]))] if len(survey.odd_taxels) else []
    )  # an example
    lines += survey.repeat_warnings()
    missing = pd.crosstab(corpus.subjects.astype(str), corpus.gestures.astype(str)) == 0
    for subject, gesture in missing.stack()[lambda each: each].index[:3]:
        lines.append(f"subject {subject} has no capture of {gesture}")
    if (share := _share_saturated(corpus)) > FULL_WARNED:
        lines.append(f"{100 * share:.0f} % of frames have a tenth of the taxels at full scale")
    return list(dict.fromkeys(lines))
