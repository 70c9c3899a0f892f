"""The command ``bench stream``: captures replayed through fitted systems, and frames from standard input."""

from __future__ import annotations

import sys
from pathlib import Path

from bench.arguments import KEYS, Values, backend_of, items, number, parse
from bench.commands.printing import say, show, then, writable
from bench.errors import InputError
from bench.options import keys
from bench.plan.cells import cells
from bench.progress import warn
from bench.result import Result
from bench.work.loop import execute, prepared
from bench.work.stream import Stream
from reports.illustrations import illustrate
from reports.streaming import write_streaming

OWN = keys("stream") - KEYS


def stream(arguments: list[str]) -> int:
    """Replay captures under a protocol, or decide on frames from standard input; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    values = parse(arguments, keys("stream"))
    if "source" in values:
        from bench.work.live import live

        if sys.stdin is None:
            raise InputError(f"source={values['source']}: standard input is closed; send frames to it")
        return live(values)
    results, out = streamed(values)
    code = show(results, Stream)
    paths = write_streaming([r for r in results if r.scored], out)
    if paths:
        say(f"figure and tables: {', '.join(map(str, paths))}")
    then("bench choose by=decision")
    return code


def streamed(values: Values) -> tuple[list[Result], Path]:
    """Replay the cells of some values; also return the folder of ``out=``.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    hop = number("hop_ms", values["hop_ms"]) if "hop_ms" in values else None
    replays = [Stream(hop, start) for start in dict.fromkeys(items("start", values.get("start", "onset")))]
    backend = backend_of(values)
    todo = prepared(cells({k: v for k, v in values.items() if k not in OWN}), replays, backend.jobs)
    out = writable(Path(str(values.get("out", "report"))))
    for name in dict.fromkeys(plan.cell.data for plan, _ in todo if len(set(plan.corpus.lengths)) == 1):
        warn(
            f"warning: {name}: all captures have the same length, so features that grow with time are trained on one "
            "duration only; early labels of these features may be wrong"
        )
    return execute(todo, backend, illustrate), out
