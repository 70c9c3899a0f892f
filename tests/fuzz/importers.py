"""Import thousands of good and damaged files, each within bounds, and compare with the independent reader.

python tests/fuzz/importers.py --examples 5000 --seed 0

Every import ends in one class: ``refused`` in one line of at most 300 characters; ``right``, the same as the
independent reader finds; ``wrong``, anything else that ends well, also a good file that is refused; ``traceback``,
also a process that dies; ``beyond`` 10 s or 1500 MiB. The last three must be 0; their files are kept.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.fuzz.child import CLASSES, Child, Outcome  # noqa: E402
from tests.fuzz.inputs import KINDS, Input  # noqa: E402
from tests.fuzz.mutations import example  # noqa: E402

BAD = ("wrong", "traceback", "beyond")


def outcomes(numbers: Iterable[int], seed: int, keep: Path, processes: int = 2) -> Iterator[tuple[Input, Outcome]]:
    """Import the files of these numbers; what ends badly is kept.

    Args:
        numbers: of the files; KINDS take turns.
        seed: chooses them.
        keep: folder for the files of bad outcomes, each with what is known of it.
        processes: that import side by side.
    """
    children: SimpleQueue = SimpleQueue()

    def one(number: int) -> tuple[Input, Outcome]:
        given = example(seed, number)
        child = children.get()
        try:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / given.name
                path.write_bytes(given.content)
                found = child.run(given.importer, path, given.options, valid=None if given.damage else True)
        finally:
            children.put(child)
        if found.kind in BAD:
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{seed}-{number}{Path(given.name).suffix}").write_bytes(given.content)
            about = {"importer": given.importer, "options": given.options, "damage": given.damage} | vars(found)
            (keep / f"{seed}-{number}.json").write_text(json.dumps(about, indent=1))
        return given, found

    for _ in range(processes):
        children.put(Child())
    with ThreadPoolExecutor(processes) as pool:
        try:
            yield from pool.map(one, numbers)
        finally:
            pool.shutdown(cancel_futures=True)
            for _ in range(processes):
                children.get().stop()


def printed(counts: Counter, slowest: dict, largest: dict) -> str:
    """The table of outcomes."""
    rows = [["", *CLASSES, "all", "slowest, s", "most, MiB"]]
    for kind in KINDS:
        numbers = [counts[kind, c] for c in CLASSES]
        rows.append(
            [kind, *map(str, [*numbers, sum(numbers)]), f"{slowest.get(kind, 0):.1f}", f"{largest.get(kind, 0):.0f}"]
        )
    numbers = [sum(counts[kind, c] for kind in KINDS) for c in CLASSES]
    rows.append(
        ["all", *map(str, [*numbers, sum(numbers)]), f"{max(slowest.values()):.1f}", f"{max(largest.values()):.0f}"]
    )
    return "\n".join("".join(f"{cell:>11}" for cell in row) for row in rows)


def main() -> int:
    """Run by hand."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "touchbench-fuzz")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS, help="only these of the files")
    asked = parser.parse_args()
    numbers = [n for n in range(asked.examples) if KINDS[n % len(KINDS)] in asked.kinds]
    counts: Counter = Counter()
    slowest: dict = {}
    largest: dict = {}
    started = time.perf_counter()
    for given, found in outcomes(numbers, asked.seed, asked.keep, asked.processes):
        counts[given.kind, found.kind] += 1
        slowest[given.kind] = max(slowest.get(given.kind, 0), found.seconds)
        largest[given.kind] = max(largest.get(given.kind, 0), found.mib)
        if found.kind in BAD:
            last = found.message.strip().splitlines()[-1] if found.message.strip() else ""
            print(f"{found.kind}: {given.kind}, {'; '.join(given.damage) or 'good'}: {last[:300]}", flush=True)
    print(printed(counts, slowest, largest))
    print(f"{len(numbers)} files in {time.perf_counter() - started:.0f} s; bad ones are in {asked.keep}")
    return int(any(counts[kind, bad] for kind in KINDS for bad in BAD))


if __name__ == "__main__":
    sys.exit(main())
