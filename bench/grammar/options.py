"""The grammar of commands: what a command is, shared keys, and how ``key=value`` is read.

`bench.commands.declarations` has the commands. Parsing, ``--help`` and the Python API read them.
Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.errors import InputError, suggest_names
from bench.ground.registry import import_object, load_part, load_parts, registered_parts
from bench.ground.typed import DEFAULTS, Values, expand_home, parse_option, parse_value
from bench.ground.typed import Option as Option
from bench.values.measures import OF_SYSTEMS, all_costs, costs_by_budget

LOCAL_EXECUTOR = (
    "bench.running.workers:local_executor"  # as text: this room must not import `running`
)
START, COMPARE, SHIP, MORE = "start here", "compare", "ship", "more"  # groups of the overview


@dataclass(frozen=True)
class Command:
    """A command: its help and its keys."""

    group: str  # heading in the overview
    summary: str  # line in the overview
    text: str  # a paragraph
    examples: str = ""  # lines that can be typed
    usage: str = "[key=value ...]"  # arguments after its name; a line for each form
    takes_words: bool = False  # its function parses all arguments, as of words before keys
    options: tuple[Option, ...] = ()  # its keys; packages and circumstances add others
    budgets: str = ""  # budgets that are keys too: ``all``, or only those of ``captures``
    # of a package's command: module with a function of its name, which takes the arguments
    module: str = ""
    # of a package's command: lines to type after other commands; ``{}`` is the saved model
    follows: Mapping[str, str] = field(default_factory=dict)
    # function of ``module`` that says why a saved system cannot be used, or "" if it can
    unfit: str = ""
    # if it makes runs: ``run`` for those on captures, or the key of a kind of run
    makes: str = ""


def _run_option(key: str, help: str) -> Option:
    return Option(key, "text", DEFAULTS[key], help)


DATA = _run_option("data", "synth (generated captures) or an imported corpus, several joined by +")
WHERE = _run_option("where", "captures to use, such as where=\"variant == 'rough'\"")
TARGET = _run_option("target", "columns that define the class, such as gesture+variant")
PROTOCOL = _run_option("protocol", "{protocols}")
MODEL = _run_option("model", "{models}; names with a year are published systems")
FEATURES = _run_option("features", "{features}; not used by all models")
SKIN = _run_option(
    "skin",
    "{skins}: a smaller skin than recorded, of grid=, rate_hz=, bits=, range=, curve=, taxels= and "
    "sampling=, such as skin.grid=4x4; bench run skin=design --help explains them",
)
ALSO = _run_option(
    "also",
    "imported corpora, joined by +, whose people are in every training fold and never tested",
)
RECORDED = "recorded"
OF_FILE = Option(  # of commands that use a saved model
    "skin",
    "text",
    "design",
    "recorded: FILE has frames of the skin that the model's design was made of",
    ("design", RECORDED),
)
SEED = Option(
    "seed",
    "count",
    int(DEFAULTS["seed"]),
    "seed of models and feature sets; splits: protocol.seed=",
)
JOBS = Option("jobs", "count", None, "number of worker processes; default one per core")
BATCH = Option(
    "batch", "yes", False, "yes: also systems whose labels depend on other test captures"
)
DRY = Option(
    "dry", "yes", False, "yes: only say which runs are stored and how long the others take"
)
FIT_OPTIONS = (DATA, WHERE, TARGET, ALSO, SKIN, MODEL, FEATURES, SEED)  # of training on all
CELL_OPTIONS = (DATA, WHERE, TARGET, PROTOCOL, MODEL, FEATURES)  # of a run
RUN_OPTIONS = (*CELL_OPTIONS, ALSO, SKIN, SEED, JOBS)
STORED_OPTIONS = (  # that select stored runs
    *CELL_OPTIONS,
    Option(
        "run",
        "text",
        "",
        "ids of stored runs, or their first 8 characters, as bench runs lists them",
    ),
    Option("latest", "yes", False, "yes: only the newest parameters of each model and feature set"),
)
RUN_KEYS = {option.key: option for option in RUN_OPTIONS}
TRUST_NOTE = "Loading a model runs its code: use only models that you or someone you trust saved."


def load_commands() -> dict[str, Command]:
    """All commands by name, in the order of the overview; those of packages last."""
    return {name: part for name, part in load_parts("commands").items() if " " not in name}


def run_commands() -> dict[str, Command]:
    """The commands that make runs, by name."""
    return {name: command for name, command in load_commands().items() if command.makes}


def next_of_packages(name: str, model: str, recogniser: Any) -> tuple[list[str], list[str]]:
    """Commands of packages to type after a command that saved or used a model.

    Returns:
        The commands, and the reasons why others cannot use the model.
    """
    lines: list[str] = []
    reasons: list[str] = []
    for command in load_commands().values():
        if name in command.follows:
            path = f"{command.module}:{command.unfit}"
            reason = import_object(path)(recogniser) if command.unfit else ""
            if reason:
                reasons.append(reason)
            else:
                lines.append(command.follows[name].format(model))
    return lines, reasons


def options_of_packages(command: str, keys: Collection[str] | None = None) -> dict[str, Option]:
    """Options that packages add to a command, or only those among ``keys``.

    An entry point ``makers cluster`` adds ``cluster`` to all commands that make runs.
    """
    added = [key for key in _keys_of_packages(command) if keys is None or key in keys]
    return {key: load_part("commands", f"{command} {key}") for key in added}


def _keys_of_packages(command: str) -> list[str]:
    prefix = f"{command} "
    names = registered_parts("commands")
    return [name.removeprefix(prefix) for name in names if name.startswith(prefix)]


def implementations_of_packages(command: str) -> dict[str, Any]:
    """The classes that implement the options of packages, by key."""
    options = options_of_packages(command)
    return {key: import_object(option.uses) for key, option in options.items() if option.uses}


def command_options(name: str, typed: Iterable[str] | None = None) -> dict[str, Option]:
    """All options of a command by key.

    If typed words are given and their keys are known without circumstances, these are not loaded.
    """
    command = load_part("commands", name)
    own = (*RUN_OPTIONS, DRY, *command.options) if command.makes else command.options
    options = {option.key: option for option in own}
    heads = None if typed is None else {*map(_key_head, typed)}
    added = options_of_packages(name, heads)
    if command.makes:
        added |= options_of_packages("makers", heads)
        if heads is None or not heads <= {*options, *added}:
            for part in load_parts("circumstances").values():
                if command.makes == (part.key if part.is_run_kind else "run"):
                    options |= part.options_by_key()
            added = options_of_packages(name) | options_of_packages("makers")
    options |= added
    if "by" in options:
        known = all_costs() if command.budgets else [cost.key for cost in OF_SYSTEMS]
        options["by"] = replace(options["by"], values=tuple(known))
    for key, cost in costs_by_budget().items() if command.budgets else ():
        if command.budgets == "all" or "captures" in cost.measured_on:
            options[key] = Option(key, "amount", None, cost.help)
    return options


def key_options(name: str, typed: Iterable[str] | None = None) -> dict[str, Option]:
    """Options of a command except parameters of parts, whose keys have a dot."""
    return {key: option for key, option in command_options(name, typed).items() if "." not in key}


def part_groups() -> dict[str, str]:
    """Groups of parts by the keys that name them, with those of packages."""
    names = [name for name in registered_parts("commands") if " " in name]
    options = (*RUN_OPTIONS, *(load_part("commands", name) for name in names))
    return {option.key: option.part_group for option in options if option.part_group}


def _key_head(word: str) -> str:
    """The key of a word, without the name of a parameter."""
    return word.partition("=")[0].partition(".")[0]


def parse_arguments(arguments: Sequence[str], keys: Collection[str] | None) -> dict[str, str]:
    """Split ``key=value`` arguments; an `InputError` for a key that is not among ``keys``."""
    values: dict[str, str] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if not equals or not key or not value:
            advice = f"keys: {', '.join(sorted(keys))}" if keys else "leave it out, or see --help"
            raise InputError(f"{argument!r} is not key=value; {advice}")
        if key in values:
            raise InputError(
                f"{key}= is given twice; give it once, several values as "
                f"{key}={values[key]},{value}"
            )
        if keys is not None:
            _check_key(key, keys)
        values[key] = value
    return values


def parse_words(
    arguments: Sequence[str], keys: Collection[str], limit: int
) -> tuple[list[str], dict[str, str]]:
    """Split arguments into at most ``limit`` words, such as names of files, and key=value."""
    words: list[str] = []
    for argument in arguments[:limit]:
        if "=" in argument and argument.partition("=")[0] in keys and not Path(argument).is_file():
            break
        words.append(argument)
    return words, parse_arguments(arguments[len(words) :], keys)


def values_from_keywords(values: Mapping[str, object], keys: Collection[str]) -> dict[str, object]:
    """Turn keyword arguments into typed values; None is left out.

    Raises:
        InputError: a key is not among ``keys``.
    """
    typed = {key.replace("__", "."): value for key, value in values.items() if value is not None}
    for key, value in typed.items():
        _check_key(key, keys)
        if isinstance(value, str | Path):
            typed[key] = type(value)(expand_home(str(value)))
    return typed


def _check_key(key: str, keys: Collection[str]) -> None:
    head, dot, _ = key.partition(".")
    if head not in keys or (dot and not _has_parameters(head, keys)):
        raise InputError(f"no key is called {key!r}; {suggest_names(key, keys)}")


def _has_parameters(key: str, keys: Collection[str]) -> bool:
    """True for a key with parameters behind a dot; an option whose values are listed has none."""
    if isinstance(keys, Mapping) and key in keys and keys[key].values:
        return False
    return key == "data" or key in part_groups()


def typed_settings(command: str, values: Values, options: Iterable[Option] = ()) -> dict[str, Any]:
    """Values of the options of a command, or of ``options``, in their types, with defaults.

    Options that it shares with ``bench run`` are left out.
    """
    shared = (*RUN_OPTIONS, *options_of_packages("makers").values())
    settings = {}
    for option in options or command_options(command).values():
        if option in shared:
            continue
        value = values.get(option.key)
        if value is None:
            settings[option.key] = option.default
        elif option.type == "amount":
            settings[option.key] = costs_by_budget()[option.key].parse_budget(value)
        else:
            settings[option.key] = parse_option(option, value)
    return settings


def cost_limits(settings: Mapping[str, Any]) -> dict[str, float]:
    """The budget of each cost that settings limit."""
    limits = {cost.key: settings.get(key) for key, cost in costs_by_budget().items()}
    return {key: limit for key, limit in limits.items() if limit is not None}


def make_executor(values: Values) -> Any:
    """Make the executor of folds that the keys request, a `bench.running.workers.FoldExecutor`."""
    for key, option in options_of_packages("makers", values).items():
        if address := str(values.get(key, "")):
            if "jobs" in values:
                raise InputError(
                    f"jobs={values['jobs']}: {key}= sets the number of workers; leave jobs= out"
                )
            return import_object(option.uses)(address)
    jobs = parse_value("jobs", values["jobs"], 0) if "jobs" in values else None
    return import_object(LOCAL_EXECUTOR)(jobs)


def executor_keys() -> set[str]:
    """Keys that select the workers and so change no result."""
    return {"jobs", *_keys_of_packages("makers")}
