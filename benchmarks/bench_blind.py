"""What hiding labels in prediction costs a fold of a corpus of CoST's size, and what predicting captures again costs.

Processor seconds of one LOSO fold, medians of five in turn: with open corpora, with blind ones, and with the check.

    python benchmarks/bench_blind.py
"""

import time
from statistics import median

from bench import contract
from bench.kinds.captures import Captures
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.work import evaluation
from bench.work.workers import fill_cache

SYSTEMS = ({"model": "lda", "features": "touch"}, {"model": "svm", "features": "jung54"})
ROUNDS = 5


def main() -> None:
    """Print a line for each system."""
    blinded, batch_effects = contract.blinded, evaluation.batch_effects
    for system in SYSTEMS:
        (plan,) = planned(cells({"data.subjects": 31, "data.repetitions": 6, **system}), 1)
        fill_cache(plan.cell, plan.corpus)
        spent: dict[str, list[float]] = {"open": [], "blind": [], "checked": []}
        for _ in range(ROUNDS):
            for how, times in spent.items():
                contract.blinded = blinded if how != "open" else lambda estimator, X: X
                evaluation.batch_effects = batch_effects if how == "checked" else lambda *_: []
                began = time.process_time()
                Captures().fold(plan.cell, plan.corpus, plan.folds[0], 1)
                times.append(time.process_time() - began)
        seconds = {how: median(times) for how, times in spent.items()}
        ratios = ", ".join(f"{how} / open {seconds[how] / seconds['open']:.2f}" for how in ("blind", "checked"))
        print(f"{plan.cell.system()}, {len(plan.corpus)} captures: open {seconds['open']:.2f} s, {ratios}", flush=True)


if __name__ == "__main__":
    main()
