"""The engine of `bench tune` and `auto`: trials drawn by Optuna, judged, and kept in the data folder, to resume."""

from __future__ import annotations

import base64
import json
import os
import time
import warnings
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from filelock import FileLock

from bench.corpora.corpus import Corpus
from bench.models.search.identity import study_name
from bench.models.search.space import Range, Space, Trial, distribution, suggested
from bench.scratch import home

WORSE = 0.1  # p-value of a signed-rank test over subjects below which a trial is not followed further


@dataclass
class Tried:
    """A finished trial.

    Attributes:
        trial: trial.
        state: ``complete``; ``pruned``, as it was worse; of `Auto` also ``large``, as it exceeds a limit; ``late``, as
            it took too long; ``skipped``, as it would have; ``failed``; ``unjudged`` where there was no time for any.
        seconds: seconds of the trial.
        subjects: accuracy of each left-out training subject, in the order in which they were left out.
        fit_seconds: expected seconds of a fit to the whole training part.
        costs: milliseconds of a decision, bytes in flash and memory with 32 bits a number, by name.
        proba: probabilities of left-out captures, float16 [captures, classes]; None if they are not kept.
        heat: temperature of the probabilities.
        error: error of a failed trial.
    """

    trial: Trial
    state: str
    seconds: float = 0.0
    subjects: dict[str, float] = field(default_factory=dict)
    fit_seconds: float = 0.0
    costs: dict[str, float] = field(default_factory=dict)
    proba: np.ndarray | None = None
    heat: float = 1.0
    error: str = ""

    @property
    def accuracy(self) -> float:
        """Mean over subjects; not a number where none was judged."""
        return float(np.mean([*self.subjects.values()])) if self.subjects else float("nan")


def within(costs: dict[str, float], limits: dict[str, float]) -> bool:
    """Return True if no measured cost exceeds its limit."""
    return all(costs[name] <= limit for name, limit in limits.items() if name in costs)


@dataclass
class Study:
    """The trials of a search in their order, within its budget.

    What is drawn depends on the seed and the finished trials alone, so that a search that was interrupted goes on as if
    it had not been; a trial that was cut off is judged once more.

    Args:
        common: values of the parameters that every trial has, ``model`` first, in the order in which they are drawn.
        spaces: parameters by model, for its trials only.
        seed: random seed of the draws.
        most: number of trials, infinity for as many as there is time for.
        budget: seconds, infinity for no limit.
        began: time of the search's beginning, of `time.perf_counter`.
        limits: limits of costs; a trial that exceeds one is worse than any that does not.

    Attributes:
        tried: the finished trials.
    """

    common: Space
    spaces: dict[str, Space]
    seed: int
    most: float
    budget: float
    began: float
    limits: dict[str, float]
    tried: list[Tried] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            pruner = optuna.pruners.WilcoxonPruner(p_threshold=WORSE)
            self._optuna = optuna.create_study(direction="maximize", pruner=pruner)

    @property
    def left(self) -> float:
        """Seconds until the budget is spent; below 0 after that."""
        return self.budget - (time.perf_counter() - self.began)

    def search(self, step: Callable[[], Tried | None], key: dict[str, object], X: Corpus, y: np.ndarray) -> None:
        """Try one after the other, until there are as many as wanted or none comes any more.

        Of a stored corpus trials are kept. Those of an earlier search come first, but no more of them than this one
        would have made; their seconds count as spent. The file is locked against other processes.

        Args:
            step: function that judges the next trial; None ends the search.
            key: influences on trials besides captures and labels.
            X: the training captures.
            y: their class names.
        """
        with _locked(study_name(key, X, y) if X.digest else None) as path:
            for line in _lines(path) if path else []:
                if len(self.tried) < self.most and sum(t.seconds for t in self.tried) < self.budget:
                    tried = self._unpacked(json.loads(line))
                    self._add(tried)
                    self.began -= tried.seconds
            while len(self.tried) < self.most:
                began = time.perf_counter()
                tried = step()
                if tried is None:
                    return
                tried.seconds = time.perf_counter() - began
                self._add(tried)
                if path:
                    with path.open("a") as file:
                        file.write(json.dumps(self._packed(tried)) + "\n")
                        file.flush()
                        os.fsync(file.fileno())

    def drawn(self, fixed: Trial, *numbers: int, each: bool = False) -> Trial:
        """The sampler's suggestion after the trials so far.

        Args:
            fixed: values that are not left to it.
            numbers: further numbers of the seed.
            each: True to give each value a seed of its own, by its position.
        """
        import optuna

        trial: Trial = {}
        draft = self._optuna.ask()
        names = list(self.common)
        while names:
            if each or not trial:
                entropy = [self.seed, len(self.tried), *([len(trial)] if each else numbers)]
                seed = np.random.SeedSequence(entropy).generate_state(1)[0]
                self._optuna.sampler = optuna.samplers.TPESampler(seed=int(seed))
            name = names.pop(0)
            trial[name] = fixed[name] if name in fixed else suggested(draft, name, self._values(trial, name))
            if name == "model":
                names += self.spaces[str(trial["model"])]
        self._optuna.tell(draft, state=optuna.trial.TrialState.FAIL)  # it is added when it was judged
        return trial

    def worse(self, tried: Tried) -> bool:
        """Return True if a signed-rank test over the subjects so far finds a trial worse than the best one."""
        import optuna

        seen = dict(enumerate(tried.subjects.values()))
        trial = optuna.trial.create_trial(state=optuna.trial.TrialState.RUNNING, intermediate_values=seen)
        return self._optuna.pruner.prune(self._optuna, trial)

    def _values(self, trial: Trial, name: str) -> Range | Sequence:
        return self.common[name] if name in self.common else self.spaces[str(trial["model"])][name]

    def _add(self, tried: Tried) -> None:
        """To the finished ones; Optuna learns nothing from one that was neither complete nor pruned."""
        import optuna

        complete = tried.state == "complete"
        state = tried.state.upper() if complete or tried.state == "pruned" else "FAIL"
        self.tried.append(tried)
        self._optuna.add_trial(
            optuna.trial.create_trial(
                state=optuna.trial.TrialState[state],
                value=tried.accuracy - (not within(tried.costs, self.limits)) if complete else None,
                params=tried.trial,
                distributions={name: distribution(self._values(tried.trial, name)) for name in tried.trial},
                intermediate_values=dict(enumerate(tried.subjects.values())),
            )
        )

    def _packed(self, tried: Tried) -> dict[str, object]:
        """A trial as a line of the file holds it: a value of a list by its position, probabilities in base 64."""
        values = {
            name: distribution(self._values(tried.trial, name)).to_internal_repr(value)
            for name, value in tried.trial.items()
        }
        proba = tried.proba
        if proba is not None:
            text = base64.b64encode(zlib.compress(proba.tobytes())).decode()
            proba = [text, proba.dtype.str, proba.shape]
        return vars(tried) | {"trial": values, "proba": proba}

    def _unpacked(self, packed: dict) -> Tried:
        trial: Trial = {}
        for name, value in packed["trial"].items():
            trial[name] = distribution(self._values(trial, name)).to_external_repr(value)
        proba = packed["proba"]
        if proba is not None:
            text, dtype, shape = proba
            proba = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=dtype).reshape(shape)
        return Tried(**packed | {"trial": trial, "proba": proba})


@contextmanager
def _locked(name: str | None) -> Iterator[Path | None]:
    """The file of a study, held against other processes; None where nothing is kept."""
    if name is None:
        yield None
        return
    path = home() / "studies" / f"{name}.jsonl"
    lock = FileLock(path.with_suffix(".lock"))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except OSError:  # a folder that cannot be written only costs the resuming
        name = None
    try:
        yield path if name else None
    finally:
        lock.release()


def _lines(path: Path) -> list[bytes]:
    """The lines of a file; one that was cut off when a process was killed is removed."""
    content = path.read_bytes() if path.exists() else b""
    end = content.rfind(b"\n") + 1
    if end < len(content):
        os.truncate(path, end)
    return content[:end].splitlines()
