"""The command ``bench export``: a saved system as C99."""

from __future__ import annotations

import shlex
from pathlib import Path

from bench.arguments import parse_words, settings
from bench.commands.printing import then
from bench.errors import InputError
from bench.options import keys
from bench.scratch import made_whole, new_folder
from bench.work.stopping import NO_SAVING


def export(arguments: list[str]) -> int:
    """Write a saved system as C.

    Raises:
        InputError: something in the arguments cannot be used, the system has no C, or the folder cannot be written.
    """
    words, values = parse_words(arguments, keys("export"), 1)
    if not words or "out" not in values:
        raise InputError("give a model and out=, the folder for the C files: bench export MODEL out=FOLDER")
    bits, out = int(settings("export", values)["bits"]), new_folder(Path(values["out"]))
    from bench.in_c.write import files_of
    from bench.work.saved import load

    model = load(words[0])
    grid, kind = "x".join(map(str, model.grid)), "synthetic " if model.synthetic else ""
    title = f"touchbench: {len(model.classes)} classes of {kind}touch on {grid} taxels at {model.rate_hz:g} Hz"
    files = files_of(model, bits, title)
    with made_whole(out) as beside:
        beside.mkdir()
        for name, text in files.items():
            (beside / name).write_text(text, encoding="utf-8")
    print(f"{out}: {', '.join(sorted(path.name for path in out.iterdir()))}")
    if model.stopping is not None and not model.stopping.saves:
        print(f"{NO_SAVING}: touch.h has no TOUCH_THRESHOLD, and settled is always 0")
    if model.watcher is not None and "touch_watch(" not in files["touch.h"]:
        print("touch.h has no touch_watch: only systems on the feature set touch can watch an endless stream in C")
    print("make chip links for a Cortex-M4F with FLASH=256K RAM=32K; for another chip, append its sizes")
    then(f"make -C {shlex.quote(str(out))} check flash")
    return 0
