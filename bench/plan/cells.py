"""Arguments as a list of cells: one cell is one tracked run. Making the list loads no data."""

from __future__ import annotations

import hashlib
import inspect
import itertools
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from bench import contract
from bench.arguments import PARTS, Values, convert, items, text_of
from bench.corpora.faults import known
from bench.errors import InputError, nearest
from bench.registry import load, names, parameters, required
from bench.source import source_digest, versions
from models import recipe

if TYPE_CHECKING:
    from bench.plan.splits import Splitter
    from models.search.space import Tuning

DEFAULTS = {"data": "synth", "protocol": "loso", "model": "svm", "seed": "0", "where": "", "target": "gesture"}
DEFAULT_FEATURES = "jung54"
HOW = ("inner", "trials", "budget")  # of a search, as it is typed
Made = TypeVar("Made")  # what a part is when it is built


@dataclass(frozen=True)
class Part(Generic[Made]):
    """A protocol, feature set or model, with every parameter it takes.

    Attributes:
        room: of `bench.registry.ROOMS`.
        name: a registered one or ``file.py:Name``; of an object what it is shown as.
        parameters: by name.
        given: the object itself, where one was handed over from Python.
        module: that its file was loaded as, which tells one state of the file from another; empty for other parts.
    """

    room: str
    name: str
    parameters: dict[str, object] = field(default_factory=dict, hash=False)
    given: Made | None = field(default=None, hash=False)
    module: str = field(default="", hash=False, repr=False)

    @property
    def factory(self) -> Callable[..., Made]:
        """The class or function behind the name.

        Raises:
            InputError: its file is not what it was when the command began.
        """
        found = load(self.room, self.name)
        if self.module and found.__module__ != self.module:
            raise InputError(f"{self.name}: the file was changed while it was in use; start the command again")
        return found

    def make(self) -> Made:
        """Build one that takes nothing from the harness: a protocol or a feature set."""
        return self.factory(**self.parameters) if self.given is None else contract.copied(self.given)

    def changed(self, seed: int | None = None) -> dict[str, object]:
        """Parameters that are not the default. The seed of a model is no such, as it is that of the run.

        Args:
            seed: the default of a parameter ``seed``, if it is not that of the factory.
        """
        if self.given is not None:
            return _arguments(self.given) if self.name == type(self.given).__name__ else {}
        usual = parameters(self.factory)
        if self.room == "models" and "seed" in self.parameters:
            usual["seed"] = self.parameters["seed"]
        elif seed is not None:
            usual["seed"] = seed
        return {k: v for k, v in self.parameters.items() if k not in usual or v != usual[k]}

    @property
    def short(self) -> str:
        """The name without a file's path; with the file's name if it is also that of a built-in part."""
        file, _, own = self.name.rpartition(":")
        if self.given is not None or not file:
            return self.name
        return f"{Path(file).stem}.{own}" if own in names(self.room) else own

    def __str__(self) -> str:
        return self.label()

    def label(self, seed: int | None = None) -> str:
        """The name with those parameters that are not the default: ``svm[C=8.0]``.

        Args:
            seed: as of `changed`.
        """
        told = {k: text_of(v) if isinstance(v, tuple) else v for k, v in self.changed(seed).items()}
        changed = ", ".join(f"{k}={v}" for k, v in told.items())
        return f"{self.short}[{changed}]" if changed else self.short

    def identity(self) -> tuple:
        """What two equal parts have in common: name, parameters, and what their code says."""
        if self.given is None:
            beyond = set(self.parameters) - set(parameters(self.factory))
            code = source_digest(self.factory, *([recipe.Recipe] if beyond else []))
            return self.room, self.short, self.parameters, code
        own = contract.classes(self.given)
        return self.room, self.name, contract.settings(self.given), source_digest(*own) if own else ""

    def packages(self) -> tuple[str, ...]:
        """Packages that this part alone depends on."""
        return contract.packages(self.factory) if self.given is None else contract.libraries(self.given)


@dataclass(frozen=True)
class Cell:
    """One (data, protocol, features, model, parameters, seed) combination."""

    data: str
    data_parameters: dict[str, object]
    where: str
    target: str
    protocol: Part[Splitter]
    features: Part[contract.Features] | None
    model: Part[contract.System]
    tuning: Tuning | None = None

    def system(self) -> str:
        """Model and feature set as they are named in tables."""
        model = f"tuned {self.model.short}[{_described(self.tuning)}]" if self.tuning else str(self.model)
        return f"{model} · {self.features.label(self._features_seed)}" if self.features else model

    def title(self) -> str:
        """System, data and protocol: the name of the run."""
        return f"{self.system()} | {self.data} | {self.protocol}"

    @property
    def given(self) -> bool:
        """Whether a part is an object that was handed over from Python."""
        return any(part is not None and part.given is not None for part in (self.protocol, self.features, self.model))

    @property
    def seed(self) -> int | None:
        """Of the search, of the model, or else of the feature set; None where there is nothing random."""
        parts = [part.parameters for part in (self.model, self.features) if part]
        seeds = [self.tuning.get("seed")] if self.tuning else [own["seed"] for own in parts if "seed" in own]
        return seeds[0] if seeds and isinstance(seeds[0], int) else None

    @property
    def _features_seed(self) -> int | None:
        """The default of the seed of the feature set: that of the run; a search has its own."""
        return None if self.tuning else self.seed

    def estimator(self) -> contract.System:
        """The untrained scikit-learn classifier."""
        features = self.features.make() if self.features else None
        if self.tuning:
            from models.search.tuning import tuned

            sets = {self.features.short: features} if self.features else None
            return tuned(self.model.short, self.model.factory, sets, str(self.features), self.tuning)
        if self.model.given is not None:
            return contract.behind(self.model.make(), features)
        return recipe.build(self.model.factory, features, **self.model.parameters)

    def feature_sets(self) -> dict[str, contract.Features]:
        """The feature sets that the system uses, by name; none for one that reads raw frames."""
        return (
            {self.features.label(self._features_seed): self.features.make()}
            if self.features
            else contract.features(self.estimator())
        )

    def packages(self) -> tuple[str, ...]:
        """Packages that this system alone depends on."""
        return self.model.packages()

    def identity(self) -> dict[str, object]:
        """What its results depend on, besides the captures: selection, parts with parameters and code, versions."""
        parts = [part for part in (self.protocol, self.features, self.model) if part]
        search = []
        if self.tuning:
            from models.search.tuning import machinery

            beyond = set(self.tuning["space"]) - set(parameters(self.model.factory))
            search = [source_digest(*machinery(self.tuning), *([recipe.Recipe] if beyond else []))]
        return self._faults() | {
            "target": self.target,
            "tuning": repr(self.tuning),
            "search": search,
            "parts": [part.identity() for part in parts],
            "versions": versions(self.packages()),
        }

    def _faults(self) -> dict[str, object]:
        """What the faults do that the system is trained on; they may come from other packages."""
        trained = [known()[name] for name in contract.trained_faults(self.estimator())]
        return {"faults": [(f.name, f.amounts, source_digest(f.damage)) for f in trained]} if trained else {}

    def arguments(self) -> dict[str, str]:
        """The arguments that make this cell, as they are typed; what has its default is left out."""
        found = {"data": self.data}
        found |= {f"data.{k}": text_of(v) for k, v in self.data_parameters.items() if v != _usual_data()[k]}
        found |= {"where": self.where} if self.where else {}
        found |= {"target": self.target} if self.target != DEFAULTS["target"] else {}
        for key, part in (("protocol", self.protocol), ("model", self.model), ("features", self.features)):
            if part:
                changed = part.changed(self._features_seed if key == "features" else None)
                found |= {key: part.name} | {f"{key}.{k}": text_of(v) for k, v in changed.items()}
        if self.tuning:
            lists = {k: v for k, v in self.tuning["space"].items() if isinstance(v, list)}
            found |= {f"model.{k}": ",".join(map(text_of, v)) for k, v in lists.items()}
            asked = dict(self.tuning)
            found |= {k: text_of(asked[k]) for k in (("over", "inner") if "over" in asked else HOW) if k in asked}
        return found | ({"seed": str(self.seed)} if self.seed else {})


def _arguments(made: object) -> dict[str, object]:
    """What an object was made with, where it keeps that under the same names and it is not the default."""
    asked, usual = inspect.signature(type(made)).parameters, parameters(type(made))
    kept = {name: value for name, value in vars(made).items() if name in asked}
    return {k: _brief(v) for k, v in kept.items() if k not in usual or repr(v) != repr(usual[k])}


def _brief(value: object) -> object:
    """A value in a label: a number or a name as it is, of anything else a digest."""
    if value is None or isinstance(value, int | float | str):
        return value
    with np.printoptions(threshold=sys.maxsize):
        return hashlib.sha256(repr(value).encode()).hexdigest()[:8]


def _usual_data() -> dict[str, object]:
    from bench.corpora.synth import generate

    return parameters(generate)


def _described(tuning: Tuning) -> str:
    """What a search tries and how, in a few words: ``C, gamma=0.1|1, inner=loso``."""
    values = {k: v if isinstance(v, list) else None for k, v in tuning["space"].items()}
    words = [k if v is None else f"{k}=" + "|".join(map(str, v)) for k, v in values.items()]
    return ", ".join([*words, *(f"{k}={v}" for k, v in tuning.items() if k not in ("space", "seed"))])


def cells(values: Values) -> list[Cell]:
    """The cross product of all listed values, without repetitions.

    Raises:
        InputError: an unknown part, parameter or value, or a combination that means nothing.
    """
    chosen = {key: items(key, values.get(key, default)) for key, default in DEFAULTS.items()}
    feature_sets = items("features", values.get("features", DEFAULT_FEATURES))
    takes = [_takes_features(model) for model in chosen["model"]]
    if "features" in values and not any(takes):
        models = ", ".join(map(str, chosen["model"]))
        raise InputError(f"features={values['features']} does nothing: {models} takes none; leave features= out")
    seeds = [convert("seed", s, 0) for s in chosen["seed"]]
    found: dict[str, Cell] = {}
    for data, where, target, protocol, (model, takes_features), seed in itertools.product(
        *(chosen[key] for key in ("data", "where", "target", "protocol")),
        zip(chosen["model"], takes, strict=True),
        seeds,
    ):
        for features in feature_sets if takes_features else [None]:
            for parts in itertools.product(
                corpus_variants(values, data, chosen["data"]),
                _variants(values, "protocol", protocol, chosen["protocol"], None),
                _variants(values, "features", features, feature_sets, seed) if features is not None else [None],
                _variants(values, "model", model, chosen["model"], seed),
            ):
                cell = Cell(data, parts[0], where, target, *parts[1:])
                given = [id(part.given) for part in parts[1:] if part and part.given is not None]
                found.setdefault(f"{cell!r} {given}", cell)
    return list(found.values())


def _takes_features(model: object) -> bool:
    """Whether a model is handed a feature set: its factory asks for one, or it learns from tables."""
    if not isinstance(model, str):
        return contract.reads_tables(model)
    factory = load("models", model)
    if asked := required(factory):
        if len(asked) > 1:
            raise InputError(f"model={model}: {', '.join(asked)} have no default; only the feature set may have none")
        return True
    return contract.reads_tables(factory)


def _variants(values: Values, key: str, name: object, siblings: list, seed: int | None) -> list[Part]:
    """One part with every combination of its dotted parameters.

    In a grid of several parts, a parameter is for those that take it.
    """
    room = PARTS[key]
    given = {k.partition(".")[2]: v for k, v in values.items() if k.startswith(f"{key}.")}
    factories = [load(room, s) for s in siblings if isinstance(s, str)]
    besides = recipe.besides if key == "model" else lambda factory: {}
    known = {p for f in factories for p in (*parameters(f), *besides(f))}
    for parameter in given:
        if parameter not in known:
            raise InputError(f"{key}={name} has no parameter {parameter!r}; {nearest(parameter, known)}")
    if not isinstance(name, str):
        wanted = "split" if key == "protocol" else "fit"
        if inspect.isclass(name) or not callable(getattr(name, wanted, None)):
            kind = getattr(name, "__name__", type(name).__name__)
            raise InputError(f"{key}={kind}: give a name, or an object that can {wanted}, such as {kind}()")
        return [Part(room, contract.shown(name), given=name)]
    factory, module = load(room, name), ""
    if (file := name.rpartition(":")[0]).endswith(".py"):  # from wherever a worker is started
        name, module = f"{Path(file).absolute()}:{name.rpartition(':')[2]}", factory.__module__
    usual = parameters(factory)
    if seed is not None and "seed" in usual:
        usual = usual | {"seed": seed}
    known_to = usual | besides(factory)
    taken = {p: text for p, text in given.items() if p in known_to}
    sweep = {p: [convert(f"{key}.{p}", v, known_to[p]) for v in items(f"{key}.{p}", text)] for p, text in taken.items()}
    made = [_told(usual, known_to, dict(zip(sweep, c, strict=True))) for c in itertools.product(*sweep.values())]
    return [Part(room, name, chosen, module=module) for chosen in made]


def _told(usual: dict, known: dict, asked: dict) -> dict[str, object]:
    """All parameters of a part's own, and those others that are not as usual."""
    return usual | {p: value for p, value in asked.items() if p in usual or value != known[p]}


def corpus_variants(values: Values, data: str, siblings: list[str]) -> list[dict[str, object]]:
    """Parameters of the generator; an imported corpus has none."""
    given = {k.partition(".")[2]: v for k, v in values.items() if k.startswith("data.")}
    if "synth" not in siblings and given:
        raise InputError(f"data.{next(iter(given))}: only data=synth has parameters; choose captures with where=")
    if not isinstance(data, str):
        raise InputError("data= takes the name of a corpus, such as data='synth'; see bench data")
    if data != "synth":
        return [{}]
    usual = _usual_data()
    for parameter in given:
        if parameter not in usual:
            raise InputError(f"data=synth has no parameter {parameter!r}; {nearest(parameter, usual)}")
    sweep = {p: [convert(f"data.{p}", v, usual[p]) for v in items(f"data.{p}", t)] for p, t in given.items()}
    return [usual | dict(zip(sweep, c, strict=True)) for c in itertools.product(*sweep.values())]
