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
from bench.ground.scratch import data_folder, write_then_rename
from bench.ground.source import package_versions, source_digest
from bench.models.space import Range, Space, Trial, make_distribution, suggest_value

WORSE_P = (
    0.1  # p-value of a signed-rank test over subjects below which a trial is not followed further
)


@dataclass
class FinishedTrial:
    """A finished trial, the accuracy of each left-out training subject in the order in which they were left out."""

    trial: Trial
    state: str  # complete; pruned, as it was worse; of Auto also large, as it exceeds a limit, or failed
    seconds: float = 0.0
    subjects: dict[str, float] = field(default_factory=dict)
    fit_seconds: float = 0.0  # expected, of a fit to the whole training part
    costs: dict[str, float] = field(default_factory=dict)
    proba: np.ndarray | None = None  # of left-out captures, float16 [captures, classes]
    temperature: float = 1.0  # temperature of these
    error: str = ""

    @property
    def accuracy(self) -> float:
        """Mean over subjects; not a number where none was judged."""
        return float(np.mean([*self.subjects.values()])) if self.subjects else float("nan")

    def add_subjects(self, hit: np.ndarray, subjects: np.ndarray) -> None:
        """Add subjects, from which of their captures were right."""
        self.subjects |= {str(s): float(hit[subjects == s].mean()) for s in np.unique(subjects)}

    def as_row(self) -> dict[str, object]:
        """Its row in a table of trials."""
        facts = {"state": self.state, "accuracy": self.accuracy, "subjects": len(self.subjects)}
        return self.trial | facts | {"seconds": self.seconds}


def meets_limits(costs: dict[str, float], limits: dict[str, float]) -> bool:
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
    max_trials: float  # number of trials, infinity for as many as there is time for
    max_seconds: float  # seconds, infinity for no limit
    started: float  # of `time.perf_counter`
    limits: dict[str, float] = field(default_factory=dict)
    finished: list[FinishedTrial] = field(default_factory=list, init=False)  # the finished ones

    def __post_init__(self) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            pruner = optuna.pruners.WilcoxonPruner(p_threshold=WORSE_P)
            self._optuna = optuna.create_study(direction="maximize", pruner=pruner)

    @property
    def seconds_left(self) -> float:
        """Seconds until the budget is spent; below 0 after that."""
        return self.max_seconds - (time.perf_counter() - self.started)

    def judge_trials(
        self,
        step: Callable[[], FinishedTrial | None],
        key: dict[str, object],
        X: Corpus,
        y: np.ndarray,
    ) -> None:
        """Judge one after the other by ``step``, until there are as many as wanted or it gives None.

        Trials on a stored corpus are stored under it and ``key``. Those of an earlier search come first, but no more of
        them than this one would have made; their seconds count as spent. The folder is locked against other processes.
        """
        with _locked_folder(
            data_folder() / "studies" / study_name(key, X, y) if X.digest else None
        ) as folder:
            for file in sorted(folder.glob("[0-9]*.pickle")) if folder else []:
                if (
                    len(self.finished) < self.max_trials
                    and sum(t.seconds for t in self.finished) < self.max_seconds
                ):
                    self._add_finished(pickle.loads(file.read_bytes()))
                    self.started -= self.finished[-1].seconds
            while len(self.finished) < self.max_trials:
                began = time.perf_counter()
                if (tried := step()) is None:
                    return
                tried.seconds = time.perf_counter() - began
                self._add_finished(tried)
                if folder:
                    with write_then_rename(folder / f"{len(self.finished):06}.pickle") as beside:
                        beside.write_bytes(pickle.dumps(tried))

    def draw_trial(self, fixed: Trial, *numbers: int, each: bool = False) -> Trial:
        """The sampler's suggestion after the trials so far, but for ``fixed`` values.

        With ``each``, every value has a seed of its own, by its position; ``numbers`` are further ones of a seed.
        """
        import optuna

        trial: Trial = {}
        draft = self._optuna.ask()
        names = list(self.common)
        while names:
            if each or not trial:
                entropy = [self.seed, len(self.finished), *([len(trial)] if each else numbers)]
                seed = np.random.SeedSequence(entropy).generate_state(1)[0]
                self._optuna.sampler = optuna.samplers.TPESampler(seed=int(seed))
            name = names.pop(0)
            trial[name] = (
                fixed[name]
                if name in fixed
                else suggest_value(draft, name, self._values_of(trial, name))
            )
            if name == "model":
                names += self.spaces[str(trial["model"])]
        self._optuna.tell(
            draft, state=optuna.trial.TrialState.FAIL
        )  # it is added when it was judged
        return trial

    def is_worse(self, tried: FinishedTrial) -> bool:
        """Return True if a signed-rank test over the subjects so far finds a trial worse than the best one."""
        import optuna

        seen = dict(enumerate(tried.subjects.values()))
        trial = optuna.trial.create_trial(
            state=optuna.trial.TrialState.RUNNING, intermediate_values=seen
        )
        return self._optuna.pruner.prune(self._optuna, trial)

    def _values_of(self, trial: Trial, name: str) -> Range | Sequence:
        return self.common[name] if name in self.common else self.spaces[str(trial["model"])][name]

    def _add_finished(self, tried: FinishedTrial) -> None:
        """To the finished ones; Optuna learns nothing from one that was neither complete nor pruned."""
        import optuna

        complete = tried.state == "complete"
        state = tried.state.upper() if complete or tried.state == "pruned" else "FAIL"
        self.finished.append(tried)
        self._optuna.add_trial(
            optuna.trial.create_trial(
                state=optuna.trial.TrialState[state],
                value=tried.accuracy - (not meets_limits(tried.costs, self.limits))
                if complete
                else None,
                params=tried.trial,
                distributions={
                    name: make_distribution(self._values_of(tried.trial, name))
                    for name in tried.trial
                },
                intermediate_values=dict(enumerate(tried.subjects.values())),
            )
        )


@contextmanager
def _locked_folder(folder: Path | None) -> Iterator[Path | None]:
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
    code = (
        source_digest(*(part for step in X.steps for part in step.code_objects()))
        if X.steps
        else ""
    )
    labels = "\n".join(map(str, y)).encode()
    captures = [
        X.digest,
        *(
            hashlib.sha256(part).hexdigest()
            for part in (X.index.tobytes(), X.piece.tobytes(), labels)
        ),
    ]
    about = [captures, repr(X.steps), code, what, package_versions()]
    return hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode()).hexdigest()[:32]


def source_identity(part: Callable) -> list:
    """Name and source of a factory or class; of a partial one also its arguments."""
    if isinstance(part, partial):
        return [*source_identity(part.func), repr((part.args, sorted(part.keywords.items())))]
    return [part.__module__, part.__qualname__, source_digest(part)]
