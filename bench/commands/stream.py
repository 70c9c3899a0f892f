"""The command ``bench stream``: captures replayed through fitted systems, and frames from standard input."""

from __future__ import annotations

import sys
from pathlib import Path

from bench.arguments import KEYS as RUN_KEYS
from bench.arguments import Values, backend_of, items, number, parse
from bench.commands.printing import say, show, then, writable
from bench.errors import InputError
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.progress import warn
from bench.work.loop import Outcome, execute, prepared
from bench.work.stream import Stream
from reports.illustrations import illustrate
from reports.streaming import write_streaming

OPTIONS = {"hop_ms", "start", "out"}
KEYS = RUN_KEYS | OPTIONS | {"source", "window_ms"}
LONGEST_WINDOW = 86_400_000.0  # ms


def stream(arguments: list[str]) -> int:
    """Replay captures under a protocol, or decide on frames from standard input; exit code as of ``bench run``.

    Raises:
        InputError: something in the arguments or the data cannot be used; nothing was run.
    """
    values = parse(arguments, KEYS)
    if "source" in values:
        from bench.work.live import live

        if sys.stdin is None:
            raise InputError(f"source={values['source']}: standard input is closed; send frames to it")
        if "window_ms" in values and number("window_ms", values["window_ms"]) > LONGEST_WINDOW:
            raise InputError(f"window_ms={values['window_ms'][:60]}: give at most {LONGEST_WINDOW:g}, a day")
        return live(values)
    if "window_ms" in values:
        raise InputError(f"window_ms={values['window_ms']}: only with source=-; leave it out")
    outcomes, out = streamed(values)
    code = show(outcomes)
    paths = write_streaming(connect(), [o.run_id for o in outcomes if o.findings], out)
    if paths:
        say(f"figure and tables: {', '.join(map(str, paths))}")
    then("bench choose by=decision")
    return code


def streamed(values: Values) -> tuple[list[Outcome], Path]:
    """The cells of some values, replayed; and the folder that was asked for.

    Raises:
        InputError: something in the values or the data cannot be used; nothing was run.
    """
    hop = number("hop_ms", values["hop_ms"]) if "hop_ms" in values else None
    replays = [Stream(hop, start) for start in dict.fromkeys(items("start", values.get("start", "onset")))]
    backend = backend_of(values)
    todo = prepared(cells({k: v for k, v in values.items() if k not in OPTIONS}), replays, backend.jobs)
    out = writable(Path(str(values.get("out", "report"))))
    for name in dict.fromkeys(plan.cell.data for plan, _ in todo if len(set(plan.corpus.lengths)) == 1):
        warn(
            f"warning: {name}: all captures are equally long; features that grow with duration were never seen at "
            "another one, so a capture that is not whole yet may look like nothing that was ever seen"
        )
    return execute(todo, backend, illustrate), out
