"""The cells of typed values: every combination of the listed ones. Making them loads no data."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any

from bench import contract
from bench.errors import InputError, suggest_names
from bench.ground.registry import PART_GROUPS, load_part, parameter_defaults, required_parameters
from bench.ground.typed import DEFAULTS, Values, parse_value, split_values
from bench.plan import objects
from bench.plan.cells import Cell, Part, generator_defaults


def make_cells(values: Values) -> list[Cell]:
    """Make a cell for each combination of the listed values, without repetitions."""
    listed = {key: split_values(key, values.get(key, default)) for key, default in DEFAULTS.items()}
    models, feature_sets = listed["model"], listed["features"]
    take_features = [_takes_features(model) for model in models]
    if "features" in values and not any(take_features):
        raise InputError(
            f"features={values['features']} has no effect: {', '.join(map(str, models))} uses no "
            "feature set; leave features= out"
        )
    seeds = [parse_value("seed", text, 0) for text in listed["seed"]]
    systems: list[tuple[list[Any], list[Any]]] = []
    for (model, takes), seed in itertools.product(zip(models, take_features, strict=True), seeds):
        variants = make_part_variants(values, "model", model, models, seed)
        for features in feature_sets if takes else []:
            sets = make_part_variants(values, "features", features, feature_sets, seed)
            systems.append((sets, variants))
        if not takes:
            systems.append(([None], variants))
    skins = make_skins(values)
    cells: dict[str, Cell] = {}
    for data, where, target, also, protocol in itertools.product(
        *(listed[key] for key in ("data", "where", "target", "also", "protocol"))
    ):
        added = "" if also == DEFAULTS["also"] else also
        corpora = expand_corpus_parameters(values, data, listed["data"])
        protocols = make_part_variants(values, "protocol", protocol, listed["protocol"])
        for sets, variants in systems:
            for combination in itertools.product(corpora, skins, protocols, sets, variants):
                data_parameters, skin, protocol_part, features_part, model_part = combination
                parts = protocol_part, features_part, model_part
                cell = Cell(data, data_parameters, where, target, *parts, skin=skin, also=added)
                cells.setdefault(f"{cell!r} {[*map(id, cell.objects)]}", cell)
    return [*cells.values()]


def make_skins(values: Values) -> list[Part | None]:
    """The skins of typed values; None for the recorded one, of which nothing is loaded."""
    if not any(key.partition(".")[0] == "skin" for key in values):
        return [None]
    names = split_values("skin", values.get("skin", DEFAULTS["skin"]))
    variants = [make_part_variants(values, "skin", name, names, group="skins") for name in names]
    parts = itertools.chain.from_iterable(variants)
    return [p if p.changed_parameters() or p.name != DEFAULTS["skin"] else None for p in parts]


def _takes_features(model: object) -> bool:
    """True if a model takes a feature set: as an argument of its factory, or as its table."""
    if not isinstance(model, str):
        return contract.reads_tables(model)
    factory = load_part("models", model)
    needed = required_parameters(factory)
    if len(needed) > 1:
        raise InputError(
            f"model={model}: {', '.join(needed)} have no default; only the feature set may have "
            "none"
        )
    return bool(needed) or contract.reads_tables(factory)


def make_part_variants(
    values: Values, key: str, part: object, siblings: list, seed: int | None = None, group: str = ""
) -> list[Part]:
    """Make a part with every combination of its dotted parameters.

    Args:
        values: typed values.
        key: the key that names the part, such as ``model``.
        part: a name, or an object.
        siblings: all parts of the key. A parameter is for those that take it.
        seed: that of the run, for a part that takes one.
        group: where the part is registered, if the key does not say it.
    """
    group = group or PART_GROUPS[key]
    dotted = _dotted_parameters(values, key)
    if dotted:
        factories = [load_part(group, name) for name in siblings if isinstance(name, str)]
        known = {name for factory in factories for name in accepted_parameters(key, factory)}
        refuse_unknown(f"{key}={part}", dotted, known)
    if not isinstance(part, str):
        return [_part_of_object(key, group, part)]
    factory, module = load_part(group, part), ""
    file, _, name = part.rpartition(":")
    if file.endswith(".py"):  # workers may start in another folder
        part, module = f"{Path(file).absolute()}:{name}", factory.__module__
    defaults = parameter_defaults(factory)
    accepted = accepted_parameters(key, factory) if dotted else defaults
    if seed is not None and "seed" in defaults:
        defaults["seed"] = seed
    texts = {name: text for name, text in dotted.items() if name in accepted}
    parts = []
    parse = Part(group, part, module=module).parse
    for chosen in _combine_values(key, texts, accepted, parse):
        # A step that any model may have is a parameter only where it does something.
        changed = {k: v for k, v in chosen.items() if k in defaults or v != accepted[k]}
        parts.append(Part(group, part, defaults | changed, module=module))
    return parts


def _part_of_object(key: str, group: str, instance: object) -> Part:
    """The part of an object from Python."""
    method = "split" if key == "protocol" else "fit"
    if inspect.isclass(instance) or not callable(getattr(instance, method, None)):
        kind = getattr(instance, "__name__", type(instance).__name__)
        raise InputError(
            f"{key}={kind}: give a name, or an object with {method}(), such as {kind}()"
        )
    return Part(group, objects.display_name(instance), instance=instance)


def _dotted_parameters(values: Values, key: str) -> dict[str, object]:
    """The values of ``key.parameter=``, by parameter."""
    return {k.partition(".")[2]: v for k, v in values.items() if k.startswith(f"{key}.")}


def accepted_parameters(key: str, factory: Callable) -> dict[str, object]:
    """Parameters that may be typed for a part, with defaults: its own, and steps of a model."""
    if key != "model":
        return parameter_defaults(factory)
    from bench.models.recipe import recipe_defaults

    return parameter_defaults(factory) | recipe_defaults(factory)


def refuse_unknown(part: str, names: Iterable[str], accepted: Collection[str]) -> None:
    """Refuse a parameter that a part, such as ``model=svm``, does not have."""
    for name in names:
        if name not in accepted:
            raise InputError(f"{part} has no parameter {name!r}; {suggest_names(name, accepted)}")


def _combine_values(
    key: str,
    texts: dict[str, object],
    defaults: dict[str, object],
    parse: Callable[[str, object, object], Any] = parse_value,
) -> list[dict[str, object]]:
    """Combine the listed values of parameters, each of the type of its default."""
    lists = []
    for name, text in texts.items():
        dotted = f"{key}.{name}"
        lists.append([parse(dotted, each, defaults[name]) for each in split_values(dotted, text)])
    return [dict(zip(texts, combination, strict=True)) for combination in itertools.product(*lists)]


def expand_corpus_parameters(
    values: Values, data: str, siblings: list[str]
) -> list[dict[str, object]]:
    """Combine the parameters of the generator; an imported corpus has none."""
    dotted = _dotted_parameters(values, "data")
    if "synth" not in siblings and dotted:
        first = next(iter(dotted))
        raise InputError(
            f"data.{first}: only data=synth has parameters; choose captures with where="
        )
    if not isinstance(data, str):
        raise InputError("data= takes the name of a corpus, such as data='synth'; see bench data")
    if data != "synth":
        return [{}]
    defaults = generator_defaults()
    refuse_unknown("data=synth", dotted, defaults)
    return [defaults | chosen for chosen in _combine_values("data", dotted, defaults)]
