"""What the user typed, as a list of cells: one cell is one tracked run. Making the list loads no data."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import itertools
import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.registry import load, nearest, parameters
from bench.source import source_digest, versions

if TYPE_CHECKING:
    from bench.corpus import Corpus

PARTS = {"protocol": "protocols", "features": "features", "model": "models"}
DEFAULTS = {"data": "synth", "protocol": "loso", "model": "svm", "seed": "0", "where": "", "target": "gesture"}
DEFAULT_FEATURES = "jung54"


@dataclass(frozen=True)
class Part:
    """A protocol, feature set, model or generated corpus by name, with every parameter it takes."""

    room: str
    name: str
    parameters: dict[str, object] = field(default_factory=dict, hash=False)

    def make(self, **handed: object) -> object:
        """Build it; ``handed`` are what the harness gives besides the parameters."""
        return load(self.room, self.name)(**self.parameters, **handed)

    def __str__(self) -> str:
        """The name with those parameters that are not the default: ``svm[C=8.0]``."""
        usual = parameters(load(self.room, self.name))
        changed = ", ".join(f"{k}={v}" for k, v in self.parameters.items() if v != usual[k] and k != "seed")
        return f"{self.name}[{changed}]" if changed else self.name


@dataclass(frozen=True)
class Cell:
    """One (data, protocol, features, model, parameters, seed) combination."""

    data: str
    data_parameters: dict[str, object]
    where: str
    target: str
    protocol: Part
    features: Part | None
    model: Part
    tuning: dict[str, object] | None = None

    def system(self) -> str:
        """Model and feature set as they are named in tables."""
        model = f"tuned {self.model.name}[{_described(self.tuning)}]" if self.tuning else str(self.model)
        return f"{model} · {self.features}" if self.features else model

    def estimator(self) -> object:
        """The untrained scikit-learn classifier."""
        if self.tuning:
            from models.tuning import Search

            name = self.model.name
            features = {self.features.name: self.features.make()} if self.features else None
            if self.tuning.get("over") == "features":
                from features.selection import COUNTS, Subset

                features = {f"{n} best of {self.features}": Subset(self.features.make(), n) for n in COUNTS} | features
            how = {k: v for k, v in self.tuning.items() if k not in ("space", "over")}
            return Search({name: load("models", name)}, {name: self.tuning["space"]}, features, **how)
        return self.model.make(features=self.features.make()) if self.features else self.model.make()

    def feature_sets(self) -> dict[str, object]:
        """The feature sets that the system uses, by name; none for one that reads raw frames."""
        if self.features:
            return {str(self.features): self.features.make()}
        estimator = self.estimator()
        if "features" in getattr(estimator, "named_steps", {}):
            fixed = estimator.named_steps["features"]
            return {type(fixed).__name__.lower(): fixed}
        return dict(getattr(estimator, "features", None) or {})

    def packages(self) -> tuple[str, ...]:
        """Packages that this system alone depends on."""
        return getattr(load("models", self.model.name), "packages", ())

    def _searching(self) -> list[str]:
        """Modules that a search depends on besides its parts."""
        selection = ["features.selection"] if self.tuning and self.tuning.get("over") == "features" else []
        return ["models.tuning", *selection] if self.tuning else []

    def key(self, corpus: Corpus, threads: int) -> str:
        """What makes two runs the same run: data, selection, parts, parameters, code, library versions, threads."""
        parts = [p for p in (self.protocol, self.features, self.model) if p]
        same = {
            "digest": corpus.digest,
            "captures": hashlib.sha256(corpus.index.tobytes()).hexdigest(),
            "target": self.target,
            "tuning": repr(self.tuning),
            "search": [source_digest(importlib.import_module(name)) for name in self._searching()],
            "parts": [(p.room, p.name, p.parameters, source_digest(load(p.room, p.name))) for p in parts],
            "harness": source_digest(importlib.import_module("bench.fold")),
            "versions": versions(self.packages()),
            "threads": threads,
        }
        return hashlib.sha256(json.dumps(same, sort_keys=True, default=str).encode()).hexdigest()[:20]


def _described(tuning: dict[str, object]) -> str:
    """What a search tries and how, in a few words: ``C, gamma=0.1|1, inner=loso``."""
    values = {k: v if isinstance(v, list) else None for k, v in tuning["space"].items()}
    words = [k if v is None else f"{k}=" + "|".join(map(str, v)) for k, v in values.items()]
    return ", ".join([*words, *(f"{k}={v}" for k, v in tuning.items() if k not in ("space", "seed"))])


def parse(arguments: list[str], known: set[str]) -> dict[str, str]:
    """Split ``key=value`` arguments.

    Args:
        arguments: what was typed.
        known: keys that may appear; those of `PARTS` and ``data`` may also be dotted.

    Raises:
        InputError: an argument without ``=``, a key given twice, or an unknown key.
    """
    values: dict[str, str] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if not equals or not key or not value:
            raise InputError(f"{argument!r} is not key=value; keys: {', '.join(sorted(known))}")
        if key in values:
            raise InputError(f"{key}= is given twice; write {key}={values[key]},{value} for both")
        if key.split(".")[0] not in known or ("." in key and key.split(".")[0] not in (*PARTS, "data")):
            raise InputError(f"no key is called {key!r}; {nearest(key, known)}")
        values[key] = value
    return values


def cells(values: dict[str, str]) -> list[Cell]:
    """The cross product of every comma-separated value, without repetitions.

    Raises:
        InputError: an unknown part, parameter or value, or a combination that means nothing.
    """
    chosen = {key: items(key, values.get(key, default)) for key, default in DEFAULTS.items()}
    feature_names = items("features", values.get("features", DEFAULT_FEATURES))
    takes = {m: "features" in inspect.signature(load("models", m)).parameters for m in chosen["model"]}
    if "features" in values and not any(takes.values()):
        raise InputError(
            f"features={values['features']} does nothing: {', '.join(takes)} takes none; leave features= out"
        )
    seeds = [convert("seed", s, 0) for s in chosen["seed"]]
    found: dict[str, Cell] = {}
    for data, where, target, protocol, model, seed in itertools.product(
        *(chosen[key] for key in ("data", "where", "target", "protocol", "model")), seeds
    ):
        for features in feature_names if takes[model] else [None]:
            for parts in itertools.product(
                corpus_variants(values, data, chosen["data"]),
                _variants(values, "protocol", protocol, chosen["protocol"], None),
                _variants(values, "features", features, feature_names, seed) if features else [None],
                _variants(values, "model", model, chosen["model"], seed),
            ):
                cell = Cell(data, parts[0], where, target, *parts[1:])
                found.setdefault(repr(cell), cell)
    return list(found.values())


def items(key: str, value: str) -> list[str]:
    """The values between commas.

    Raises:
        InputError: there is nothing between two of them.
    """
    if key == "where":  # a query may hold commas
        return [value]
    items = value.split(",")
    if not all(items):
        raise InputError(f"{key}={value}: there is nothing between two commas")
    return items


def _variants(values: dict[str, str], key: str, name: str, siblings: list[str], seed: int | None) -> list[Part]:
    """One part with every combination of its dotted parameters.

    In a grid of several parts, a parameter is for those that take it.
    """
    room = PARTS[key]
    usual = parameters(load(room, name))
    given = {k.partition(".")[2]: v for k, v in values.items() if k.startswith(f"{key}.")}
    known = {p for s in siblings for p in parameters(load(room, s))}
    for parameter in given:
        if parameter not in known:
            raise InputError(f"{key}={name} has no parameter {parameter!r}; {nearest(parameter, known)}")
    if seed is not None and "seed" in usual:
        usual = usual | {"seed": seed}
    taken = {p: text for p, text in given.items() if p in usual}
    sweep = {p: [convert(f"{key}.{p}", v, usual[p]) for v in items(p, text)] for p, text in taken.items()}
    return [Part(room, name, usual | dict(zip(sweep, c, strict=True))) for c in itertools.product(*sweep.values())]


def corpus_variants(values: dict[str, str], data: str, siblings: list[str]) -> list[dict[str, object]]:
    """Parameters of the generator; an imported corpus has none."""
    given = {k.partition(".")[2]: v for k, v in values.items() if k.startswith("data.")}
    if "synth" not in siblings and given:
        raise InputError(f"data.{next(iter(given))}: only data=synth has parameters; choose captures with where=")
    if data != "synth":
        return [{}]
    from bench.corpora.synth import generate

    usual = parameters(generate)
    for parameter in given:
        if parameter not in usual:
            raise InputError(f"data=synth has no parameter {parameter!r}; {nearest(parameter, usual)}")
    sweep = {p: [convert(f"data.{p}", v, usual[p]) for v in items(p, t)] for p, t in given.items()}
    return [usual | dict(zip(sweep, c, strict=True)) for c in itertools.product(*sweep.values())]


def convert(key: str, text: str, default: object) -> object:
    """Text as a value of the type of the default; a default of None takes None or a whole number.

    Raises:
        InputError: the text is no such value.
    """
    if default is None or text == "None":
        kind, convert = "a whole number or None", lambda t: None if t == "None" else int(t)
        if default is not None:
            raise InputError(f"{key}=None: give a value such as {default!r}")
    elif isinstance(default, bool):
        kind, convert = "true or false", {"true": True, "false": False}.__getitem__
    elif isinstance(default, int):
        kind, convert = "a whole number" + (" from 0 on" if key.endswith("seed") else ""), int
    elif isinstance(default, float):
        kind, convert = "a number", float
    elif isinstance(default, tuple):
        kind, convert = "names joined by +", lambda t: tuple(t.split("+"))
    else:
        kind, convert = "text", str
    try:
        value = convert(text)
        if key.endswith("seed") and value < 0:
            raise ValueError(key)
        return value
    except (ValueError, KeyError) as e:
        raise InputError(f"{key}={text}: give {kind}, such as {default}") from e
