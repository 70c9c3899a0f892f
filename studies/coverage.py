"""Coverage of the bounds for a new person: built from a few people, tested on others, 2,000 draws each.

    bench run data=haart,cuddlebot protocol=loso features=touch,jung28,jung54 model=lda,svm,rf
    python studies/coverage.py haart cuddlebot

Three rules: Student's t for the true mean, the same for next people, and `lower_bound`. Of each: percent of draws in
which the mean of the others (of generated people then the true one) reaches ``mean_low``, which promises 95; percent of
others who reach ``person_low``, which promises 90; points from the mean of the known people to ``mean_low`` (median).
"""

import sys

import numpy as np
from scipy.special import stdtrit

import bench
from touchbench_builder.bounds import GESTURE_SPREAD, SPREAD, ahead, lower_bound


def row(
    title: str,
    right: np.ndarray,
    total: np.ndarray,
    others: np.ndarray,
    spread: float,
    *true: float,
) -> None:
    """Print what the rules hold for counts [..., known people] and accuracies [..., others]."""
    known, mean, sd = (
        right.shape[-1],
        (right / total).mean(axis=-1),
        (right / total).std(axis=-1, ddof=1),
    )
    t, person_t = (stdtrit(known - 1, level) * sd for level in (0.95, 0.9))
    person, person_low = (
        mean - person_t * np.sqrt(1 + 1 / known),
        lower_bound(right, total, 0.9, 1, spread),
    )
    rules = [
        (mean - t / np.sqrt(known), person),
        (mean - t * np.sqrt(1 / known + 1 / ahead(known)), person),
    ]
    for low, person in (
        *rules,
        (lower_bound(right, total, 0.95, ahead(known), spread), person_low),
    ):
        held = [low <= truth + 1e-9 for truth in (others.mean(axis=-1), *true)] + [
            person[..., None] <= others + 1e-9
        ]
        title += " |" + "".join(
            f"{100 * share:6.1f}" for share in (*map(np.mean, held), np.median(mean - low))
        )
    print(title, flush=True)


rng, knowns = np.random.default_rng(0), (3, 4, 5, 6, 8)
for data in sys.argv[1:]:
    labels = bench.predictions(data=data, protocol="loso")
    labels["right"] = labels.filter(regex="^p_").idxmax(axis=1).str[2:] == labels["true"].astype(
        str
    )
    for gesture, part in [("all", labels), *labels.groupby("true", observed=True)]:
        counts = (
            part.groupby(["run_id", "subject"], observed=True)["right"]
            .agg(["sum", "size"])
            .unstack("subject")
        )
        right, total, spread = (
            counts["sum"].values,
            counts["size"].values,
            SPREAD if gesture == "all" else GESTURE_SPREAD,
        )
        for known in knowns:
            order = rng.permuted(np.tile(np.arange(right.shape[1]), (2000, 1)), axis=1)
            ours, others = order[:, :known], (right / total)[:, order[:, known:]]
            row(f"{data} {gesture} {known}", right[:, ours], total[:, ours], others, spread)
            seen, draws = (right / total)[:, ours], np.arange(2000)
            by_others = (seen.sum(axis=-1, keepdims=True) - seen).argmax(
                axis=0
            )  # of the known people, for each
            tested = others[seen.sum(axis=-1).argmax(axis=0), draws]
            row(
                f"{data} {gesture} {known} chosen",
                right[by_others, ours],
                total[by_others, ours],
                tested,
                spread,
            )
for mean, sd in (
    (0.7, 0.06),
    (0.7, 0.15),
    (0.8, 0.1),
    (0.9, 0.05),
    (0.9, 0.1),
    (0.95, 0.05),
    (0.98, 0.02),
):
    for known, bad in (
        (known, bad) for known in knowns for bad in (0, 0.1)
    ):  # share of people who lose 30 %
        alpha, beta = np.array([mean, 1 - mean]) * (mean * (1 - mean) / sd**2 - 1)
        people = rng.beta(alpha, beta, (2000, known + ahead(known)))
        right = rng.binomial(60, people * np.where(rng.random(people.shape) < bad, 0.7, 1))
        title, total = f"mean {mean} SD {sd} bad {bad} {known}", np.full(known, 60)
        row(title, right[:, :known], total, right[:, known:] / 60, SPREAD, mean * (1 - 0.3 * bad))
