"""The commands, and the keys that several of them share; each command stands in a file of `bench.commands`.

Parsing, ``--help`` and the Python API read these values. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from bench.measures import budgets, costs
from bench.option import Option as Option
from bench.registry import classes, imported, names
from bench.words import DEFAULTS, WIDTH

START, COMPARE, SHIP, MORE = "start here", "compare", "ship", "more"  # groups of the overview


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        group: heading in the overview.
        summary: line in the overview.
        text: a paragraph.
        examples: lines that can be typed.
        usage: arguments behind its name; a line for each form.
        options: its keys; packages and circumstances add others.
        budgets: budgets that are keys, too: ``all``, or those of ``captures``.
        module: module of a package's command, with a function of its name that takes the arguments.
        follows: lines to type next after other commands, with ``{}`` for the saved model, of a package's command.
        makes: key of the circumstance or study that a command which makes runs shows; ``run`` for captures.
        keys: its options of circumstances; empty for all, or those of its study.
        given: options that it gives where they are not typed.
        out: folder of ``out=``, with its help; empty if it writes nothing.
    """

    group: str
    summary: str
    text: str
    examples: str = ""
    usage: str = "[key=value ...]"
    options: tuple[Option, ...] = ()
    budgets: str = ""
    module: str = ""
    follows: Mapping[str, str] = field(default_factory=dict)
    makes: str = ""
    keys: tuple[str, ...] = ()
    given: Mapping[str, str] = field(default_factory=dict)
    out: tuple[str, str] = ("", "")


def _usual(key: str, help: str) -> Option:
    return Option(key, "text", DEFAULTS[key], help)


DATA = _usual("data", "synth (generated captures) or an imported corpus, several joined by +")
WHERE = _usual("where", "captures to use, such as where=\"variant == 'rough'\"")
TARGET = _usual("target", "columns that define the class, such as gesture+variant")
MODEL = _usual("model", "{models}; names with a year are published systems")
FEATURES = _usual("features", "{features}; not used by all models")
SEED = Option("seed", "count", int(DEFAULTS["seed"]), "seed of models and feature sets; splits: protocol.seed=")
JOBS = Option("jobs", "count", None, "number of worker processes; default one per core")
BATCH = Option("batch", "yes", False, "yes: also systems whose labels depend on other test captures")
CELL = (DATA, WHERE, TARGET, _usual("protocol", "{protocols}"), MODEL, FEATURES)  # keys of what is run
WORK = (*CELL, SEED, JOBS)
STORED = (  # which stored runs are read
    *CELL,
    Option("run", "text", "", "ids of stored runs, as comparison.csv lists them"),
    Option("latest", "yes", False, "yes: only the newest parameters of each model and feature set"),
)
TRUSTED = "Loading a model runs its code: use only models that you or someone you trust saved."


def commands() -> dict[str, Command]:
    """All commands by name, in the order of the overview; those of packages last."""
    return {name: one for name, one in classes("commands").items() if isinstance(one, Command)}


def following(name: str, model: str) -> list[str]:
    """What commands of packages offer to type after a command that has saved or used a model."""
    return [one.follows[name].format(model) for one in commands().values() if name in one.follows]


def makers() -> dict[str, Command]:
    """The commands that make runs, by name."""
    return {name: one for name, one in commands().items() if one.makes}


def measured(command: Command) -> Iterator[Option]:
    """The options of circumstances, or of a study, in a command; by the names of this command."""
    every = classes("circumstances").values()
    mine = [c for c in every if c.key == command.makes and c.study] or [c for c in every if not c.study]
    fields = {name: one for c in mine for name, one in c.fields().items()}
    for key in command.keys or fields:
        option, alias = fields[key]
        name = alias if alias and command.makes != "run" else key
        yield replace(option, key=name, default=command.given.get(name, option.default))
    if command.out[0]:
        yield Option("out", "text", *command.out)


def added_keys(command: str = "") -> dict[str, Option]:
    """The keys that packages add to a command, or to any, by name."""
    every = {one.key: one for one in classes("commands").values() if isinstance(one, Option)}
    makes = {"makers"} if command in makers() else set()
    return {name: one for name, one in every.items() if not command or {command, *makes} & {*one.commands.split()}}


def used(command: str) -> dict[str, Any]:
    """What does the work of the keys that packages add to a command, by key."""
    return {name: imported(one.uses) for name, one in added_keys(command).items() if one.uses}


def options(name: str) -> dict[str, Option]:
    """The keys of a command; those of all its actions for one that has some."""
    command = commands()[name]
    every = {option.key: option for option in (*(WORK if command.makes else ()), *command.options)}
    every |= {option.key: option for option in (measured(command) if command.makes else ())}
    every |= added_keys(name)
    if "by" in every:
        every["by"] = replace(every["by"], values=tuple(costs()))
    for key, cost in budgets().items() if command.budgets else ():
        if command.budgets == "all" or "captures" in cost.on:
            every[key] = Option(key, "amount", None, cost.help)
    return every


def keys(name: str) -> set[str]:
    """Keys that a command takes, without parameters of parts, which have a dot."""
    return {key for key in options(name) if "." not in key}


def rooms() -> dict[str, str]:
    """The rooms of parts, by the key that names them."""
    made = (option for maker in makers().values() for option in measured(maker))
    return {option.key: option.room for option in (*CELL, *added_keys().values(), *made) if option.room}


def overview() -> str:
    """The commands to begin with, each with its summary, and the names of the others."""
    groups: dict[str, list[str]] = {}
    every = commands()
    for name, command in every.items():
        groups.setdefault(command.group, []).append(name)
    members = groups.pop(START)
    lines = ["bench: which recogniser of touch gestures should I ship?", "", f"{START}:"]
    lines += [f"  bench {name:10}{every[name].summary}" for name in members]
    lines += ["", "other commands:"]
    lines += [f"  {group:16}{', '.join(names)}" for group, names in groups.items()]
    return "\n".join([*lines, "", "bench COMMAND --help explains a command and lists its options."])


def help_of(name: str) -> str:
    """The help of a command: usage, a paragraph, its own keys, those that it shares with ``bench run``, examples."""
    command, table = commands()[name], options(name)
    shared = [key for key, option in table.items() if name != "run" and (option in WORK or "makers" in option.commands)]
    rows = [_row(option) for key, option in table.items() if key not in shared]
    if shared:
        rows.append(f"  {' '.join(f'{key}=' for key in shared)}   as for bench run")
    usage = "\n".join(f"bench {name} {form}".rstrip() for form in command.usage.split("\n"))
    paragraph, examples = (
        textwrap.fill(command.text, WIDTH, break_on_hyphens=False),
        textwrap.indent(command.examples, "  "),
    )
    return "\n\n".join(filter(None, [usage, paragraph, "\n".join(rows), examples])) + "\n"


def _row(option: Option) -> str:
    """A key with its help, values and default."""
    text = option.help
    if option.room:
        text = text.replace(f"{{{option.room}}}", ", ".join(names(option.room)))
    if len(option.values) > 1:
        text += f": {(', ' if option.joint == ',' else option.joint).join(option.values)}"
    if option.type != "yes" and option.default not in (None, "", 0, ()):
        text += f"; default {option.default:g}" if option.type == "number" else f"; default {option.default}"
    return textwrap.fill(
        text, WIDTH, break_on_hyphens=False, initial_indent=f"  {option.key + '= ':16}", subsequent_indent=" " * 18
    )
