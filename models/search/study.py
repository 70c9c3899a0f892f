"""The engine of `bench tune` and `auto`: inner folds, and trials drawn by Optuna, judged, and stored to be resumed."""

from __future__ import annotations

import hashlib
import json
import pickle
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from filelock import FileLock

from bench.corpora.corpus import Corpus
from bench.ground.scratch import home, replacing
from bench.ground.source import source_digest, versions
from bench.models.space import Range, Space, Trial, distribution, suggested

WORSE = (
    0.1  # p-value of a signed-rank test over subjects below which a trial is not followed further
)


@dataclass
class Tried:
    """A finished trial, the accuracy of each left-out training subject in the order in which they were left out."""

    trial: Trial
    state: str  # complete; pruned, as it was worse; of Auto also large, as it exceeds a limit, or failed
    seconds: float = 0.0
    subjects: dict[str, float] = field(default_factory=dict)
    fit_seconds: float = 0.0  # expected, of a fit to the whole training part
    costs: dict[str, float] = field(default_factory=dict)
    proba: np.ndarray | None = None  # of left-out captures, float16 [captures, classes]
    heat: float = 1.0  # temperature of these
    error: str = ""

    @property
    def accuracy(self) -> float:
        """Mean over subjects; not a number where none was judged."""
        return float(np.mean([*self.subjects.values()])) if self.subjects else float("nan")

    def judge(self, hit: np.ndarray, subjects: np.ndarray) -> None:
        """Add subjects, from which of their captures were right."""
        self.subjects |= {str(s): float(hit[subjects == s].mean()) for s in np.unique(subjects)}

    def row(self) -> dict[str, object]:
        """Its row in a table of trials."""
        facts = {"state": self.state, "accuracy": self.accuracy, "subjects": len(self.subjects)}
        return self.trial | facts | {"seconds": self.seconds}


def within(costs: dict[str, float], limits: dict[str, float]) -> bool:
    """Return True if no measured cost exceeds its limit."""
    return all(costs[name] <= limit for name, limit in limits.items() if name in costs)


@dataclass
class Study:
    """The trials of a search in their order, within its budget.

    What is drawn depends on the seed and the finished trials alone, so that a search that was interrupted goes on as if
    it had not been; a trial that was cut off is judged once more.

    A trial that exceeds a limit of costs is worse than any that does not.
    """

    common: Space  # parameters that every trial has, ``model`` first, in the order in which they are drawn
    spaces: dict[str, Space]  # parameters by model, for its trials only
    seed: int
    most: float  # number of trials, infinity for as many as there is time for
    budget: float  # seconds, infinity for no limit
    began: float  # of `time.perf_counter`
    limits: dict[str, float] = field(default_factory=dict)
    tried: list[Tried] = field(default_factory=list, init=False)  # the finished ones

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

    def search(
        self, step: Callable[[], Tried | None], key: dict[str, object], X: Corpus, y: np.ndarray
    ) -> None:
        """Judge one after the other by ``step``, until there are as many as wanted or it gives None.

        Trials on a stored corpus are stored under it and ``key``. Those of an earlier search come first, but no more of
        them than this one would have made; their seconds count as spent. The folder is locked against other processes.
        """
        with _held(home() / "studies" / study_name(key, X, y) if X.digest else None) as folder:
            for file in sorted(folder.glob("[0-9]*.pickle")) if folder else []:
                if len(self.tried) < self.most and sum(t.seconds for t in self.tried) < self.budget:
                    self._add(pickle.loads(file.read_bytes()))
                    self.began -= self.tried[-1].seconds
            while len(self.tried) < self.most:
                began = time.perf_counter()
                if (tried := step()) is None:
                    return
                tried.seconds = time.perf_counter() - began
                self._add(tried)
                if folder:
                    with replacing(folder / f"{len(self.tried):06}.pickle") as beside:
                        beside.write_bytes(pickle.dumps(tried))

    def drawn(self, fixed: Trial, *numbers: int, each: bool = False) -> Trial:
        """The sampler's suggestion after the trials so far, but for ``fixed`` values.

        With ``each``, every value has a seed of its own, by its position; ``numbers`` are further ones of a seed.
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
            trial[name] = (
                fixed[name] if name in fixed else suggested(draft, name, self._values(trial, name))
            )
            if name == "model":
                names += self.spaces[str(trial["model"])]
        self._optuna.tell(
            draft, state=optuna.trial.TrialState.FAIL
        )  # it is added when it was judged
        return trial

    def worse(self, tried: Tried) -> bool:
        """Return True if a signed-rank test over the subjects so far finds a trial worse than the best one."""
        import optuna

        seen = dict(enumerate(tried.subjects.values()))
        trial = optuna.trial.create_trial(
            state=optuna.trial.TrialState.RUNNING, intermediate_values=seen
        )
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
                distributions={
                    name: distribution(self._values(tried.trial, name)) for name in tried.trial
                },
                intermediate_values=dict(enumerate(tried.subjects.values())),
            )
        )


@contextmanager
def _held(folder: Path | None) -> Iterator[Path | None]:
    """The folder of a study, held against other processes; None where nothing can be stored, which costs resuming."""
    with ExitStack() as held:
        try:
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
                held.enter_context(FileLock(folder.with_suffix(".lock")))
        except OSError:
            folder = None
        yield folder


def study_name(what: dict[str, object], X: Corpus, y: np.ndarray) -> str:
    """Hash of the captures with their steps, the labels, the search space and library versions."""
    code = source_digest(*(part for step in X.steps for part in step.code())) if X.steps else ""
    labels = "\n".join(map(str, y)).encode()
    captures = [
        X.digest,
        *(
            hashlib.sha256(part).hexdigest()
            for part in (X.index.tobytes(), X.piece.tobytes(), labels)
        ),
    ]
    about = [captures, repr(X.steps), code, what, versions()]
    return hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode()).hexdigest()[:32]


def identity(part: Callable) -> list:
    """Name and source of a factory or class; of a partial one also its arguments."""
    if isinstance(part, partial):
        return [*identity(part.func), repr((part.args, sorted(part.keywords.items())))]
    return [part.__module__, part.__qualname__, source_digest(part)]
