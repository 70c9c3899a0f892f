"""Coverage of the bounds for a new person, built from a few people and tested on others.

    python studies/coverage.py                    # simulated people; exit code 1 if a bound fails
    bench run data=haart,cuddlebot protocol=loso features=touch,jung28 model=lda,svm,rf,tree
    python studies/coverage.py haart cuddlebot    # draws of the people of stored runs

A row has 2,000 draws for each system or kind of people. Its columns: percent of draws in which the
mean of the next people reaches ``mean_low``, which promises 95; percent of people who reach
``person_low``, which promises 90; median distance in points from the mean of the known people to
``mean_low``; percent of honest people whom the test rejects, which may be 5; percent found out if
they lose ten points. Of real people, the next ones are all others. The number in brackets is the
least of the row.
"""

import itertools
import sys
from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd
from scipy.special import stdtrit

import bench
from touchbench_builder.bounds import (
    GESTURE_SPREAD,
    compare_with_certificate,
    count_next_people,
    lower_bound,
)

Rule = Callable[[np.ndarray, np.ndarray, float, int], np.ndarray]
Case = tuple[str, float, float, int, int]

DRAWS, TESTED_DRAWS = 2000, 300
KNOWN_PEOPLE, CAPTURES = (5, 8, 12, 20, 30), (10, 30, 60)
MEANS = (0.4, 0.6, 0.75, 0.85, 0.9, 0.95)
SPREADS = (0.04, 0.08, 0.12)  # radians; 0.12 is 12 points at 50 %, 7 at 90 %
SHAPES = ("beta", "bimodal", "logit", "skewed", "outlier")
LOSS = 0.1
TOLERANCE = 1.0  # points; known for few people, it is the error of 2,000 draws, and a bit more


def simulate_people(
    shape: str, mean: float, spread: float, size: tuple[int, int], rng: np.random.Generator
) -> np.ndarray:
    """Accuracies of people, with an SD that is about ``spread`` on the scale of angles.

    Shapes: beta; bimodal, two kinds of people; logit, normal on that scale; skewed, a long tail of
    worse people; outlier, beta, but one in ten loses 30 percent.
    """
    sd = 2 * spread * np.sqrt(mean * (1 - mean))
    if shape == "bimodal":
        return np.clip(mean + sd * rng.choice([-1, 1], size), 0, 1)
    if shape == "logit":
        log_odds = np.log(mean / (1 - mean)) + rng.normal(0, sd / (mean * (1 - mean)), size)
        return 1 / (1 + np.exp(-log_odds))
    if shape == "skewed":
        angles = np.arcsin(np.sqrt(mean)) + spread * (2 - rng.gamma(2, 1, size)) / np.sqrt(2)
        return np.sin(np.clip(angles, 0, np.pi / 2)) ** 2
    alpha, beta = np.array([mean, 1 - mean]) * (mean * (1 - mean) / sd**2 - 1)
    people = rng.beta(alpha, beta, size)
    return people * np.where(rng.random(size) < 0.1 * (shape == "outlier"), 0.7, 1)


def is_pathological(shape: str, mean: float) -> bool:
    """Return True for people whom no few others announce: rare, and far below a high mean."""
    return mean >= {"outlier": 0.9, "logit": 0.95, "skewed": 0.95}.get(shape, 1)


def simulate_counts(case: Case, draws: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Correct captures and all captures of known people, and correct captures of the next ones."""
    *people, known, captures = case
    rng = np.random.default_rng([known, captures, round(1000 * case[1])])
    size = draws, known + count_next_people(known)
    right = rng.binomial(captures, simulate_people(*people, size, rng))
    return right[:, :known], np.full((draws, known), captures), right[:, known:]


def coverage(
    rule: Rule, right: np.ndarray, total: np.ndarray, later: np.ndarray
) -> tuple[float, float, float]:
    """The first three columns.

    Args:
        rule: such as `lower_bound`.
        right: correct captures [draws, known people].
        total: captures [draws, known people].
        later: accuracies [draws, next people].
    """
    low = rule(right, total, 0.95, count_next_people(right.shape[-1]))
    person_low = rule(right, total, 0.9, 1)
    held = np.mean(low <= later.mean(axis=-1) + 1e-9)
    people_held = np.mean(person_low[..., None] <= later + 1e-9)
    distance = np.median((right / total).mean(axis=-1) - low)
    return 100 * float(held), 100 * float(people_held), 100 * float(distance)


def student(right: np.ndarray, total: np.ndarray, level: float, people: int) -> np.ndarray:
    """Bound of Student's t, from the known people alone: a rule that is too sharp."""
    shares, known = right / total, right.shape[-1]
    error = shares.std(axis=-1, ddof=1) * np.sqrt(1 / known + 1 / people)
    return shares.mean(axis=-1) - stdtrit(known - 1, level) * error


def rejections(
    right: np.ndarray, total: np.ndarray, later: np.ndarray, later_total: np.ndarray
) -> tuple[float, float]:
    """The last two columns; arguments as of `compare_with_certificate`, with draws before."""
    rng = np.random.default_rng(5)
    shares = np.maximum(later / later_total, 1e-9)
    worse = rng.binomial(later, np.maximum(1 - LOSS / shares, 0))
    rejected = []
    for counts in (later, worse):
        draws = zip(right, total, counts, later_total, strict=True)
        rejected.append(np.mean([not compare_with_certificate(*draw).agrees for draw in draws]))
    return 100 * float(rejected[0]), 100 * float(rejected[1])


def failing_cases(rule: Rule, cases: Iterator[Case], draws: int = DRAWS) -> pd.DataFrame:
    """Kinds of simulated people for whom a rule holds less than it promises.

    A kind is shape, mean and spread; its coverage is the mean over numbers of people and captures.
    """
    rows = []
    for case in cases:
        right, total, later = simulate_counts(case, draws)
        rows.append((*case[:3], *coverage(rule, right, total, later / case[4])))
    table = pd.DataFrame(rows, columns=["shape", "mean", "spread", "mean_low", "person_low", "far"])
    kinds = table.groupby(["shape", "mean", "spread"]).mean()
    usual = np.array([not is_pathological(shape, mean) for shape, mean, _ in kinds.index])
    below = (kinds["mean_low"] < 95 - TOLERANCE) | (kinds["person_low"] < 90 - TOLERANCE)
    return kinds[usual & below]


def all_cases() -> Iterator[Case]:
    """Yield shape, mean, spread, known people and captures of each."""
    yield from itertools.product(SHAPES, MEANS, SPREADS, KNOWN_PEOPLE, CAPTURES)


def print_row(title: str, rows: list[tuple[float, ...]]) -> None:
    """Print the mean over rows, and the least of the first two columns."""
    table = np.array(rows)
    least = [f" ({low:.1f})" for low in table.min(axis=0)[:2]] + [""] * 3
    cells = [f"{mean:5.1f}{low}" for mean, low in zip(table.mean(axis=0), least, strict=False)]
    print(f"{title:34} | {' | '.join(cells)}", flush=True)


def print_simulated() -> int:
    """Print rows of simulated people; returns 1 if the rule holds less than it promises."""
    for shape, known in itertools.product(SHAPES, KNOWN_PEOPLE):
        for is_odd in (False, True):
            rows = []
            for mean, spread, captures in itertools.product(MEANS, SPREADS, CAPTURES):
                if is_pathological(shape, mean) == is_odd:
                    case = shape, mean, spread, known, captures
                    right, total, later = simulate_counts(case, DRAWS)
                    row = coverage(lower_bound, right, total, later / captures)
                    few_draws = [counts[:TESTED_DRAWS] for counts in (right, total, later)]
                    few_draws.append(np.full_like(few_draws[2], captures))
                    rows.append((*row, *rejections(*few_draws)))
            if rows:
                print_row(f"{shape}{', rare' * is_odd} {known}", rows)
    failing = failing_cases(lower_bound, all_cases())
    print("below the promise:", "nobody" if failing.empty else f"\n{failing.round(1)}")
    return int(not failing.empty)


def print_real(data: str) -> None:
    """Print rows of people of stored runs, of all gestures together, of each, and of a choice."""
    rng = np.random.default_rng(0)
    labels = bench.predictions(data=data, protocol="loso")
    labels["right"] = labels["prediction"].astype(str) == labels["truth"].astype(str)
    columns = ["truth", "run_id", "subject"]
    by_gesture = labels.groupby(columns, observed=True)["right"].agg(["sum", "size"])
    counts = by_gesture.unstack("subject").to_numpy()  # [gestures and runs, sum and size of people]
    gestures, people = labels["truth"].nunique(), labels["subject"].nunique()
    right, total = counts.reshape(gestures, -1, 2, people).transpose(2, 0, 1, 3)
    for known in (5, 6, 8):
        order = rng.permuted(np.tile(np.arange(people), (DRAWS, 1)), axis=1)
        ours, others = order[:, :known], order[:, known:]
        rows, gesture_rows = [], []
        for run in range(right.shape[1]):
            r, n = right[:, run].sum(axis=0), total[:, run].sum(axis=0)
            row = coverage(lower_bound, r[ours], n[ours], (r / n)[others])
            tested = [part[:TESTED_DRAWS] for part in (r[ours], n[ours], r[others], n[others])]
            rows.append((*row, *rejections(*tested)))
            for gesture in range(gestures):
                r, n = right[gesture, run], total[gesture, run]
                gesture_rows.append(coverage(gesture_bound, r[ours], n[ours], (r / n)[others]))
        print_row(f"{data} {known}", rows)
        print_row(f"{data} {known}, one gesture", gesture_rows)
        # The system is chosen: for each known person by the others, for the next people by all.
        r, n = right.sum(axis=0), total.sum(axis=0)
        seen = (r / n)[:, ours]
        chosen = (seen.sum(axis=-1, keepdims=True) - seen).argmax(axis=0)
        tested = (r / n)[seen.sum(axis=-1).argmax(axis=0)[:, None], others]
        print_row(
            f"{data} {known}, system chosen",
            [coverage(lower_bound, r[chosen, ours], n[chosen, ours], tested)],
        )


def gesture_bound(right: np.ndarray, total: np.ndarray, level: float, people: int) -> np.ndarray:
    """`lower_bound` of the accuracy of one gesture."""
    return lower_bound(right, total, level, people, GESTURE_SPREAD)


if __name__ == "__main__":
    if not sys.argv[1:]:
        sys.exit(print_simulated())
    for corpus in sys.argv[1:]:
        print_real(corpus)
