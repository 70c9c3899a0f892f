"""Cells: what one run evaluates, as a value. `bench.plan.grid` makes them from typed values."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import contract
from bench.errors import InputError
from bench.features.base import FunctionFeatures
from bench.ground.registry import (
    load_part,
    parameter_defaults,
    registered_parts,
    required_parameters,
)
from bench.ground.source import package_versions, source_digest
from bench.ground.typed import DEFAULTS, format_value, parse_open_value, parse_value
from bench.plan import objects

if TYPE_CHECKING:
    from bench.ground.source import Code
    from bench.models.space import Tuning
    from bench.plan.splits import Splitter

SEARCH_KEYS = ("inner", "trials", "seconds")  # keys of bench tune


@dataclass(frozen=True)
class Part:
    """A protocol, feature set or model with all its parameters, by name or as an object.

    ``module`` is the module of a user's file; each state of the file has another one.
    """

    group: str  # a group of entry points, or a package that lists its parts
    name: str  # registered name or ``file.py:Name``; of an object, its displayed text
    parameters: dict[str, object] = field(default_factory=dict, hash=False)
    instance: Any = field(default=None, hash=False)  # object from Python, if there is one
    module: str = field(default="", hash=False, repr=False)

    @property
    def factory(self) -> Callable:
        """The class or function behind the name.

        Raises:
            InputError: its file has changed since the command began.
        """
        factory = load_part(self.group, self.name)
        if self.module and factory.__module__ != self.module:
            raise InputError(
                f"{self.name}: the file was changed while it was in use; start the command again"
            )
        return factory

    def parse(self, key: str, value: object, default: object) -> Any:
        """Read a typed value of a parameter; in a user's file, its default may fix no type."""
        return (parse_open_value if self.module else parse_value)(key, value, default)

    def make_object(self) -> Any:
        """Make a protocol, a feature set, or another part that needs no further arguments."""
        if self.instance is not None:
            return contract.untrained_copy(self.instance)
        if needed := required_parameters(self.factory):
            if self.group == "features" and inspect.isfunction(self.factory) and len(needed) == 1:
                return FunctionFeatures(self.factory, self.parameters)
            raise InputError(f"{self.name}: the argument {needed[0]} has no default; give it one")
        return self.factory(**self.parameters)

    def changed_parameters(self, run_seed: int | None = None) -> dict[str, object]:
        """Parameters that differ from their defaults.

        The run's seed counts as the default of ``seed``; a model's own is never changed.
        """
        if self.instance is not None:
            is_typed_by_class = self.name == type(self.instance).__name__
            return objects.changed_arguments(self.instance) if is_typed_by_class else {}
        seed: object = run_seed
        if self.group == "models":
            seed = self.parameters.get("seed", run_seed)
        defaults = parameter_defaults(self.factory)
        if seed is not None:
            defaults["seed"] = seed
        return {k: v for k, v in self.parameters.items() if k not in defaults or v != defaults[k]}

    @property
    def short_name(self) -> str:
        """The name without its folder; after the file's name if a registered part has this name."""
        file, _, name = self.name.rpartition(":")
        if self.instance is not None or not file:
            return self.name
        return f"{Path(file).stem}.{name}" if name in registered_parts(self.group) else name

    def __str__(self) -> str:
        return self.label()

    def label(self, run_seed: int | None = None) -> str:
        """The name with the parameters that `changed_parameters` has: ``svm[C=8.0]``."""
        changed = self.changed_parameters(run_seed)
        texts = {k: format_value(v) if isinstance(v, tuple) else v for k, v in changed.items()}
        return _with_brackets(self.short_name, texts)

    def as_argument(self) -> str:
        """The label with the path of a file; `bench.ground.typed.arguments_of_label` reads it."""
        texts = {k: format_value(v) for k, v in self.changed_parameters().items()}
        return _with_brackets(self.name, texts)

    def identity(self) -> tuple:
        """What tells it from other parts: group, name and parameters."""
        if self.instance is None:
            return self.group, self.short_name, self.parameters
        return self.group, self.name, objects.settings_text(self.instance)

    def code(self) -> list[Code]:
        """Modules, classes and functions that it consists of."""
        if self.instance is not None:
            return [*objects.own_code(self.instance)]
        has_steps = set(self.parameters) - set(parameter_defaults(self.factory))
        return [self.factory, "bench.models.recipe"] if has_steps else [self.factory]

    def packages(self) -> tuple[str, ...]:
        """Installed packages that this part alone depends on."""
        if self.instance is None:
            return contract.packages(self.factory)
        return objects.distributions(self.instance)


@dataclass(frozen=True)
class Cell:
    """One combination of data, protocol, features, model, parameters and seed: one tracked run.

    A cell also says what the run measures besides accuracy and costs on captures: circumstances in
    the order of the registry, or a kind of run that does its folds on other data. Their classes are
    in `bench.running.circumstances.base`.

    `untrained_system` and `splitter` stay in this process: another one cannot unpickle the class of
    a user's file.
    """

    data: str
    data_parameters: dict[str, object]  # of the generator
    where: str  # condition on the captures
    target: str  # columns of the class, joined by +
    protocol: Part
    features: Part | None
    model: Part
    tuning: Tuning | None = None
    skin: Part | None = None  # None for the recorded one
    also: str = ""  # corpora that are in every training fold and never tested, joined by +
    circumstances: tuple[Any, ...] = ()
    run_kind: Any = None

    def __getstate__(self) -> dict[str, object]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def parts(self) -> list[Part]:
        """Skin and feature set if there are such, protocol, and model."""
        parts = (self.skin, self.protocol, self.features, self.model)
        return [part for part in parts if part]

    @property
    def extensions(self) -> list[Any]:
        """The kind of run, or else the circumstances."""
        return [self.run_kind] if self.run_kind else [*self.circumstances]

    @property
    def kind(self) -> str:
        """Tag of its run."""
        return self.run_kind.key if self.run_kind else "cell"

    @property
    def command(self) -> str:
        """Name of the command that makes its run."""
        return self.run_kind.key if self.run_kind else "tune" if self.tuning else "run"

    @cached_property
    def untrained_system(self) -> contract.System:
        """The system before training, built once and never fitted."""
        return self.estimator()

    @cached_property
    def splitter(self) -> Splitter:
        """The protocol, built once."""
        return self.protocol.make_object()

    @cached_property
    def design(self) -> Any:
        """The skin (`bench.corpora.skin.Design`), built once; None for the recorded one."""
        return self.skin.make_object() if self.skin else None

    def system_name(self) -> str:
        """Model, feature set, a designed skin and added people, as tables name them."""
        model = str(self.model)
        if self.tuning:
            model = f"tuned {self.model.short_name}[{_describe_search(self.tuning)}]"
        features = self.features.label(self._features_seed) if self.features else ""
        skin = str(self.skin) if self.skin else ""
        also = f"also {self.also}" if self.also else ""
        return " · ".join(filter(None, [model, features, skin, also]))

    def title(self) -> str:
        """System, data and protocol: the name of the run."""
        return f"{self.system_name()} | {self.data} | {self.protocol}"

    @property
    def objects(self) -> list[object]:
        """Parts that are Python objects."""
        return [part.instance for part in self.parts if part.instance is not None]

    @property
    def seed(self) -> int | None:
        """Seed of the search, of the model, or else of the feature set; None without randomness."""
        parts: list[Mapping[str, object]] = [self.tuning] if self.tuning else []
        parts = parts or [part.parameters for part in (self.model, self.features) if part]
        seed = next((each["seed"] for each in parts if "seed" in each), None)
        return seed if isinstance(seed, int) else None

    @property
    def _features_seed(self) -> int | None:
        """Default seed of the feature set: that of the run, unless a search has it."""
        return None if self.tuning else self.seed

    def estimator(self) -> contract.System:
        """A new untrained scikit-learn classifier."""
        features = self.features.make_object() if self.features else None
        if self.tuning:
            from bench.models.search.tuning import make_search

            sets = {self.features.short_name: features} if self.features else None
            return make_search(
                self.model.short_name, self.model.factory, sets, str(self.features), self.tuning
            )
        if self.model.instance is not None:
            return contract.as_pipeline(self.model.make_object(), features)
        if self.model.parameters.keys() <= parameter_defaults(self.model.factory).keys():
            return contract.build_system(self.model.factory, features, **self.model.parameters)
        from bench.models import recipe

        return recipe.build_recipe(self.model.factory, features, **self.model.parameters)

    def feature_sets(self) -> dict[str, contract.Features]:
        """New feature sets of the system, by name; none for one that reads raw frames."""
        if self.features:
            return {self.features.label(self._features_seed): self.features.make_object()}
        inside = contract.feature_sets(self.untrained_system)
        return {name: contract.untrained_copy(features) for name, features in inside.items()}

    def identity(self) -> dict[str, object]:
        """What its results depend on besides the captures: parts, parameters, code, versions."""
        faults = []
        if trained := contract.trained_faults(self.untrained_system):
            from bench.corpora.faults import FAULTS

            faults = [FAULTS[name] for name in trained]
        code: list[Code] = ["bench.running.evaluation", *(fault.damage for fault in faults)]
        code += ["bench.models.search.tuning"] if self.tuning else []
        for each in (*self.parts, *self.extensions):
            code += each.code()
        return {
            "target": self.target,
            "tuning": repr(self.tuning),
            "parts": [part.identity() for part in self.parts],
            "measured": [(each.key, each.identity()) for each in self.extensions],
            "faults": [(f.name, f.amounts) for f in faults],  # they may come from other packages
            "code": source_digest(*code),
            "versions": package_versions(self.model.packages()),
        }

    def arguments(self) -> dict[str, str]:
        """The typed arguments that make this cell, without defaults."""
        values = {"data": self.data}
        if self.data_parameters:
            defaults = generator_defaults()
            changed = {k: v for k, v in self.data_parameters.items() if v != defaults[k]}
            values |= _dotted_arguments("data", changed)
        if self.where:
            values["where"] = self.where
        if self.target != DEFAULTS["target"]:
            values["target"] = self.target
        if self.also:
            values["also"] = self.also
        parts = {"skin": self.skin, "protocol": self.protocol}
        parts |= {"model": self.model, "features": self.features}
        for key, part in parts.items():
            if part:
                seed = self._features_seed if key == "features" else None
                values |= {key: part.name} if (key, part.name) != ("skin", DEFAULTS["skin"]) else {}
                values |= _dotted_arguments(key, part.changed_parameters(seed))
        if self.tuning:
            search: dict[str, Any] = dict(self.tuning)
            lists = {k: v for k, v in search["space"].items() if isinstance(v, list)}
            texts = {k: ",".join(map(format_value, v)) for k, v in lists.items()}
            values |= _dotted_arguments("model", texts)
            keys = ("smallest", "inner") if "smallest" in search else SEARCH_KEYS
            values |= {key: format_value(search[key]) for key in keys if key in search}
        if self.seed:
            values["seed"] = str(self.seed)
        for each in self.extensions:
            values |= each.typed_arguments()
        return values


def _with_brackets(name: str, parameters: Mapping[str, object]) -> str:
    """A name with its parameters in brackets, if it has some."""
    words = ", ".join(f"{key}={value}" for key, value in parameters.items())
    return f"{name}[{words}]" if words else name


def _dotted_arguments(key: str, parameters: Mapping[str, object]) -> dict[str, str]:
    """Parameters of a part as they are typed."""
    return {f"{key}.{name}": format_value(value) for name, value in parameters.items()}


def _describe_search(tuning: Tuning) -> str:
    """What a search tries, and how: ``C, gamma=0.1|1, inner=loso``."""
    lists = {k: v for k, v in tuning["space"].items() if isinstance(v, list)}
    words = [f"{k}={'|'.join(map(str, lists[k]))}" if k in lists else k for k in tuning["space"]]
    how = {k: v for k, v in tuning.items() if k not in ("space", "seed", "objective")}
    return ", ".join([*words, *(f"{k}={v}" for k, v in how.items())])


def generator_defaults() -> dict[str, Any]:
    """Parameters of the generator with their defaults.

    The generator imports scipy.signal, which recorded captures do not need.
    """
    from bench.corpora.synth import generate

    return parameter_defaults(generate)
