"""The grammar of the command line: commands, the keys that several share, and words ``key=value`` read by them.

Each command stands in a file of `bench.commands`. Parsing, ``--help`` and the Python API read these values. Nothing
heavy is imported, so that help comes at once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.errors import InputError, suggest_names
from bench.ground.registry import import_object, load_part, load_parts, registered_parts
from bench.ground.typed import DEFAULTS, Values, parse_option, parse_value
from bench.ground.typed import Option as Option
from bench.values.measures import all_costs, costs_by_budget

LOCAL_EXECUTOR = "bench.running.workers:local_executor"  # by name: this room lies below it
START, COMPARE, SHIP, MORE = "start here", "compare", "ship", "more"  # groups of the overview


@dataclass(frozen=True)
class Command:
    """A command."""

    group: str  # heading in the overview
    summary: str  # line in the overview
    text: str  # a paragraph
    examples: str = ""  # lines that can be typed
    usage: str = "[key=value ...]"  # arguments behind its name; a line for each form
    takes_words: bool = False  # words may stand before its keys: its function parses all arguments
    options: tuple[Option, ...] = ()  # its keys; packages and circumstances add others
    budgets: str = ""  # budgets that are keys, too: ``all``, or only budgets of ``captures``
    module: str = (
        ""  # module of a package's command, with a function of its name that takes the arguments
    )
    # lines to type next after other commands, with ``{}`` for the saved model, of a package's command
    follows: Mapping[str, str] = field(default_factory=dict)
    unfit: str = (
        ""  # function of ``module`` that says why a saved system cannot be used; empty if it can
    )
    makes: str = ""  # key of the circumstance or study that a command which makes runs shows; ``run`` for captures


def _run_option(key: str, help: str) -> Option:
    return Option(key, "text", DEFAULTS[key], help)


DATA = _run_option("data", "synth (generated captures) or an imported corpus, several joined by +")
WHERE = _run_option("where", "captures to use, such as where=\"variant == 'rough'\"")
TARGET = _run_option("target", "columns that define the class, such as gesture+variant")
MODEL = _run_option("model", "{models}; names with a year are published systems")
FEATURES = _run_option("features", "{features}; not used by all models")
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
FIT_OPTIONS = (
    DATA,
    WHERE,
    TARGET,
    MODEL,
    FEATURES,
    SEED,
)  # keys of what is trained on all captures
CELL_OPTIONS = (
    DATA,
    WHERE,
    TARGET,
    _run_option("protocol", "{protocols}"),
    MODEL,
    FEATURES,
)  # keys of what is run
RUN_OPTIONS = (*CELL_OPTIONS, SEED, JOBS)
STORED_OPTIONS = (  # which stored runs are read
    *CELL_OPTIONS,
    Option(
        "run",
        "text",
        "",
        "ids of stored runs, or their first 8 characters, as bench runs lists them",
    ),
    Option("latest", "yes", False, "yes: only the newest parameters of each model and feature set"),
)
RUN_KEYS = {option.key: option for option in RUN_OPTIONS}  # of the cells of bench run
TRUST_NOTE = "Loading a model runs its code: use only models that you or someone you trust saved."


def load_commands() -> dict[str, Command]:
    """All commands by name, in the order of the overview; those of packages last."""
    return {name: one for name, one in load_parts("commands").items() if " " not in name}


def next_of_packages(name: str, model: str, recogniser: Any) -> tuple[list[str], list[str]]:
    """What packages offer to type after a command that has saved or used a model, and why they offer nothing."""
    lines: list[str] = []
    reasons: list[str] = []
    for one in load_commands().values():
        if name in one.follows:
            why = import_object(f"{one.module}:{one.unfit}")(recogniser) if one.unfit else ""
            if why:
                reasons.append(why)
            else:
                lines.append(one.follows[name].format(model))
    return lines, reasons


def run_commands() -> dict[str, Command]:
    """The commands that make runs, by name."""
    return {name: one for name, one in load_commands().items() if one.makes}


def options_of_packages(command: str, among: Collection[str] | None = None) -> dict[str, Option]:
    """The keys that packages add to a command, or to ``makers`` of runs: entry points such as ``makers cluster``."""
    return {
        key: load_part("commands", f"{command} {key}")
        for key in _keys_of_packages(command)
        if among is None or key in among
    }


def _keys_of_packages(command: str) -> list[str]:
    return [
        name.partition(" ")[2]
        for name in registered_parts("commands")
        if name.startswith(f"{command} ")
    ]


def workers_of_packages(command: str) -> dict[str, Any]:
    """What does the work of the keys that packages add to a command, by key."""
    return {
        name: import_object(one.uses)
        for name, one in options_of_packages(command).items()
        if one.uses
    }


def command_options(name: str, typed: Iterable[str] | None = None) -> dict[str, Option]:
    """The keys of a command, of all its actions; circumstances are loaded only if a typed word has another key."""
    command = load_part("commands", name)
    every = {
        option.key: option
        for option in (*((*RUN_OPTIONS, DRY) if command.makes else ()), *command.options)
    }
    heads = None if typed is None else {*map(_key_head, typed)}
    packages = options_of_packages(name, heads) | (
        options_of_packages("makers", heads) if command.makes else {}
    )
    if command.makes and (heads is None or not heads <= {*every, *packages}):
        for one in load_parts("circumstances").values():
            if one.key == command.makes if one.is_run_kind else command.makes == "run":
                every |= one.options_by_key()
        packages = options_of_packages(name) | options_of_packages("makers")
    every |= packages
    if "by" in every:
        every["by"] = replace(every["by"], values=tuple(all_costs()))
    for key, cost in costs_by_budget().items() if command.budgets else ():
        if command.budgets == "all" or "captures" in cost.measured_on:
            every[key] = Option(key, "amount", None, cost.help)
    return every


def key_options(name: str, typed: Iterable[str] | None = None) -> dict[str, Option]:
    """The same without parameters of parts, which have a dot."""
    return {key: option for key, option in command_options(name, typed).items() if "." not in key}


def part_groups() -> dict[str, str]:
    """The rooms of parts, by the key that names them."""
    keys_of_packages = (
        load_part("commands", name) for name in registered_parts("commands") if " " in name
    )
    return {
        option.key: option.part_group
        for option in (*CELL_OPTIONS, *keys_of_packages)
        if option.part_group
    }


def _key_head(word: str) -> str:
    """The key of a word, without the name of a parameter."""
    return word.partition("=")[0].partition(".")[0]


def parse_arguments(arguments: Sequence[str], known: Collection[str] | None) -> dict[str, str]:
    """Split ``key=value`` arguments."""
    values: dict[str, str] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if not equals or not key or not value:
            listed = f"keys: {', '.join(sorted(known))}" if known else "leave it out, or see --help"
            raise InputError(f"{argument!r} is not key=value; {listed}")
        if key in values:
            raise InputError(
                f"{key}= is given twice; give it once, several values as {key}={values[key]},{value}"
            )
        if known is not None:
            _check_key(key, known)
        values[key] = value
    return values


def parse_words(
    arguments: Sequence[str], known: Collection[str], most: int
) -> tuple[list[str], dict[str, str]]:
    """Split arguments of a command that takes words without a key first, such as names of files."""
    words = []
    for argument in arguments[:most]:
        if "=" in argument and argument.partition("=")[0] in known and not Path(argument).is_file():
            break
        words.append(argument)
    return words, parse_arguments(arguments[len(words) :], known)


def values_from_keywords(values: Mapping[str, object], known: Collection[str]) -> dict[str, object]:
    """Keyword arguments as the command line has them; None is the same as not given."""
    typed = {key.replace("__", "."): value for key, value in values.items() if value is not None}
    for key in typed:
        _check_key(key, known)
    return typed


def _check_key(key: str, known: Collection[str]) -> None:
    """Refuse a key that means nothing here."""
    head, dot, _ = key.partition(".")
    if head not in known or (dot and head != "data" and head not in part_groups()):
        raise InputError(f"no key is called {key!r}; {suggest_names(key, known)}")


def typed_settings(command: str, values: Values, listed: Iterable[Option] = ()) -> dict[str, Any]:
    """The options of a command, or of its action, in their types; those that it shares with ``bench run`` aside."""
    shared = (*RUN_OPTIONS, *options_of_packages("makers").values())

    def typed(one: Option) -> Any:
        if (given := values.get(one.key)) is None:
            return one.default
        return (
            costs_by_budget()[one.key].parse_budget(given)
            if one.type == "amount"
            else parse_option(one, given)
        )

    return {
        one.key: typed(one)
        for one in listed or command_options(command).values()
        if one not in shared
    }


def cost_limits(given: Mapping[str, Any]) -> dict[str, float]:
    """The budget of each cost, of the settings of a command."""
    return {
        cost.key: given[key]
        for key, cost in costs_by_budget().items()
        if given.get(key) is not None
    }


def make_executor(values: Values) -> Any:
    """Make the executor of folds, a `bench.running.workers.FoldExecutor`, that the keys ask for."""
    for key, one in options_of_packages("makers", values).items():
        if address := str(values.get(key, "")):
            if "jobs" in values:
                raise InputError(
                    f"jobs={values['jobs']}: {key}= sets the number of workers; leave jobs= out"
                )
            return import_object(one.uses)(address)
    jobs = parse_value("jobs", values["jobs"], 0) if "jobs" in values else None
    return import_object(LOCAL_EXECUTOR)(jobs)


def executor_keys() -> set[str]:
    """Keys that say where folds are done, which changes no result."""
    return {"jobs", *_keys_of_packages("makers")}
