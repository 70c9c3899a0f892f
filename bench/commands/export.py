"""The command ``bench export``: a saved system as C99."""

from __future__ import annotations

import shlex
from pathlib import Path

from bench.arguments import options_of
from bench.errors import InputError
from bench.outcomes.stopping import NO_SAVING
from bench.scratch import made_whole, new_folder

OPTIONS = ("out", "bits", "target")


def export(arguments: list[str]) -> int:
    """Write a saved system as C.

    Raises:
        InputError: something in the arguments cannot be used, the system has no C, or the folder cannot be written.
    """
    if not arguments or arguments[0].partition("=")[0] in OPTIONS:
        raise InputError("give a model: bench export MODEL out=FOLDER; see bench export --help")
    model, *options = arguments
    values = options_of(options, OPTIONS)
    if "out" not in values:
        raise InputError("bench export needs out=, the folder of the C files")
    if (bits := values.get("bits", "32")) not in ("32", "8"):
        raise InputError(f"bits={bits}: give 32 or 8")
    if (target := values.get("target", "c99")) != "c99":
        raise InputError(f"target={target}: give c99")
    out = new_folder(Path(values["out"]))
    from bench.export.write import files_of
    from bench.work.saved import load

    found = load(model)
    rows, cols = found.grid
    kind = "synthetic " if found.synthetic else ""
    about = f"touchbench: {len(found.classes)} classes of {kind}touch on {rows}x{cols} taxels at {found.rate_hz:g} Hz"
    files = files_of(found, int(bits), about)
    with made_whole(out) as beside:
        beside.mkdir()
        for name, text in files.items():
            (beside / name).write_text(text, encoding="utf-8")
    print(f"{out}: {', '.join(sorted(p.name for p in out.iterdir()))}")
    if found.stopping is not None and not found.stopping.saves:
        print(f"{NO_SAVING}: touch.h has no TOUCH_THRESHOLD, and settled is always 0")
    print("make chip links it for a Cortex-M4F with FLASH=256K RAM=32K; give the sizes of yours behind it")
    print(f"next: make -C {shlex.quote(str(out))} check flash")
    return 0
