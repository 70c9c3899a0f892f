"""Fitted systems as MLflow models: saved by `bench fit`, and loaded again.

A model is code: loading one runs it. Models are loaded from the user's store, and from folders that
the user names. The digests of its files are checked first.
"""

from __future__ import annotations

import importlib
import logging
import re
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, entry_points, requires, version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import cloudpickle
import mlflow
import numpy as np
import pandas as pd
from mlflow.exceptions import MlflowException
from mlflow.models import ModelSignature
from mlflow.models.model import ModelInfo
from mlflow.protos.databricks_pb2 import INVALID_PARAMETER_VALUE
from mlflow.pyfunc import PythonModel
from mlflow.types import ColSpec, DataType, ParamSchema, ParamSpec, Schema
from mlflow.types.schema import AnyType

from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.read.table import corpus_from_table
from bench.corpora.skin import design_of
from bench.errors import InputError
from bench.ground.digests import FOLDER_FILE, DamagedFile, check_folder, write_folder_digest
from bench.ground.registry import FILE_MODULE_PREFIX
from bench.ground.source import git_revisions, lies_in, package_folder
from bench.running.fold import predict_to_table
from bench.running.unlike import is_unlike_training, usual_range
from bench.store.client import use_tracking_uri
from bench.values.scores import PREFIX, classes_of, most_probable_labels

if TYPE_CHECKING:
    from bench.contract import System
    from bench.running.replay import Stopping

CLOSE = 1e-3  # of a step, as single precision has readings
MOST_VALUES = 1 << 16  # of readings that are multiples of a step: what C can sum up in 32 bits
FORMAT = "5"  # version of saved models; others are refused

PACKAGES = ("features", "models", "protocols")  # their code goes with a model, beside that of bench


class Recogniser(PythonModel):
    """A fitted system with the required format of its frames; it keeps no training frames.

    Args:
        estimator: fitted to a `Corpus`.
        corpus: the captures that it was fitted to.
        stopping: calibration and stopping rule; None if its captures could not teach them.
        watcher: a part learned beside the system (`bench.running.fit.fit`), or None.
    """

    format = ""  # of a model that another version has saved
    skin: Mapping[str, Any] = {}  # a design and what was recorded; empty without a design
    revision = ""  # of the checkout that saved it; git_revisions

    def __init__(
        self,
        estimator: System,
        corpus: Corpus,
        stopping: Stopping | None = None,
        watcher: Any = None,
    ) -> None:
        self.format, self.revision, self.estimator = FORMAT, git_revisions(), estimator
        self.stopping, self.watcher = stopping, watcher
        self.classes = np.unique(corpus.gestures.astype(str)).tolist()
        rows, cols = corpus.grid
        self.grid = int(rows), int(cols)
        self.rate_hz = float(corpus.rate_hz)
        self.full_scale = float(corpus.full_scale)  # largest value of a channel
        self.longest = int(corpus.lengths.max())  # frames of the longest training capture
        self.synthetic = corpus.synthetic
        self.step = reading_step(corpus)
        self.usual = usual_range(corpus)
        if "design" in corpus.info:
            self.skin = {name: corpus.info[name] for name in ("design", "recorded")}

    @property
    def design(self) -> Any:
        """Its skin (`bench.corpora.skin.Design`), the range learned; None for the recorded one."""
        return design_of(self.skin)

    @property
    def channels(self) -> list[str]:
        """Columns of a frame, row by row: ch1, ch2, ..."""
        return [f"ch{i + 1}" for i in range(self.grid[0] * self.grid[1])]

    def check_rate(self, rate_hz: float) -> None:
        """Raise an `InputError` for frames of another rate."""
        if not np.isclose(rate_hz, self.rate_hz, rtol=1e-3):
            raise InputError(
                f"rate_hz={rate_hz:g}: this model was trained at {self.rate_hz:g} Hz; resample the "
                "frames, or train a model on captures of that rate"
            )

    def label(self, corpus: Corpus) -> pd.DataFrame:
        """Classify captures.

        A system that decides per window has the mean probability of its windows. Probabilities are
        calibrated, if the model has learned a calibration. Where it abstains, the label is empty
        and every probability 0.

        Returns:
            A row each: label, confidence (probability of the label), unlike (True if the capture
            looks unlike all training captures), and p_<class> of each class.
        """
        proba = self._calibrate(self._mean_probabilities(corpus), corpus.lengths)
        label = most_probable_labels(proba.to_numpy(), self.classes)
        labels = pd.DataFrame({"label": label, "confidence": proba.max(axis=1)})
        labels["unlike"] = is_unlike_training(corpus, self.usual)
        return pd.concat([labels, proba], axis=1)

    def label_nothing(self) -> None:
        """Classify and watch a second without touch, which fails if code and model do not fit."""
        frames = np.zeros((max(1, round(self.rate_hz)), *self.grid), np.float32)
        captures = pd.DataFrame({"subject": [""], "gesture": self.classes[:1]})
        second = Corpus.from_captures([frames], captures, self.rate_hz, full_scale=self.full_scale)
        self.label(second)
        if self.watcher is not None:
            self.watcher.report_touches(second)

    def decide_on(self, corpus: Corpus, before: str | None) -> tuple[str, float, float | None]:
        """Classify the frames of one capture so far.

        Args:
            corpus: the capture.
            before: the label when 1/1.41 as much had been seen, if any.

        Returns:
            Label, confidence, and settledness of the label, 0 to 1; None without a stopping rule
            that saves time.
        """
        raw, settled = self._mean_probabilities(corpus), None
        proba = self._calibrate(raw, corpus.lengths).to_numpy()
        if self.stopping is not None and self.stopping.saves:
            rows = [raw]
            if before is not None:
                certain = {PREFIX + name: float(name == before) for name in self.classes}
                rows = [raw.assign(**certain), raw]
            table = pd.concat(rows, ignore_index=True)
            table = table.assign(fold="", capture=0, frames=int(corpus.lengths[0]))
            gain = self.stopping.waiting(table, self.rate_hz)[-1]
            settled = float(np.clip(1 - gain, 0, 1))
        label = most_probable_labels(proba, self.classes)[0]
        return str(label), float(proba.max()), settled

    def is_settled(self, settled: float | None) -> bool:
        """True if a label is settled enough to act on, by the rule from training subjects."""
        if settled is None or self.stopping is None:
            return False
        return settled >= self.stopping.threshold

    def _calibrate(self, proba: pd.DataFrame, lengths: np.ndarray) -> pd.DataFrame:
        """Calibrate probabilities of captures with these numbers of frames."""
        if self.stopping is None:
            return proba
        values = proba.to_numpy(dtype=np.float64)
        calibrated = self.stopping.calibration(values, 1000 / self.rate_hz * lengths)
        return pd.DataFrame(calibrated, columns=proba.columns)

    def _mean_probabilities(self, corpus: Corpus) -> pd.DataFrame:
        """Mean probability of the decisions on each capture, a column p_<class> per class."""
        captures = pd.DataFrame({"subject": "", "gesture": ""}, index=range(len(corpus)))
        sensor = corpus.rate_hz, corpus.full_scale
        anonymous = Corpus(*shared_frames(corpus), corpus.lengths, captures, *sensor)
        every = np.arange(len(corpus))
        table = predict_to_table(self.estimator, anonymous, "", every, self.classes)
        columns = [PREFIX + name for name in classes_of(table)]
        return table.groupby("capture", sort=True)[columns].mean().reset_index(drop=True)

    def predict(
        self, context: object, model_input: pd.DataFrame, params: dict | None = None
    ) -> pd.DataFrame:
        """Classify the captures of a table with one row per frame.

        Args:
            context: context of MLflow, unused.
            model_input: columns ``capture``, ``frame`` (from 0 or 1) or both, and ch1, ch2, ...
                row by row.
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
        return pd.concat([corpus.captures[["capture"]], self.label(corpus)], axis=1)

    def signature(self) -> ModelSignature:
        """Return the MLflow signature of `predict`; channels take whole numbers and decimals."""
        inputs = [ColSpec(AnyType(), name, required=False) for name in ("capture", "frame")]
        inputs += [ColSpec(AnyType(), name) for name in self.channels]
        types = {"capture": DataType.string, "label": DataType.string}
        types |= {"confidence": DataType.double, "unlike": DataType.boolean}
        types |= {PREFIX + name: DataType.double for name in self.classes}
        outputs = [ColSpec(dtype, name) for name, dtype in types.items()]
        rate = ParamSchema([ParamSpec("rate_hz", DataType.double, self.rate_hz)])
        return ModelSignature(Schema([*inputs]), Schema([*outputs]), rate)

    def mlflow_arguments(
        self, plugins: list[str], frames: np.ndarray, packages: tuple[str, ...] = ()
    ) -> dict[str, Any]:
        """Return arguments of MLflow's ``log_model`` and ``save_model``, without the code.

        Args:
            plugins: names of the parts of the system, whose packages are required.
            frames: frames of a capture, as an example.
            packages: further required packages.
        """
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
    """The number that all readings of some captures are multiples of, such as 1; 0 for none."""
    if shared_frames(corpus)[0].dtype.kind in "iu":
        return 1.0
    values = np.zeros(0)
    for frames in corpus:  # not the shared array: it has other captures, too, such as test captures
        values = np.union1d(values, frames).astype(np.float64)
        if len(values) > MOST_VALUES:
            return 0.0
    step = float(np.diff(values, prepend=0.0)[values > 0].min(initial=np.inf))
    multiples = values / step
    error = np.abs(multiples - multiples.round()).max(initial=0)
    return step if error < CLOSE and step < np.inf else 0.0


@contextmanager
def copy_own_code() -> Iterator[str]:
    """Copy the package ``bench`` to a temporary folder, as MLflow's ``code_paths``."""
    ignore = shutil.ignore_patterns("__pycache__", "reports", "reference")
    with tempfile.TemporaryDirectory(prefix="touchbench-code-") as folder:
        own = Path(folder) / "bench"
        shutil.copytree(package_folder("bench"), own, ignore=ignore)
        for name in PACKAGES:
            source = package_folder(f"bench.{name}")
            shutil.copytree(source, own / name, ignore=ignore, dirs_exist_ok=True)
        yield str(own)


def pip_requirements(plugins: list[str], packages: tuple[str, ...] = ()) -> list[str]:
    """List what a model requires at its installed versions; touchbench's code is saved with it."""
    names = list(packages)
    for line in requires("touchbench") or []:
        extra = re.search(r"extra == [\"'](.+?)[\"']", line)
        if not extra or extra[1] in plugins:  # a system that needs more has an extra of its name
            names += re.findall(r"^[\w.-]+", line)
    for group in ("touchbench.models", "touchbench.features"):
        entries = [entry for entry in entry_points(group=group) if entry.name in plugins]
        names += [entry.dist.name for entry in entries if entry.dist]
    versions = {}
    for name in names:
        with suppress(PackageNotFoundError):  # of xgboost's two distributions one is installed
            versions[name] = version(name).partition("+")[0]  # no index has 2.13.0+cpu
    return [f"{name}=={number}" for name, number in versions.items()]


def pickle_user_code() -> None:
    """Have models contain the code of a user's file, and of its imports from beside it."""
    modules = {}
    for name, module in list(sys.modules.items()):
        if isinstance(module, ModuleType) and getattr(module, "__file__", None):
            modules[name] = module
    own = [module for name, module in modules.items() if name.startswith(FILE_MODULE_PREFIX)]
    folders = {Path(module.__file__ or "").parent for module in own}
    for name, module in modules.items():
        if name.split(".")[0] not in ("bench", "__main__") and lies_in(module.__file__, folders):
            cloudpickle.register_pickle_by_value(module)


def save_model(folder: Path, arguments: Mapping[str, Any]) -> None:
    """Save a model as a folder, with the digests of its files."""
    mlflow.pyfunc.save_model(str(folder), **arguments)
    write_folder_digest(folder)


def log_model(arguments: Mapping[str, Any]) -> ModelInfo:
    """Save a model with the active run of MLflow, with the digests of its files."""
    saved = mlflow.pyfunc.log_model(name="model", **arguments)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, FOLDER_FILE)
        write_folder_digest(Path(mlflow.artifacts.download_artifacts(saved.model_uri)), file)
        mlflow.MlflowClient().log_model_artifact(saved.model_id, str(file))
    return saved


def load_recogniser(model: str) -> Recogniser:
    """Load a saved system by its address in the user's store, or its folder.

    Raises:
        InputError: it is not there, cannot be loaded, or is of another version.
    """
    is_address = re.match(r"(models|runs):/", model)
    if not is_address and not (Path(model) / "MLmodel").is_file():
        raise InputError(
            f"{model}: not a saved model; give models:/... or runs:/.../model of the store of this "
            "folder, or a folder of bench fit out="
        )
    for name in PACKAGES:  # touchbench as it is here, whatever code goes with the model
        importlib.import_module(f"bench.{name}")
    path = list(sys.path)
    try:
        with use_tracking_uri(), silence_mlflow():
            folder = mlflow.artifacts.download_artifacts(model if is_address else str(Path(model)))
            check_folder(Path(folder))
            recogniser = mlflow.pyfunc.load_model(folder).unwrap_python_model()
    except DamagedFile as e:
        raise InputError(
            f"{model} is damaged: {e}; restore it, or save it again with bench fit"
        ) from e
    except Exception as e:  # a missing run, a damaged file, a missing library
        if isinstance(e, ModuleNotFoundError) and str(e.name).startswith("bench."):
            lacks = f"needs {e.name}, which this version of touchbench lacks"
            raise InputError(f"{model} {lacks}; save it again with bench fit") from e
        reason = str(e).splitlines()[0] if str(e) else type(e).__name__
        raise InputError(f"{model} cannot be loaded: {reason}") from e
    finally:
        sys.path = path
    if not isinstance(recogniser, Recogniser):
        raise InputError(f"{model} is not a model of touchbench; give one that bench fit saved")
    if recogniser.format != FORMAT:
        raise InputError(
            f"{model} was saved by another version of touchbench; save it again with bench fit"
        )
    if recogniser.revision != git_revisions():
        try:
            recogniser.label_nothing()
        except (AttributeError, ImportError, TypeError) as e:
            raise InputError(
                f"{model} was saved by another commit of touchbench, which this one cannot use "
                f"({e}); save it again with bench fit"
            ) from e
    return recogniser


@contextmanager
def silence_mlflow() -> Iterator[None]:
    """Silence MLflow's notes on pickled code, and hints that the help page has."""
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(logging.NOTSET)
