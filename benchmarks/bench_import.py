"""Time and memory of importing a CoST.csv of full size: 7812 generated captures, about 1.5 million rows, 68 columns.

python benchmarks/bench_import.py
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.corpora.read.cost import write
from bench.corpora.synth import generate


def main() -> None:
    """Print seconds and peak memory of generating, of exporting, and of an import in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TOUCHBENCH_HOME"] = folder
        path = Path(folder) / "CoST.csv"
        started = time.perf_counter()
        corpus = generate(subjects=31, repetitions=6)
        made = time.perf_counter() - started
        print(f"generated {len(corpus)} captures, {len(corpus.frames)} frames: {len(corpus) / made:.0f} captures/s")
        started = time.perf_counter()
        write(corpus, path)
        print(f"exported {path.stat().st_size / 2**20:.0f} MiB in {time.perf_counter() - started:.1f} s", flush=True)
        command = "import sys; from bench.cli import main; sys.exit(main(sys.argv[1:]))"
        started = time.perf_counter()
        subprocess.run(
            [sys.executable, "-c", command, "data", "import", "cost", str(path)], check=True, stderr=subprocess.DEVNULL
        )
        seconds = time.perf_counter() - started
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10
        print(f"imported in {seconds:.1f} s with a peak of {peak:.0f} MiB")
        code = (
            "import time; from bench.corpora.library import open_corpus; open_corpus('cost', {});"
            "t = time.perf_counter(); c = open_corpus('cost', {}); t = time.perf_counter() - t;"
            "print(len(c), t, c.frames.sum())"
        )
        count, opened, total = subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True
        ).stdout.split()
        same = int(count) == len(corpus) and int(total) == int(corpus.frames.sum())
        print(f"opened in {1000 * float(opened):.1f} ms; the same captures and values: {same}")


if __name__ == "__main__":
    main()
