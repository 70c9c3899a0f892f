"""The engine of `bench tune` and `auto`: trials that Optuna draws, stored for resuming."""

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
from bench.ground.digests import DamagedFile, append_digest, split_digest
from bench.ground.progress import warn
from bench.ground.scratch import data_folder, write_then_rename
from bench.ground.source import package_versions, source_digest
from bench.models.space import Range, Space, Trial, make_distribution, suggest_value

WORSE_P = 0.1  # p-value of a signed-rank test over subjects below which a trial is pruned


@dataclass(eq=False)
class FinishedTrial:
    """A finished trial; its subjects are in the order in which they were left out."""

    trial: Trial
    state: str  # complete, pruned; of Auto also failed, or large if it exceeds a limit
    seconds: float = 0.0
    subjects: dict[str, float] = field(default_factory=dict)  # accuracy of each
    fit_seconds: float = 0.0  # expected, of a fit to the whole training part
    costs: dict[str, float] = field(default_factory=dict)
    proba: np.ndarray | None = None  # of left-out captures, float16 [captures, classes]
    temperature: float = 1.0  # of these probabilities
    error: str = ""

    @property
    def accuracy(self) -> float:
        """Mean over subjects; NaN without subjects."""
        return float(np.mean([*self.subjects.values()])) if self.subjects else float("nan")

    def add_subjects(self, is_correct: np.ndarray, subjects: np.ndarray) -> None:
        """Add the accuracy of left-out subjects, from the predictions of their captures."""
        for subject in np.unique(subjects):
            self.subjects[str(subject)] = float(is_correct[subjects == subject].mean())

    def as_row(self) -> dict[str, object]:
        """Row of a table of trials."""
        facts = {"state": self.state, "accuracy": self.accuracy, "subjects": len(self.subjects)}
        return self.trial | facts | {"seconds": self.seconds}


def meets_limits(costs: dict[str, float], limits: dict[str, float]) -> bool:
    """True if no measured cost exceeds its limit."""
    return all(costs[name] <= limit for name, limit in limits.items() if name in costs)


@dataclass
class Study:
    """The trials of a search in their order, within its budget.

    Draws depend on the seed and the finished trials alone, so an interrupted search continues as if
    it had not been interrupted; an incomplete trial is judged again. A trial that exceeds a limit
    is worse than any that does not.
    """

    common: Space  # parameters of every trial in the order of their draws, ``model`` first
    spaces: dict[str, Space]  # further parameters by model
    seed: int
    max_trials: float  # infinity for no limit
    max_seconds: float  # infinity for no limit
    started: float  # of `time.perf_counter`
    limits: dict[str, float] = field(default_factory=dict)  # by cost
    finished: list[FinishedTrial] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            pruner = optuna.pruners.WilcoxonPruner(p_threshold=WORSE_P)
            self._optuna = optuna.create_study(direction="maximize", pruner=pruner)

    @property
    def seconds_left(self) -> float:
        """Seconds of the budget that are left; below 0 after that."""
        return self.max_seconds - (time.perf_counter() - self.started)

    def judge_trials(
        self,
        step: Callable[[], FinishedTrial | None],
        key: dict[str, object],
        X: Corpus,
        y: np.ndarray,
    ) -> None:
        """Judge trials until there are as many as wanted, or none is left.

        Trials on a stored corpus are stored under it and ``key``. Those of an earlier search come
        first, but no more of them than this one would have made; their seconds count as spent. The
        folder is locked against other processes.

        Args:
            step: judges the next trial, or returns None.
            key: influences on trials besides captures and labels.
            X: captures.
            y: their class names.
        """
        studies = data_folder() / "studies"
        with _locked_folder(studies / study_name(key, X, y) if X.digest else None) as folder:
            for file in sorted(folder.glob("[0-9]*.pickle")) if folder else []:
                spent = sum(trial.seconds for trial in self.finished)
                if len(self.finished) >= self.max_trials or spent >= self.max_seconds:
                    break
                try:
                    content = split_digest(file.read_bytes())
                except DamagedFile:
                    warn(f"warning: {file} is damaged; its trial and later ones are repeated")
                    break
                self._add_finished(pickle.loads(content))
                self.started -= self.finished[-1].seconds
            while len(self.finished) < self.max_trials:
                started = time.perf_counter()
                if (trial := step()) is None:
                    return
                trial.seconds = time.perf_counter() - started
                self._add_finished(trial)
                if folder:
                    folder = _store_trial(trial, folder / f"{len(self.finished):06}.pickle")

    def draw_trial(self, fixed: Trial, *numbers: int, each: bool = False) -> Trial:
        """The sampler's suggestion after the finished trials.

        Args:
            fixed: values that are not drawn.
            numbers: further numbers of the seed.
            each: True to give each value its own seed, by its position.
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
            if name in fixed:
                trial[name] = fixed[name]
            else:
                trial[name] = suggest_value(draft, name, self._values_of(trial, name))
            if name == "model":
                names += self.spaces[str(trial["model"])]
        # a finished trial is added later, with its accuracy
        self._optuna.tell(draft, state=optuna.trial.TrialState.FAIL)
        return trial

    def is_worse(self, trial: FinishedTrial) -> bool:
        """True if a signed-rank test over subjects so far finds a trial worse than the best."""
        import optuna

        accuracies = dict(enumerate(trial.subjects.values()))
        running = optuna.trial.TrialState.RUNNING
        draft = optuna.trial.create_trial(state=running, intermediate_values=accuracies)
        return self._optuna.pruner.prune(self._optuna, draft)

    def _values_of(self, trial: Trial, name: str) -> Range | Sequence:
        return self.common[name] if name in self.common else self.spaces[str(trial["model"])][name]

    def _add_finished(self, trial: FinishedTrial) -> None:
        """Add a trial; Optuna learns from complete and pruned ones alone."""
        import optuna

        self.finished.append(trial)
        value, state = None, "PRUNED" if trial.state == "pruned" else "FAIL"
        if trial.state == "complete":
            penalty = not meets_limits(trial.costs, self.limits)
            value, state = trial.accuracy - penalty, "COMPLETE"
        values = {name: self._values_of(trial.trial, name) for name in trial.trial}
        record = optuna.trial.create_trial(
            state=optuna.trial.TrialState[state],
            value=value,
            params=trial.trial,
            distributions={name: make_distribution(space) for name, space in values.items()},
            intermediate_values=dict(enumerate(trial.subjects.values())),
        )
        self._optuna.add_trial(record)


def _store_trial(trial: FinishedTrial, path: Path) -> Path | None:
    """Store a trial; return its folder, or None if no later one can follow it there."""
    try:
        with write_then_rename(path) as beside:
            beside.write_bytes(append_digest(pickle.dumps(trial)))
    except OSError:  # a full disk only costs time
        return None
    return path.parent


@contextmanager
def _locked_folder(folder: Path | None) -> Iterator[Path | None]:
    """Make and lock a folder; yield None if nothing can be stored."""
    with ExitStack() as stack:
        try:
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
                stack.enter_context(FileLock(folder.with_suffix(".lock")))
        except OSError:
            folder = None
        yield folder


def study_name(key: dict[str, object], X: Corpus, y: np.ndarray) -> str:
    """Hash of the captures with their steps, the labels, a key and library versions."""
    code = [part for step in X.steps for part in step.code_objects()]
    labels = "\n".join(map(str, y)).encode()
    parts = X.index.tobytes(), X.piece.tobytes(), labels
    captures = [X.digest, *(hashlib.sha256(part).hexdigest() for part in parts)]
    digest = source_digest(*code) if code else ""
    influences = [captures, repr(X.steps), digest, key, package_versions()]
    text = json.dumps(influences, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def source_identity(part: Callable) -> list:
    """Name and source of a factory or class, and the arguments of a partial one."""
    if isinstance(part, partial):
        return [*source_identity(part.func), repr((part.args, sorted(part.keywords.items())))]
    return [part.__module__, part.__qualname__, source_digest(part)]
