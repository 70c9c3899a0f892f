"""The command ``bench export`` (a saved system as C99), and ``clock=`` of ``bench choose``."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import (
    START,
    TRUST_NOTE,
    Command,
    key_options,
    parse_words,
    typed_settings,
)
from bench.ground.typed import Option

if TYPE_CHECKING:
    from bench.running.saved import Recogniser

CLOCK = Option(
    "clock",
    "MHz",
    None,
    "clock rate of the chip, such as 64MHz; adds its cycles to decision times",
)
PREFIX_OPTION = Option(
    "prefix",
    "text",
    "touch",
    "what public names of the C begin with; another one for each model in a program",
)
EXPORT = Command(
    START,
    "write a saved model as C99 for a microcontroller",
    "Writes touch.h, touch.c, tables.h and a Makefile. The C needs no heap and no library except "
    "math.h. make and make check build for this machine, make chip for a Cortex-M4F (FLASH=256K "
    "RAM=32K). make flash and make count print bytes, instructions and stack. C exists for reflex "
    "and hughes2017_cnn. It also exists for lda, softmax, bayes, svm, tree, rf, et and xgb with "
    f"jung28, or with touch and model.window=. {TRUST_NOTE}",
    "bench fit data=haart model=reflex out=rec\nbench export rec out=rec_c bits=8\n"
    "make -C rec_c check",
    "MODEL out=FOLDER [key=value ...]",
    module="touchbench_chip.command",
    follows={"fit": "bench export {} out=in_c"},
    unfit="why_no_c",
    options=(
        Option(
            "bits",
            "text",
            "32",
            "bits per stored weight; 8 uses 16 for support vectors",
            ("32", "8"),
        ),
        PREFIX_OPTION,
        Option(
            "slices",
            "counts",
            1,
            "frames over which touch_watch spreads the work on a name; its news come later by one "
            "frame less",
        ),
        Option("out", "text", "", "folder for the C files; new or empty"),
    ),
)


def why_no_c(recogniser: Recogniser) -> str:
    """Why a saved system has no C; empty if it has."""
    from touchbench_chip.tables import collect_contents

    try:
        collect_contents(recogniser, 32)
    except InputError as e:
        return str(e)
    return ""


def export(arguments: list[str]) -> int:
    """Run ``bench export``: write a saved system as C."""
    from bench.commands.printing import print_next_commands
    from bench.ground.scratch import check_empty_folder, fill_then_rename
    from bench.running.saved import load_recogniser
    from bench.values.stopping import NO_SAVING
    from touchbench_chip.write import write_c_sources

    words, values = parse_words(arguments, key_options("export"), 1)
    if not words or "out" not in values:
        raise InputError(
            "give a model and out=, the folder for the C files: bench export MODEL out=FOLDER"
        )
    settings = typed_settings("export", values)
    bits, prefix, slices = int(settings["bits"]), settings["prefix"], settings["slices"]
    out = check_empty_folder(Path(values["out"]))

    model = load_recogniser(words[0])
    if slices > 1 and model.watcher is not None:
        model.watcher = replace(model.watcher, slices=slices)
    grid, kind = "x".join(map(str, model.grid)), "synthetic " if model.synthetic else ""
    title = (
        f"touchbench: {len(model.classes)} classes of {kind}touch on {grid} taxels at "
        f"{model.rate_hz:g} Hz"
    )
    files = write_c_sources(model, bits, title, prefix)
    has_watch = f"{prefix}_watch(" in files["touch.h"]
    if slices > 1 and not has_watch:
        raise InputError(f"slices={slices}: touch.h has no {prefix}_watch; leave it out")
    with fill_then_rename(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    print(f"{out}: {', '.join(sorted(path.name for path in out.iterdir()))}")
    if model.stopping is not None and not model.stopping.saves:
        print(f"{NO_SAVING}: touch.h has no {prefix.upper()}_THRESHOLD, and settled is always 0")
    if model.watcher is not None and not has_watch:
        print(
            f"touch.h has no {prefix}_watch: only systems on the feature set touch can watch an "
            "endless stream in C"
        )
    print(
        "make chip links for a Cortex-M4F with FLASH=256K RAM=32K; for another chip, append its "
        "sizes"
    )
    print_next_commands(f"make -C {shlex.quote(str(out))} check")
    return 0
