"""The command ``bench build``: from recordings to C, with a stored run or model at each step."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.commands.data import import_and_print
from bench.commands.printing import print_lines, print_next_commands
from bench.corpora.library import open_imported
from bench.errors import InputError, suggest_names
from bench.grammar.options import cost_limits, key_options, parse_words, typed_settings
from bench.ground.progress import warn
from bench.ground.typed import quote_value
from bench.reading.scene import Scene, load_boards, read_scene
from bench.values import few
from touchbench_builder.captures import (
    data_arguments,
    data_warnings,
    load_training_captures,
)
from touchbench_builder.progress import Progress

FILE_KEYS = ("grid", "rate_hz", "full_scale")  # keys that describe a file


def build(arguments: list[str]) -> int:
    """Build C with a certificate from recordings, or check a build on other people."""
    words, values = parse_words(arguments, key_options("build"), 2)
    try:
        if words[:1] == ["check"]:
            from touchbench_builder.check import check_build

            return check_build(words[1:], values)
        if len(words) > 1:
            raise InputError(
                f"bench build {words[1]}: give one file; other files become corpora with bench "
                "data import"
            )
        return _run_build(words, values, shlex.join(["bench", "build", *arguments]))
    except KeyboardInterrupt as e:
        stored = "finished steps are stored, and the same command continues from there"
        raise KeyboardInterrupt(str(e) or f"interrupted; {stored}") from e


def _run_build(words: list[str], values: dict[str, str], command: str) -> int:
    from touchbench_builder.certificate import make_certificate, summary_lines
    from touchbench_builder.folder import check_build_folder, write_build
    from touchbench_builder.stream import first_recording, open_stream_captures, why_no_stream
    from touchbench_builder.systems import STREAM_BUDGETS, compare_systems, parse_trained_faults
    from touchbench_chip.write import check_prefix

    settings = typed_settings("build", values)
    if not settings["out"]:
        raise InputError("bench build needs out=, the folder for the C, such as out=robot")
    out = check_build_folder(Path(settings["out"]), settings["replace"])
    check_prefix(settings["prefix"])
    scene = _load_scene(settings)
    faults = parse_trained_faults(settings["faults"])
    progress = Progress(settings["seconds"])
    progress.start_step("recordings")
    on = data_arguments(values)
    if words:
        on["data"] = _import_file(Path(words[0]), values, settings["format"])
    corpus = load_training_captures(on)
    on |= {"jobs": values["jobs"]} if "jobs" in values else {}
    # Raises an error for other gestures before anything is run.
    scene.reactions.reaction_by_gesture(sorted({*corpus.gestures.astype(str)}))
    warnings = data_warnings(corpus)
    for warning in warnings:
        warn(f"warning: {warning}")
    no_stream = "watch=no leaves it out"
    if settings["watch"]:
        no_stream = why_no_stream(open_stream_captures(on, corpus))
    if no_stream and (keys := sorted({*STREAM_BUDGETS} & scene.values.keys())):
        raise InputError(f"scene={settings['scene']}: {keys[0]} needs a stream: {no_stream}")
    if no_stream:
        warn(f"warning: captures only, nothing watches a stream: {no_stream}")
    limits = cost_limits(settings)
    chosen = compare_systems(corpus, on, scene, limits, progress, not no_stream, faults)
    recogniser, facts = make_certificate(
        corpus, on, warnings, scene, chosen, command, progress, no_stream
    )
    facts["system"]["prefix"] = settings["prefix"]
    progress.start_step("C and its tests")
    recording = None if no_stream else first_recording(on, corpus)
    write_build(out, recogniser, facts, corpus, recording)
    print_lines(*summary_lines(facts))
    print_next_commands(*_next_commands(quote_value(str(out)), facts["data"]["people"]))
    return 0


def _next_commands(folder: str, people: int) -> list[str]:
    """Commands for a build; nothing can be compared with a certificate of too few people."""
    check = f"bench build check {folder} data=newpeople"
    return [f"make -C {folder} test", *([check] if people >= few.FEWEST_FOR_INTERVAL else [])]


def _load_scene(settings: Mapping[str, Any]) -> Scene:
    """Load the needs of the robot; ``board=`` replaces the board of the scene."""
    scene = read_scene(settings["scene"]) if settings["scene"] else Scene()
    if name := settings["board"]:
        boards = load_boards()
        if name not in boards:
            raise InputError(f"board={name}: no board has this name; {suggest_names(name, boards)}")
        board = replace(boards[name], share=scene.board.share if scene.board else 1.0)
        budgets = {**scene.values, **board.as_budgets(timed=False)}
        scene = replace(scene, board=board, values=budgets)
    unmeasured = {"max_decision": "the time of a decision", "max_predict": "computing time"}
    for key, noun in unmeasured.items():
        if key in scene.values:
            raise InputError(
                f"scene={settings['scene']}: bench build does not measure {noun}; leave its budget "
                "out"
            )
    return scene


def _import_file(file: Path, values: Mapping[str, str], kind: str) -> str:
    """Import a file, and return the name of its corpus.

    The file is read each time; stored runs remain valid as long as its content does not change.
    """
    if "data" in values:
        raise InputError(f"data={values['data']}: give a file or data=, not both")
    stem = re.sub("[^0-9A-Za-z]", "_", file.name.partition(".")[0]).strip("_")
    name, source = values.get("name") or stem or "recordings", file.name
    with suppress(InputError):  # no such corpus yet
        source = str(open_imported(name).info.get("source", source))
    if "name" not in values and file.name not in source:
        raise InputError(
            f"{file}: a corpus {name} was imported from {source}; give the new one a name="
        )
    options = {key: values[key] for key in FILE_KEYS if key in values}
    import_and_print(kind, file, options | {"name": name})
    return name
