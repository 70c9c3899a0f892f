"""Fitted systems as MLflow models: saved by `bench fit`, and loaded again.

A model is code: loading one runs it. Only the user's store and folders that the user names are loaded from.
"""

from __future__ import annotations

import importlib
import logging
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import mlflow
import numpy as np
import pandas as pd
from mlflow.exceptions import MlflowException
from mlflow.models import ModelSignature
from mlflow.protos.databricks_pb2 import INVALID_PARAMETER_VALUE
from mlflow.pyfunc import PythonModel
from mlflow.types import ColSpec, DataType, ParamSchema, ParamSpec, Schema
from mlflow.types.schema import AnyType

from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.read.table import corpus_from_table
from bench.errors import InputError
from bench.ground.registry import FILE_MODULE_PREFIX
from bench.ground.source import lies_in, package_folder
from bench.running.fold import predictions_table
from bench.running.unlike import is_unlike_training, usual_range
from bench.store.database import store_uri
from bench.values.scores import PREFIX, classes_of, most_probable_labels

if TYPE_CHECKING:
    from mlflow.types import TensorSpec

    from bench.contract import System
    from bench.running.replay import Stopping

CLOSE = 1e-3  # of a step, as single precision has readings
MOST_VALUES = 1 << 16  # of readings that are multiples of a step: what C can sum up in 32 bits
FORMAT = "4"  # version of saved models; others are refused

PACKAGES = (
    "features",
    "models",
    "protocols",
)  # of the code that goes with a model, and that of bench itself


class Recogniser(PythonModel):
    """A fitted system with the required format of its frames; the frames that it was fitted to are not kept.

    Args:
        estimator: fitted to a `Corpus`.
        corpus: the captures that it was fitted to.
        stopping: calibration and stopping rule; None if its captures could not teach them.
        watcher: a part that has learned beside the system, from `bench.running.fit.fit`; None for nothing.
    """

    format = ""  # of a model that another version has saved

    def __init__(
        self,
        estimator: System,
        corpus: Corpus,
        stopping: Stopping | None = None,
        watcher: Any = None,
    ) -> None:
        self.format, self.estimator, self.stopping, self.watcher = (
            FORMAT,
            estimator,
            stopping,
            watcher,
        )
        self.classes = np.unique(corpus.gestures.astype(str)).tolist()
        rows, cols = corpus.grid
        self.grid = int(rows), int(cols)
        self.rate_hz = float(corpus.rate_hz)
        self.full_scale = float(corpus.full_scale)  # largest value of a channel
        self.longest = int(corpus.lengths.max())  # frames of the longest training capture
        self.synthetic = corpus.synthetic
        self.step = reading_step(corpus)
        self.usual = usual_range(corpus)

    @property
    def channels(self) -> list[str]:
        """Columns of a frame, row by row: ch1, ch2, ..."""
        return [f"ch{i + 1}" for i in range(self.grid[0] * self.grid[1])]

    def check_rate(self, rate_hz: float) -> None:
        """Refuse frames of another rate."""
        if not np.isclose(rate_hz, self.rate_hz, rtol=1e-3):
            raise InputError(
                f"rate_hz={rate_hz:g}: this model was trained at {self.rate_hz:g} Hz; resample the frames, "
                "or train a model on captures of that rate"
            )

    def label_captures(self, corpus: Corpus) -> pd.DataFrame:
        """Classify captures, a row each: label, confidence (probability of the label), unlike, p_<class> of each class.

        A system that decides per window has the mean probability of its windows. Probabilities are calibrated, where
        the model has learned how sure it may be. Where it abstains, the label is empty and every probability 0.
        ``unlike`` is True for captures that look unlike all training captures.
        """
        proba = self._calibrated(self._mean(corpus), corpus.lengths)
        label = most_probable_labels(proba.to_numpy(), self.classes)
        whole = pd.DataFrame(
            {
                "label": label,
                "confidence": proba.max(axis=1),
                "unlike": is_unlike_training(corpus, self.usual),
            }
        )
        return pd.concat([whole, proba], axis=1)

    def decide_on(self, corpus: Corpus, before: str | None) -> tuple[str, float, float | None]:
        """Label, confidence, and settledness of the label, 0 to 1, of the frames of one capture so far.

        ``before`` is the label that stood when 1/1.41 as much had been seen, if any. Without a stopping rule that saves
        time, nothing is settled: None.
        """
        raw = self._mean(corpus)
        proba, settled = self._calibrated(raw, corpus.lengths).to_numpy(), None
        if self.stopping is not None and self.stopping.saves:
            earlier = (
                []
                if before is None
                else [raw.assign(**{PREFIX + c: float(c == before) for c in self.classes})]
            )
            rows = pd.concat([*earlier, raw], ignore_index=True)
            state = rows.assign(fold="", capture=0, frames=int(corpus.lengths[0]))
            settled = float(np.clip(1 - self.stopping.waiting(state, self.rate_hz)[-1], 0, 1))
        return str(most_probable_labels(proba, self.classes)[0]), float(proba.max()), settled

    def is_settled(self, settled: float | None) -> bool:
        """Return True if a label is settled enough to act on, by the rule from training subjects."""
        return (
            settled is not None and self.stopping is not None and settled >= self.stopping.threshold
        )

    def _calibrated(self, proba: pd.DataFrame, lengths: np.ndarray) -> pd.DataFrame:
        """Probabilities of captures of so many frames as sure as training subjects show them to be."""
        if self.stopping is None:
            return proba
        ms = 1000 / self.rate_hz * lengths
        return pd.DataFrame(
            self.stopping.calibration(proba.to_numpy(dtype=np.float64), ms), columns=proba.columns
        )

    def _mean(self, corpus: Corpus) -> pd.DataFrame:
        """Mean probability of the decisions on each capture, a column p_<class> per class."""
        captures = pd.DataFrame({"subject": "", "gesture": ""}, index=range(len(corpus)))
        anonymous = Corpus(
            *shared_frames(corpus), corpus.lengths, captures, corpus.rate_hz, corpus.full_scale
        )
        table = predictions_table(
            self.estimator, anonymous, "", np.arange(len(corpus)), self.classes
        )
        columns = [PREFIX + c for c in classes_of(table)]
        return table.groupby("capture", sort=True)[columns].mean().reset_index(drop=True)

    def predict(
        self, context: object, model_input: pd.DataFrame, params: dict | None = None
    ) -> pd.DataFrame:
        """Label the captures of a table with one row per frame.

        Args:
            context: context of MLflow, unused.
            model_input: columns ``capture``, ``frame`` (from 0 or 1) or both, and ch1, ch2, ... row by row.
            params: ``rate_hz``, which must be that of the training captures.

        Returns:
            One row per capture: capture, label, confidence, unlike, p_<class>.
        """
        try:
            self.check_rate((params or {}).get("rate_hz", self.rate_hz))
            corpus = corpus_from_table(
                model_input, self.channels, self.rate_hz, self.grid, self.full_scale, "input"
            )
        except InputError as e:
            raise MlflowException(str(e), error_code=INVALID_PARAMETER_VALUE) from e
        return pd.concat([corpus.captures[["capture"]], self.label_captures(corpus)], axis=1)

    def signature(self) -> ModelSignature:
        """MLflow signature of `predict`; channels take whole numbers and decimals."""
        inputs: list[ColSpec | TensorSpec] = [
            ColSpec(AnyType(), n, required=False) for n in ("capture", "frame")
        ]
        inputs += [ColSpec(AnyType(), name) for name in self.channels]
        outputs: list[ColSpec | TensorSpec] = [
            ColSpec(DataType.string, name) for name in ("capture", "label")
        ]
        outputs += [ColSpec(DataType.double, "confidence"), ColSpec(DataType.boolean, "unlike")]
        outputs += [ColSpec(DataType.double, PREFIX + c) for c in self.classes]
        rate = ParamSchema([ParamSpec("rate_hz", DataType.double, self.rate_hz)])
        return ModelSignature(Schema(inputs), Schema(outputs), rate)

    def mlflow_arguments(
        self, plugins: list[str], frames: np.ndarray, packages: tuple[str, ...] = ()
    ) -> dict[str, Any]:
        """Arguments for MLflow's ``log_model`` and ``save_model``, besides the code (`copy_own_code`)."""
        example = pd.DataFrame(frames.reshape(len(frames), -1), columns=self.channels)
        example.insert(0, "frame", np.arange(len(frames)))
        example.insert(0, "capture", "1")
        sensor = {"grid": list(self.grid), "rate_hz": self.rate_hz, "full_scale": self.full_scale}
        return {
            "python_model": self,
            "pip_requirements": pip_requirements(plugins, packages),
            "signature": self.signature(),
            "input_example": example,
            "metadata": sensor | {"classes": self.classes, "synthetic": self.synthetic},
        }


def reading_step(corpus: Corpus) -> float:
    """The number that all readings of some captures are multiples of, such as 1; 0 if there is none."""
    if shared_frames(corpus)[0].dtype.kind in "iu":
        return 1.0
    values = np.zeros(0)
    for frames in corpus:  # those of other captures, which may be tested, lie beside them
        values = np.union1d(values, frames).astype(np.float64)
        if len(values) > MOST_VALUES:
            return 0.0
    step = float(np.diff(values, prepend=0.0)[values > 0].min(initial=np.inf))
    whole = values / step
    return step if np.abs(whole - whole.round()).max(initial=0) < CLOSE and step < np.inf else 0.0


@contextmanager
def copy_own_code() -> Iterator[str]:
    """The package ``bench`` as an installation has it, in a temporary folder: what MLflow stores as ``code_paths``."""
    left_out = shutil.ignore_patterns("__pycache__", "reports", "reference")
    with tempfile.TemporaryDirectory(prefix="touchbench-code-") as folder:
        own = Path(folder) / "bench"
        shutil.copytree(package_folder("bench"), own, ignore=left_out)
        for package in PACKAGES:
            shutil.copytree(
                package_folder(f"bench.{package}"),
                own / package,
                ignore=left_out,
                dirs_exist_ok=True,
            )
        yield str(own)


def pip_requirements(plugins: list[str], packages: tuple[str, ...] = ()) -> list[str]:
    """Requirements of a model at their installed versions, besides touchbench's own code, which is saved with it."""
    names = list(packages)
    for line in requires("touchbench") or []:
        extra = re.search(r"extra == [\"'](.+?)[\"']", line)
        if not extra or extra[1] in plugins:  # a system that needs more has an extra of its name
            names += re.findall(r"^[\w.-]+", line)
    for room in ("models", "features"):
        names += [
            e.dist.name
            for e in entry_points(group=f"touchbench.{room}")
            if e.dist and e.name in plugins
        ]
    versions = {}
    for name in names:
        with suppress(
            PackageNotFoundError
        ):  # xgboost has two distributions, one of them is installed
            versions[name] = version(name).partition("+")[
                0
            ]  # a version such as 2.13.0+cpu is on no package index
    return [f"{name}=={number}" for name, number in versions.items()]


def pickle_user_code() -> None:
    """Save the code of a user's file, and of what it imports from beside it, inside the model; others lack it."""
    import cloudpickle

    every = {name: module for name, module in sys.modules.items() if isinstance(module, ModuleType)}
    modules = {name: module for name, module in every.items() if getattr(module, "__file__", None)}
    folders = {
        Path(m.__file__ or "").parent
        for name, m in modules.items()
        if name.startswith(FILE_MODULE_PREFIX)
    }
    for name, module in modules.items():
        if lies_in(module.__file__, folders) and name.split(".")[0] not in (
            "bench",
            "__main__",
        ):
            cloudpickle.register_pickle_by_value(module)


def load_recogniser(model: str) -> Recogniser:
    """A saved system, by its address in the user's store or a folder."""
    if re.match(r"(models|runs):/", model):
        mlflow.set_tracking_uri(store_uri())
    elif not (Path(model) / "MLmodel").is_file():
        raise InputError(
            f"{model}: not a saved model; give models:/... or runs:/.../model of the store of this folder, or a folder "
            "of bench fit out="
        )
    else:
        model = str(Path(model))
    for package in PACKAGES:  # touchbench as it is here, whatever code goes with the model
        importlib.import_module(f"bench.{package}")
    path = list(sys.path)
    try:
        with silence_mlflow():
            recogniser = mlflow.pyfunc.load_model(model).unwrap_python_model()
    except (
        Exception
    ) as e:  # a missing run, a damaged file, a library that is not there: all of them end here
        if isinstance(e, ModuleNotFoundError) and str(e.name).startswith("bench."):
            lacks = f"needs {e.name}, which this version of touchbench lacks"
            raise InputError(f"{model} {lacks}; save it again with bench fit") from e
        raise InputError(
            f"{model} cannot be loaded: {str(e).splitlines()[0] if str(e) else type(e).__name__}"
        ) from e
    finally:
        sys.path = path
    if not isinstance(recogniser, Recogniser):
        raise InputError(f"{model} is not a model of touchbench; give one that bench fit saved")
    if recogniser.format != FORMAT:
        raise InputError(
            f"{model} was saved by another version of touchbench; save it again with bench fit"
        )
    return recogniser


@contextmanager
def silence_mlflow() -> Iterator[None]:
    """Without MLflow's notes on pickled code and hints, which the help page has."""
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(logging.NOTSET)
