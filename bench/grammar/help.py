"""Help: the commands and their keys; parts and their parameters with default, meaning and origin of the default.

Parts are described by docstrings and signatures, so that help and captions cannot differ.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from bench.grammar.options import (
    RUN_OPTIONS,
    START,
    command_options,
    load_commands,
    options_of_packages,
)
from bench.ground.registry import (
    load_part,
    parameter_defaults,
    registered_parts,
    required_parameters,
)
from bench.ground.typed import Option, format_value, split_values

WIDTH = 100  # columns of help
SECTION = re.compile(r"^(Args|Attributes|Raises|Returns):$", re.MULTILINE)
ENTRY = re.compile(r"^ {4}(\w[\w, ]*):\s+(.*(?:\n {8}.*)*)", re.MULTILINE)
SOURCE = " Default: "  # in the docstring of a parameter, before the origin of its default
LISTED = re.compile(r"^(- | |=)", re.MULTILINE)  # a line of a list or a table
SEED = "seed"  # a parameter without a source: any is as good


class Parameter(NamedTuple):
    """A parameter of a part; default as it is typed, empty for an empty text; source of the default, if it is told."""

    name: str
    default: str
    meaning: str
    source: str


class PartHelp(NamedTuple):
    """A part: the first line of its docstring, further paragraphs, parameters with a default."""

    name: str
    summary: str
    more: list[str]
    parameters: list[Parameter]

    @property
    def definition(self) -> str:
        """The part in a sentence with its default values."""
        values = ", ".join(
            f"{p.name}={p.default or 'none'}" for p in self.parameters if p.name != SEED
        )
        return f"{self.name}: {self.summary}{f' ({values})' if values else ''}."


def describe_part(room: str, name: str) -> PartHelp:
    """A part of a room, in words."""
    part = load_part(room, name)
    first, *more = SECTION.split(_strip_markup(inspect.getdoc(part) or ""))[0].strip().split("\n\n")
    kept, meanings = [], {SEED: "random seed"} | _parameter_meanings(part)
    for key, default in parameter_defaults(part).items():
        meaning, _, source = meanings.get(key, "").partition(SOURCE)
        text = f"{default:g}" if isinstance(default, float) else format_value(default)
        kept.append(Parameter(key, text, meaning.rstrip("."), source.rstrip(".")))
    return PartHelp(
        name,
        _join_lines(first).rstrip("."),
        [p if LISTED.search(p) else _join_lines(p) for p in more],
        kept,
    )


def classifier_names(among: Iterable[str] | None = None) -> list[str]:
    """Names of the classifiers that go with any feature set: the harness passes them one."""
    kept = (
        registered_parts("models")
        if among is None
        else [name for name in registered_parts("models") if name in {*among}]
    )
    return [name for name in kept if required_parameters(load_part("models", name)) == ["features"]]


def define_classifiers(systems: Iterable[str]) -> list[str]:
    """A sentence for each classifier on features among systems as tables name them, such as ``svm[C=8] · jung54``."""
    first = {re.split(r"[\[ ]", system)[0] for system in systems if "·" in system}
    return [describe_part("models", name).definition for name in classifier_names(first)]


def parts_help(arguments: Sequence[str], rooms: Mapping[str, str]) -> str:
    """The parameters of the parts that arguments name (``model=svm,rf``), as ``--help`` prints them."""
    sections = []
    for key, _, named in (argument.partition("=") for argument in arguments):
        for name in split_values(key, named):
            one, rows = describe_part(rooms[key], name), []
            for p in one.parameters:
                text = f"{p.meaning}; default {p.default or 'empty'}" + (
                    f" ({p.source})" if p.source else ""
                )
                rows.append(_help_row(f"{key}.{p.name}", text, 20))
            words = [f"{key}={name}: {one.summary}.", *one.more]
            filled = [
                w if LISTED.search(w) else textwrap.fill(w, WIDTH, break_on_hyphens=False)
                for w in words
            ]
            sections.append("\n\n".join([*filled, "\n".join(rows or ["  no parameters"])]))
    return "\n\n".join(sections) + "\n"


def _parameter_meanings(part: object) -> dict[str, str]:
    """Descriptions of parameters by name, from the docstrings of a function, or of a class and its bases."""
    found: dict[str, str] = {}
    for one in reversed(inspect.getmro(part)) if inspect.isclass(part) else [part]:
        pieces = SECTION.split(_strip_markup(inspect.getdoc(one) or ""))
        for kind, text in zip(pieces[1::2], pieces[2::2], strict=True):
            if kind == "Args":
                found |= {
                    n: _join_lines(words)
                    for ns, words in ENTRY.findall(text)
                    for n in ns.split(", ")
                }
    return found


def _strip_markup(text: str) -> str:
    """A docstring without marks of code."""
    return text.replace("``", "").replace("`", "")


def _join_lines(text: str) -> str:
    return " ".join(text.split())


def help_overview() -> str:
    """The commands to begin with, each with its summary, and the names of the others."""
    groups: dict[str, list[str]] = {}
    every = load_commands()
    for name, command in every.items():
        groups.setdefault(command.group, []).append(name)
    lines = ["bench: which recogniser of touch gestures should I ship?", "", f"{START}:"]
    lines += [f"  bench {name:10}{every[name].summary}" for name in groups.pop(START)]
    lines += [
        "",
        "other commands:",
        *(f"  {group:16}{', '.join(names)}" for group, names in groups.items()),
    ]
    return "\n".join([*lines, "", "bench COMMAND --help explains a command and lists its options."])


def command_help(name: str) -> str:
    """The help of a command: usage, a paragraph, its own keys, those that it shares with ``bench run``, examples."""
    command, table, every = (
        load_part("commands", name),
        command_options(name),
        (*RUN_OPTIONS, *options_of_packages("makers").values()),
    )
    shared = [key for key, option in table.items() if name != "run" and option in every]
    rows = [_option_row(option) for key, option in table.items() if key not in shared]
    if shared:
        rows.append(f"  {' '.join(f'{key}=' for key in shared)}   as for bench run")
    usage = "\n".join(f"bench {name} {form}".rstrip() for form in command.usage.split("\n"))
    paragraph = textwrap.fill(command.text, WIDTH, break_on_hyphens=False)
    examples = textwrap.indent(command.examples, "  ")
    return "\n\n".join(filter(None, [usage, paragraph, "\n".join(rows), examples])) + "\n"


def _option_row(option: Option) -> str:
    """A key with its help, values and default."""
    text = option.help
    if option.part_group:
        text = text.replace(
            f"{{{option.part_group}}}", ", ".join(registered_parts(option.part_group))
        )
    if len(option.values) > 1:
        text += f": {(', ' if option.joint == ',' else option.joint).join(option.values)}"
    if option.type != "yes" and option.default not in (None, "", 0, ()):
        text += (
            f"; default {option.default:g}"
            if option.type == "number"
            else f"; default {option.default}"
        )
    return _help_row(option.key, text, 18)


def _help_row(key: str, text: str, indent: int) -> str:
    """A row of help: a key, and behind it a text in lines."""
    first = f"  {key}= ".ljust(indent)
    return textwrap.fill(
        text, WIDTH, break_on_hyphens=False, initial_indent=first, subsequent_indent=" " * indent
    )
