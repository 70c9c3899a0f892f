"""How honest the time left is: what each line of a run of twenty folds says, beside when the run really ended.

python benchmarks/bench_left.py [words of bench run]
"""

import re
import subprocess
import sys
import tempfile
import time

RUN = ["model=cnn85", "model.epochs=4", "data.subjects=20", "data.repetitions=1", "data.variants=normal", "jobs=2"]
UNITS = {"s": 1, "min": 60, "h": 3600}


def main(words: list[str]) -> None:
    """Print fold by fold what was said, and how far off it was."""
    with tempfile.TemporaryDirectory() as folder:
        code = "import sys; from bench.cli import main; sys.exit(main(sys.argv[1:]))"
        command = [sys.executable, "-c", code, "run", *words]
        process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        began, lines = time.monotonic(), []
        for line in process.stderr:
            if " fold " in line:
                words = re.search(r", ((?:\d+ (?:s|min|h) ?)+)left", line)
                left = sum(int(n) * UNITS[u] for n, u in re.findall(r"(\d+) (s|min|h)", words[1])) if words else 0
                lines.append((time.monotonic() - began, left))
        assert process.wait() == 0
    end = lines[-1][0]
    print(f"{len(lines)} folds in {end:.0f} s")
    for number, (at, left) in enumerate(lines[:-1], 1):
        print(f"after {number:2} folds, {at:5.0f} s: {left:4.0f} s left, really {end - at:4.0f}")
    first = lines[len(lines) // 10 : -1]
    off = sorted(abs(left - (end - at)) / max(end - at, 1) for at, left in first)
    median, most = 100 * off[len(off) // 2], 100 * off[-1]
    print(f"from a tenth of the folds on, off by {median:.0f} % in the median, {most:.0f} at most")


if __name__ == "__main__":
    main(sys.argv[1:] or RUN)
