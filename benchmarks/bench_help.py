"""Whole-process time of the help pages, which must answer in under half a second.

python benchmarks/bench_help.py
"""

import subprocess
import sys
import time


def main() -> None:
    """Print the median of nine runs of each page."""
    code = "import sys; from bench.cli import main; sys.exit(main(sys.argv[1:]))"
    for page in (
        ["--help"],
        ["run", "--help"],
        ["stress", "--help"],
        ["data", "--help"],
        ["report", "--help"],
        ["ui", "--help"],
    ):
        times = []
        for _ in range(9):
            started = time.perf_counter()
            subprocess.run([sys.executable, "-c", code, *page], check=True, stdout=subprocess.DEVNULL)
            times.append(time.perf_counter() - started)
        print(f"bench {' '.join(page):15} {sorted(times)[4]:.3f} s")


if __name__ == "__main__":
    main()
