"""Arguments as a list of cells: one cell is one tracked run. Making the list loads no data."""

from __future__ import annotations

import hashlib
import inspect
import itertools
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import contract
from bench.errors import InputError, nearest
from bench.features.base import OfFunction
from bench.ground.registry import (
    load_part,
    parameter_defaults,
    registered_parts,
    required_parameters,
)
from bench.ground.source import package_versions, source_digest
from bench.ground.words import (
    DEFAULTS,
    PART_GROUPS,
    Values,
    format_value,
    parse_value,
    split_values,
)
from bench.plan import objects

if TYPE_CHECKING:
    from bench.ground.source import Code
    from bench.models.space import Tuning
    from bench.plan.splits import Splitter

SEARCH_KEYS = ("inner", "trials", "seconds")  # of a search, as it is typed


@dataclass(frozen=True)
class Part:
    """A protocol, feature set or model, with every parameter it takes."""

    room: str  # a group of entry points, or a package that lists its parts
    name: str  # registered name or ``file.py:Name``; for an object, its displayed text
    parameters: dict[str, object] = field(default_factory=dict, hash=False)
    instance: Any = field(default=None, hash=False)  # object from Python, if there is one
    module: str = field(
        default="", hash=False, repr=False
    )  # name of its file's module, another for each state of it

    @property
    def factory(self) -> Callable:
        """The class or function behind the name; its file must be what it was when the command began."""
        factory = load_part(self.room, self.name)
        if self.module and factory.__module__ != self.module:
            raise InputError(
                f"{self.name}: the file was changed while it was in use; start the command again"
            )
        return factory

    def make(self) -> Any:
        """Build one that takes nothing from the harness: a protocol or a feature set."""
        if self.instance is not None:
            return contract.copied(self.instance)
        if needed := required_parameters(self.factory):
            if self.room == "features" and inspect.isfunction(self.factory) and len(needed) == 1:
                return OfFunction(self.factory, self.parameters)
            raise InputError(f"{self.name}: the argument {needed[0]} has no default; give it one")
        return self.factory(**self.parameters)

    def changed_parameters(self, seed: int | None = None) -> dict[str, object]:
        """Parameters that are not the default; that of ``seed`` may be another one, and of a model is the run's."""
        if self.instance is not None:
            return (
                constructor_arguments(self.instance)
                if self.name == type(self.instance).__name__
                else {}
            )
        own = self.parameters.get("seed", seed) if self.room == "models" else seed
        usual = parameter_defaults(self.factory) | ({} if own is None else {"seed": own})
        return {k: v for k, v in self.parameters.items() if k not in usual or v != usual[k]}

    @property
    def short_name(self) -> str:
        """The name without a file's path; with the file's name if it is also that of a built-in part."""
        file, _, name = self.name.rpartition(":")
        if self.instance is not None or not file:
            return self.name
        return f"{Path(file).stem}.{name}" if name in registered_parts(self.room) else name

    def __str__(self) -> str:
        return self.label()

    def label(self, seed: int | None = None) -> str:
        """The name with those parameters that are not the default (`changed_parameters`): ``svm[C=8.0]``."""
        texts = {
            k: format_value(v) if isinstance(v, tuple) else v
            for k, v in self.changed_parameters(seed).items()
        }
        return _with_brackets(self.short_name, texts)

    def as_argument(self) -> str:
        """The same with the full name of a file, as `bench.ground.words.arguments_of_label` reads it."""
        return _with_brackets(
            self.name, {k: format_value(v) for k, v in self.changed_parameters().items()}
        )

    def identity(self) -> tuple:
        """Identity of a part: name and parameters."""
        if self.instance is None:
            return self.room, self.short_name, self.parameters
        return self.room, self.name, objects.settings_text(self.instance)

    def code(self) -> list[Code]:
        """Modules, classes and functions that it consists of."""
        if self.instance is not None:
            return [*objects.own_code(self.instance)]
        beyond = set(self.parameters) - set(parameter_defaults(self.factory))
        return [self.factory, *(["bench.models.recipe"] if beyond else [])]

    def packages(self) -> tuple[str, ...]:
        """Packages that this part alone depends on."""
        return (
            contract.packages(self.factory)
            if self.instance is None
            else objects.distributions(self.instance)
        )


@dataclass(frozen=True)
class Cell:
    """A combination of data, protocol, features, model, parameters and seed, and what is measured of it.

    What is built of it and kept (`untrained`, `splitter`) stays in this process: a class of the user's file cannot be
    unpickled in another one.
    """

    data: str
    data_parameters: dict[str, object]
    where: str
    target: str
    protocol: Part
    features: Part | None
    model: Part
    tuning: Tuning | None = None
    circumstances: tuple[
        Any, ...
    ] = ()  # `bench.running.circumstances.base.Circumstance`, in the order of the registry
    study: Any = None  # a `bench.running.circumstances.base.Study`, which does the folds of runs on other data

    def __getstate__(self) -> dict[str, object]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def parts(self) -> list[Part]:
        """Protocol, feature set if there is one, and model."""
        return [part for part in (self.protocol, self.features, self.model) if part]

    @property
    def measurements(self) -> list[Any]:
        """What is measured besides the accuracy and costs of captures."""
        return [self.study] if self.study else [*self.circumstances]

    @property
    def kind(self) -> str:
        """Tag of its runs."""
        return self.study.key if self.study else "cell"

    @property
    def command(self) -> str:
        """The command that makes its run."""
        return self.study.key if self.study else "tune" if self.tuning else "run"

    @cached_property
    def untrained(self) -> contract.System:
        """The system before training, built once and never fitted."""
        return self.estimator()

    @cached_property
    def splitter(self) -> Splitter:
        """The protocol, built once."""
        return self.protocol.make()

    def system(self) -> str:
        """Model and feature set as they are named in tables."""
        model = (
            f"tuned {self.model.short_name}[{_describe_search(self.tuning)}]"
            if self.tuning
            else str(self.model)
        )
        return f"{model} · {self.features.label(self._features_seed)}" if self.features else model

    def title(self) -> str:
        """System, data and protocol: the name of the run."""
        return f"{self.system()} | {self.data} | {self.protocol}"

    @property
    def objects(self) -> list[object]:
        """Parts that are Python objects."""
        return [part.instance for part in self.parts if part.instance is not None]

    @property
    def seed(self) -> int | None:
        """Seed of the search, of the model, or else of the feature set; None without randomness."""
        parts = (
            [self.tuning]
            if self.tuning
            else [part.parameters for part in (self.model, self.features) if part]
        )
        seed = next((each["seed"] for each in parts if "seed" in each), None)
        return seed if isinstance(seed, int) else None

    @property
    def _features_seed(self) -> int | None:
        """The default of the seed of the feature set: that of the run; a search has its own."""
        return None if self.tuning else self.seed

    def estimator(self) -> contract.System:
        """A new untrained scikit-learn classifier."""
        features = self.features.make() if self.features else None
        if self.tuning:
            from bench.models.search.tuning import tuned

            sets = {self.features.short_name: features} if self.features else None
            return tuned(
                self.model.short_name, self.model.factory, sets, str(self.features), self.tuning
            )
        if self.model.instance is not None:
            return contract.behind(self.model.make(), features)
        if self.model.parameters.keys() <= parameter_defaults(self.model.factory).keys():
            return contract.build(self.model.factory, features, **self.model.parameters)
        from bench.models import recipe

        return recipe.build(self.model.factory, features, **self.model.parameters)

    def feature_sets(self) -> dict[str, contract.Features]:
        """New feature sets as the system uses them, by name; none for one that reads raw frames."""
        if self.features:
            return {self.features.label(self._features_seed): self.features.make()}
        return {
            name: contract.copied(part) for name, part in contract.features(self.untrained).items()
        }

    def identity(self) -> dict[str, object]:
        """Identity of its results, besides the captures: selection, parts with parameters, code, versions."""
        made = []
        if trained := contract.trained_faults(self.untrained):
            from bench.corpora.faults import all_faults

            made = [all_faults()[name] for name in trained]
        code = [
            *(c for one in (*self.parts, *self.measurements) for c in one.code()),
            *(f.damage for f in made),
        ]
        code += [
            "bench.running.evaluation",
            *(["bench.models.search.tuning"] if self.tuning else []),
        ]
        return {
            "target": self.target,
            "tuning": repr(self.tuning),
            "parts": [part.identity() for part in self.parts],
            "measured": [(one.key, one.identity()) for one in self.measurements],
            "faults": [(f.name, f.amounts) for f in made],  # they may come from other packages
            "code": source_digest(*code),
            "versions": package_versions(self.model.packages()),
        }

    def arguments(self) -> dict[str, str]:
        """The arguments that make this cell, as typed; defaults are left out."""
        values = {"data": self.data}
        if self.data_parameters:
            usual = _generator_parameters()
            values |= {
                f"data.{k}": format_value(v)
                for k, v in self.data_parameters.items()
                if v != usual[k]
            }
        values |= {"where": self.where} if self.where else {}
        values |= {"target": self.target} if self.target != DEFAULTS["target"] else {}
        for key, part in (
            ("protocol", self.protocol),
            ("model", self.model),
            ("features", self.features),
        ):
            if part:
                changed = part.changed_parameters(
                    self._features_seed if key == "features" else None
                )
                values |= {key: part.name} | {
                    f"{key}.{k}": format_value(v) for k, v in changed.items()
                }
        if self.tuning:
            lists = {k: v for k, v in self.tuning["space"].items() if isinstance(v, list)}
            values |= {f"model.{k}": ",".join(map(format_value, v)) for k, v in lists.items()}
            how = dict(self.tuning)
            values |= {
                k: format_value(how[k])
                for k in (("smallest", "inner") if "smallest" in how else SEARCH_KEYS)
                if k in how
            }
        values |= {"seed": str(self.seed)} if self.seed else {}
        return values | {
            key: text for one in self.measurements for key, text in one.arguments().items()
        }


def _with_brackets(name: str, changed: dict[str, object]) -> str:
    """A name with parameters."""
    words = ", ".join(f"{k}={v}" for k, v in changed.items())
    return f"{name}[{words}]" if words else name


def constructor_arguments(made: object) -> dict[str, object]:
    """What an object was made with, where it keeps that under the same names and it is not the default."""
    names, usual = inspect.signature(type(made)).parameters, parameter_defaults(type(made))
    kept = {name: value for name, value in vars(made).items() if name in names}
    return {k: _as_label(v) for k, v in kept.items() if k not in usual or repr(v) != repr(usual[k])}


def _as_label(value: object) -> object:
    """A value in a label: a number or a name as it is, of anything else a digest."""
    if value is None or isinstance(value, int | float | str):
        return value
    with np.printoptions(threshold=sys.maxsize):
        return hashlib.sha256(repr(value).encode()).hexdigest()[:8]


def _describe_search(tuning: Tuning) -> str:
    """What a search tries and how, in a few words: ``C, gamma=0.1|1, inner=loso``."""
    values = {k: v if isinstance(v, list) else None for k, v in tuning["space"].items()}
    words = [k if v is None else f"{k}=" + "|".join(map(str, v)) for k, v in values.items()]
    return ", ".join(
        [
            *words,
            *(f"{k}={v}" for k, v in tuning.items() if k not in ("space", "seed", "objective")),
        ]
    )


def make_cells(values: Values) -> list[Cell]:
    """The cross product of all listed values, without repetitions."""
    chosen = {key: split_values(key, values.get(key, default)) for key, default in DEFAULTS.items()}
    feature_sets = chosen["features"]
    takes = [_takes_features(model) for model in chosen["model"]]
    if "features" in values and not any(takes):
        models = ", ".join(map(str, chosen["model"]))
        raise InputError(
            f"features={values['features']} has no effect: {models} uses no feature set; leave features= out"
        )
    systems = [
        (model, seed, features)
        for model, takes_features in zip(chosen["model"], takes, strict=True)
        for seed in (parse_value("seed", s, 0) for s in chosen["seed"])
        for features in (feature_sets if takes_features else [None])
    ]
    distinct: dict[str, Cell] = {}
    above = (chosen[key] for key in ("data", "where", "target", "protocol"))
    for data, where, target, protocol, (model, seed, features) in itertools.product(
        *above, systems
    ):
        parts: list[Any]
        for data_parameters, *parts in itertools.product(
            expand_corpus_parameters(values, data, chosen["data"]),
            expand_parameters(values, "protocol", protocol, chosen["protocol"]),
            expand_parameters(values, "features", features, feature_sets, seed)
            if features is not None
            else [None],
            expand_parameters(values, "model", model, chosen["model"], seed),
        ):
            cell = Cell(data, data_parameters, where, target, *parts)
            distinct.setdefault(f"{cell!r} {[*map(id, cell.objects)]}", cell)
    return [*distinct.values()]


def _takes_features(model: object) -> bool:
    """Whether a model is handed a feature set: its factory asks for one, or it learns from tables."""
    if not isinstance(model, str):
        return contract.reads_tables(model)
    factory = load_part("models", model)
    if len(needed := required_parameters(factory)) > 1:
        several = ", ".join(needed)
        raise InputError(
            f"model={model}: {several} have no default; only the feature set may have none"
        )
    return bool(needed) or contract.reads_tables(factory)


def expand_parameters(
    values: Values, key: str, part: object, siblings: list, seed: int | None = None, room: str = ""
) -> list[Part]:
    """One part, a name or an object, with every combination of its dotted parameters.

    In a grid of several parts (``siblings``), a parameter is for those that take it; a part without a seed has none.
    """
    room = room or PART_GROUPS[key]
    dotted = _dotted_parameters(values, key)
    names = [sibling for sibling in siblings if isinstance(sibling, str)]
    if dotted:
        _refuse_unknown(
            f"{key}={part}",
            dotted,
            {p for name in names for p in _accepted_parameters(key, load_part(room, name))},
        )
    if not isinstance(part, str):
        method = "split" if key == "protocol" else "fit"
        if inspect.isclass(part) or not callable(getattr(part, method, None)):
            kind = getattr(part, "__name__", type(part).__name__)
            raise InputError(
                f"{key}={kind}: give a name, or an object with {method}(), such as {kind}()"
            )
        return [Part(room, objects.display_name(part), instance=part)]
    factory, module = load_part(room, part), ""
    if (file := part.rpartition(":")[0]).endswith(".py"):  # from wherever a worker is started
        part, module = f"{Path(file).absolute()}:{part.rpartition(':')[2]}", factory.__module__
    usual = parameter_defaults(factory)
    defaults = _accepted_parameters(key, factory) if dotted else usual
    if seed is not None and "seed" in usual:
        usual["seed"] = seed
    each = _combine_values(key, {p: text for p, text in dotted.items() if p in defaults}, defaults)
    # A step that any model can have is a parameter of one that has it, and not of the others.
    taken = ({p: v for p, v in chosen.items() if p in usual or v != defaults[p]} for chosen in each)
    return [Part(room, part, usual | own, module=module) for own in taken]


def _dotted_parameters(values: Values, key: str) -> dict[str, object]:
    """The values of ``key.parameter=``, by parameter."""
    return {k.partition(".")[2]: v for k, v in values.items() if k.startswith(f"{key}.")}


def _accepted_parameters(key: str, factory: Callable) -> dict[str, object]:
    """Parameters that may be typed for a part: its own and, of a model, the steps that any model can have."""
    if key != "model":
        return parameter_defaults(factory)
    from bench.models import recipe

    return parameter_defaults(factory) | recipe.besides(factory)


def _refuse_unknown(part: str, dotted: Iterable[str], accepted: Collection[str]) -> None:
    """Refuse a parameter that the part, such as ``model=svm``, does not have."""
    for parameter in dotted:
        if parameter not in accepted:
            raise InputError(
                f"{part} has no parameter {parameter!r}; {nearest(parameter, accepted)}"
            )


def _combine_values(
    key: str, dotted: dict[str, object], defaults: dict[str, object]
) -> Iterator[dict[str, object]]:
    """Every combination of the listed values, each of the type of its default."""
    lists = [
        [parse_value(f"{key}.{p}", v, defaults[p]) for v in split_values(f"{key}.{p}", text)]
        for p, text in dotted.items()
    ]
    return (
        dict(zip(dotted, combination, strict=True)) for combination in itertools.product(*lists)
    )


def _generator_parameters() -> dict[str, Any]:
    """Parameters of the generator with their defaults; it imports scipy.signal, which recorded captures do not need."""
    from bench.corpora.synth import generate

    return parameter_defaults(generate)


def expand_corpus_parameters(
    values: Values, data: str, siblings: list[str]
) -> list[dict[str, object]]:
    """Parameters of the generator; an imported corpus has none."""
    dotted = _dotted_parameters(values, "data")
    if "synth" not in siblings and dotted:
        raise InputError(
            f"data.{next(iter(dotted))}: only data=synth has parameters; choose captures with where="
        )
    if not isinstance(data, str):
        raise InputError("data= takes the name of a corpus, such as data='synth'; see bench data")
    if data != "synth":
        return [{}]
    _refuse_unknown("data=synth", dotted, defaults := _generator_parameters())
    return [defaults | chosen for chosen in _combine_values("data", dotted, defaults)]
