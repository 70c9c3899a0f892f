"""Systems that a build compares: those that have C, the cheapest first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.features.touch_profiles import TouchProfiles
from bench.models.search import portfolio
from touchbench_chip.tables import check_exportable

REPAIR = "stuck+dead+offset"
# What training against them costs without faults is small; the repair subtracts an offset.
TRAINED_FAULTS = ("offset_drift", "lower_rate", "doubled_frames", "own_noise")
COPIES = 1  # damaged, of each capture; more cost time and first labels: docs/faults.md
BITS = 8  # of a weight in C; Python rounds to the same if it can
ROUNDED_MODELS = ("lda", "softmax", "reflex")  # those with model.bits=
SMALLEST_SYSTEM: dict[str, object] = {"model": "tree", "features": "jung28"}
LARGEST_SYSTEM: dict[str, object] = {"model": "reflex", "model.bits": BITS}
LARGEST_S = 60.0  # of a fit on one core
# It loses least under faults for its cost: docs/faults.md.
STEADY_TRIAL = {"model": "lda", "features": "touch_profiles", "window": 1.0}
STEADY_TRIAL |= {"faults": "+".join(TRAINED_FAULTS)}
TUNED_TRIAL = {"model": "lda", "window": 1.0, "lda.tune": True}
TUNED_FITS = 4  # time of its fit, in fits with fixed settings
FEWEST_TO_TUNE = 4  # people; two are left out at once, in thirds for faults in streams


def candidate_systems(
    corpus: Corpus, faults: tuple[str, ...] | None = None
) -> list[tuple[dict[str, Any], float]]:
    """Systems that have C, as keys of ``bench run``, with the seconds of a fit on one core.

    They are the first trials of ``model=auto`` on windows of ``touch``, one for each model and
    window, one that loses little under faults and, if people are enough, one that chooses its
    settings itself, after the repair of taxels; the smallest system; and the most accurate model
    with C. The cheapest is first.

    Args:
        corpus: captures.
        faults: that all are trained against; None: those that a system is usually trained against.
    """
    feature_sets = {"touch": TouchFeatures(), "touch_profiles": TouchProfiles()}
    widths = {name: len(each.fit(corpus[:1]).names_) for name, each in feature_sets.items()}
    classes = len(set(corpus.gestures))
    systems = [(SMALLEST_SYSTEM, portfolio.MIN_FIT_S), (LARGEST_SYSTEM, LARGEST_S)]
    if faults:
        systems = [(values | train_against(faults), seconds) for values, seconds in systems]
    trials = [*_exportable_trials(), portfolio.with_defaults(STEADY_TRIAL)]
    shows_gesture = pd.crosstab(corpus.subjects, corpus.gestures).to_numpy() > 0
    if len(shows_gesture) >= FEWEST_TO_TUNE and shows_gesture.all():
        trials.append(portfolio.with_defaults(TUNED_TRIAL))
    for trial in trials:
        values = {name: trial[name] for name in ("model", "features")}
        values |= {"model.window": trial["window"], "model.repair": REPAIR}
        if faults is not None:
            trial["faults"] = "+".join(faults)
        values |= train_against(trial["faults"].split("+") if trial["faults"] else ())
        values |= {f"model.{key.partition('.')[2]}": trial[key] for key in trial if "." in key}
        if trial["model"] in ROUNDED_MODELS:
            values["model.bits"] = BITS
        seconds = portfolio.expected_fit_seconds(trial, corpus, widths[trial["features"]], classes)
        systems.append((values, seconds * (TUNED_FITS if "lda.tune" in trial else 1)))
    return sorted(systems, key=lambda pair: pair[1])


def _exportable_trials() -> Iterator[dict[str, Any]]:
    """Yield the first trial of each model and window on ``touch`` that can be written as C."""
    trials = [portfolio.with_defaults(trial) for trial in portfolio.FIRST_TRIALS]
    trials.sort(key=lambda trial: not trial["window"])
    yielded = set()
    for trial in trials:
        trial |= {"window": trial["window"] or 1.0}
        key = trial["model"], trial["window"]
        if trial["features"] == "touch" and key not in yielded:
            with suppress(InputError):  # it has no C
                check_exportable(portfolio.make_system(trial, 0))
                yielded.add(key)
                yield trial


def system_title(values: Mapping[str, Any]) -> str:
    """Name a system in words."""
    features = f" on {values['features']}" if "features" in values else ""
    window = f", windows of {values['model.window']:g} s" if "model.window" in values else ""
    tuned = ", tuned" if "model.tune" in values else ""
    faults = f", trained against {values['model.faults']}" if "model.faults" in values else ""
    return f"{values['model']}{features}{window}{tuned}{faults}"


def train_against(faults: Sequence[str]) -> dict[str, object]:
    """Keys of ``bench run`` that train a system against faults."""
    return {"model.faults": "+".join(faults), "model.copies": COPIES} if faults else {}
