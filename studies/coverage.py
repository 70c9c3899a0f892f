"""Coverage of the bounds for a new person, built from a few people and tested on others.

    bench run data=haart,cuddlebot protocol=loso features=touch,jung28,jung54 model=lda,svm,rf
    python studies/coverage.py haart cuddlebot

There are 2,000 draws of each. Three rules are compared: Student's t for the true mean, the same for
the next people, and `lower_bound`. For each it prints the percent of draws in which the mean of the
others (of generated people then the true one) reaches ``mean_low``, which promises 95; the percent
of others who reach ``person_low``, which promises 90; and the median distance in points from the
mean of the known people to ``mean_low``.
"""

import itertools
import sys

import numpy as np
from scipy.special import stdtrit

import bench
from touchbench_builder.bounds import GESTURE_SPREAD, SPREAD, count_next_people, lower_bound

DRAWS = 2000
KNOWN_PEOPLE = (3, 4, 5, 6, 8)
GENERATED = [(0.7, 0.06), (0.7, 0.15), (0.8, 0.1), (0.9, 0.05), (0.9, 0.1), (0.95, 0.05)]
GENERATED += [(0.98, 0.02)]  # mean accuracy and SD of people


def print_row(
    title: str,
    right: np.ndarray,
    total: np.ndarray,
    others: np.ndarray,
    spread: float,
    *true_mean: float,
) -> None:
    """Print the coverage of all rules.

    Args:
        title: of the row.
        right: numbers of correct captures [..., known people].
        total: numbers of captures [..., known people].
        others: accuracies [..., other people].
        spread: that of people, for `lower_bound`.
        true_mean: that of generated people.
    """
    known, accuracy = right.shape[-1], right / total
    mean, sd = accuracy.mean(axis=-1), accuracy.std(axis=-1, ddof=1)
    mean_margin, person_margin = (stdtrit(known - 1, level) * sd for level in (0.95, 0.9))
    person_low = mean - person_margin * np.sqrt(1 + 1 / known)
    rules = [
        (mean - mean_margin / np.sqrt(known), person_low),
        (mean - mean_margin * np.sqrt(1 / known + 1 / count_next_people(known)), person_low),
        (
            lower_bound(right, total, 0.95, count_next_people(known), spread),
            lower_bound(right, total, 0.9, 1, spread),
        ),
    ]
    for mean_low, low in rules:
        held = [mean_low <= truth + 1e-9 for truth in (others.mean(axis=-1), *true_mean)]
        shares = [*map(np.mean, [*held, low[..., None] <= others + 1e-9])]
        shares.append(np.median(mean - mean_low))
        title += " |" + "".join(f"{100 * share:6.1f}" for share in shares)
    print(title, flush=True)


rng = np.random.default_rng(0)
for data in sys.argv[1:]:
    labels = bench.predictions(data=data, protocol="loso")
    predicted = labels.filter(regex="^p_").idxmax(axis=1).str[2:]
    labels["right"] = predicted == labels["true"].astype(str)
    for gesture, part in [("all", labels), *labels.groupby("true", observed=True)]:
        groups = part.groupby(["run_id", "subject"], observed=True)["right"]
        counts = groups.agg(["sum", "size"]).unstack("subject")
        right, total = counts["sum"].values, counts["size"].values
        spread = SPREAD if gesture == "all" else GESTURE_SPREAD
        for known in KNOWN_PEOPLE:
            order = rng.permuted(np.tile(np.arange(right.shape[1]), (DRAWS, 1)), axis=1)
            ours, others = order[:, :known], (right / total)[:, order[:, known:]]
            title = f"{data} {gesture} {known}"
            print_row(title, right[:, ours], total[:, ours], others, spread)
            # The system is chosen: for each known person by the others, for the tested by all.
            seen = (right / total)[:, ours]
            chosen = (seen.sum(axis=-1, keepdims=True) - seen).argmax(axis=0)
            tested = others[seen.sum(axis=-1).argmax(axis=0), np.arange(DRAWS)]
            chosen_counts = right[chosen, ours], total[chosen, ours]
            print_row(f"{title} chosen", *chosen_counts, tested, spread)
for (mean, sd), known, bad in itertools.product(GENERATED, KNOWN_PEOPLE, (0, 0.1)):
    # A share ``bad`` of people loses 30 %.
    alpha, beta = np.array([mean, 1 - mean]) * (mean * (1 - mean) / sd**2 - 1)
    people = rng.beta(alpha, beta, (DRAWS, known + count_next_people(known)))
    right = rng.binomial(60, people * np.where(rng.random(people.shape) < bad, 0.7, 1))
    title, total = f"mean {mean} SD {sd} bad {bad} {known}", np.full(known, 60)
    true_mean = mean * (1 - 0.3 * bad)
    print_row(title, right[:, :known], total, right[:, known:] / 60, SPREAD, true_mean)
