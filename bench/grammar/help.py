"""Help: commands with their keys; parts with their parameters, defaults and sources of defaults.

Parts are described by docstrings and signatures, so that help and captions agree.
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
SOURCE = " Default: "  # in the docstring of a parameter, before the source of its default
LISTED = re.compile(r"^(- | |=)", re.MULTILINE)  # a line of a list or a table
SEED = "seed"  # a parameter whose default needs no source


class Parameter(NamedTuple):
    """A parameter of a part: default as it is typed, and the source of the default, if known."""

    name: str
    default: str
    meaning: str
    source: str


class PartHelp(NamedTuple):
    """A part: first line and further paragraphs of its docstring, parameters with a default."""

    name: str
    summary: str
    paragraphs: list[str]
    parameters: list[Parameter]


def describe_part(group: str, name: str) -> PartHelp:
    """Describe a part of a group."""
    part = load_part(group, name)
    text = SECTION.split(_strip_markup(inspect.getdoc(part) or ""))[0].strip()
    first, *paragraphs = text.split("\n\n")
    paragraphs = [p if LISTED.search(p) else _join_lines(p) for p in paragraphs]
    parameters, meanings = [], {SEED: "random seed"} | _parameter_meanings(part)
    for key, default in parameter_defaults(part).items():
        meaning, _, source = meanings.get(key, "").partition(SOURCE)
        typed = f"{default:g}" if isinstance(default, float) else format_value(default)
        parameters.append(Parameter(key, typed, meaning.rstrip("."), source.rstrip(".")))
    return PartHelp(name, _join_lines(first).rstrip("."), paragraphs, parameters)


def takes_features(model: str) -> bool:
    """Return True for a classifier that goes with any feature set."""
    return required_parameters(load_part("models", model)) == ["features"]


def define_classifiers(systems: Iterable[str]) -> list[str]:
    """Define each classifier in names of systems, such as ``svm[C=8] · jung54``, in a sentence."""
    named = {re.split(r"[\[ ]", system)[0] for system in systems if "·" in system}
    sentences = []
    for name in registered_parts("models"):
        if name in named and takes_features(name):
            part = describe_part("models", name)
            values = [f"{p.name}={p.default or 'none'}" for p in part.parameters if p.name != SEED]
            definition = f"{name}: {part.summary}"
            sentences.append(f"{definition} ({', '.join(values)})." if values else f"{definition}.")
    return sentences


def parts_help(arguments: Sequence[str], groups: Mapping[str, str]) -> str:
    """Help on the parts that arguments name, such as ``model=svm,rf``, and their parameters."""
    sections = []
    for key, _, names in (argument.partition("=") for argument in arguments):
        for name in split_values(key, names):
            part, rows = describe_part(groups[key], name), []
            for p in part.parameters:
                text = f"{p.meaning}; default {p.default or 'empty'}"
                text += f" ({p.source})" if p.source else ""
                rows.append(_help_row(f"{key}.{p.name}", text, 20))
            paragraphs = [f"{key}={name}: {part.summary}.", *part.paragraphs]
            filled = [p if LISTED.search(p) else _fill_paragraph(p) for p in paragraphs]
            sections.append("\n\n".join([*filled, "\n".join(rows or ["  no parameters"])]))
    return "\n\n".join(sections) + "\n"


def _parameter_meanings(part: object) -> dict[str, str]:
    """Meanings of parameters, from the docstring of a function, or of a class and its bases."""
    meanings: dict[str, str] = {}
    for described in reversed(inspect.getmro(part)) if inspect.isclass(part) else [part]:
        pieces = SECTION.split(_strip_markup(inspect.getdoc(described) or ""))
        for section, text in zip(pieces[1::2], pieces[2::2], strict=True):
            for names, meaning in ENTRY.findall(text) if section == "Args" else ():
                meanings |= dict.fromkeys(names.split(", "), _join_lines(meaning))
    return meanings


def _strip_markup(text: str) -> str:
    return text.replace("``", "").replace("`", "")


def _join_lines(text: str) -> str:
    return " ".join(text.split())


def _fill_paragraph(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_on_hyphens=False)


def help_overview() -> str:
    """Help on all commands: those to begin with, with their summaries, and names of the others."""
    commands, groups = load_commands(), dict[str, list[str]]()
    for name, command in commands.items():
        groups.setdefault(command.group, []).append(name)
    lines = ["bench: which recogniser of touch gestures should I ship?", "", f"{START}:"]
    lines += [f"  bench {name:10}{commands[name].summary}" for name in groups.pop(START)]
    lines += ["", "other commands:"]
    lines += [f"  {group:16}{', '.join(names)}" for group, names in groups.items()]
    return "\n".join([*lines, "", "bench COMMAND --help explains a command and lists its options."])


def command_help(name: str) -> str:
    """Help on a command: usage, a paragraph, its keys, examples.

    Keys that it shares with ``bench run`` are only named.
    """
    command, options = load_part("commands", name), command_options(name)
    of_run = (*RUN_OPTIONS, *options_of_packages("makers").values())
    shared = [key for key, option in options.items() if name != "run" and option in of_run]
    rows = [_option_row(option) for key, option in options.items() if key not in shared]
    if shared:
        rows.append(f"  {' '.join(f'{key}=' for key in shared)}   as for bench run")
    usage = "\n".join(f"bench {name} {form}".rstrip() for form in command.usage.split("\n"))
    examples = textwrap.indent(command.examples, "  ")
    paragraphs = [usage, _fill_paragraph(command.text), "\n".join(rows), examples]
    return "\n\n".join(filter(None, paragraphs)) + "\n"


def _option_row(option: Option) -> str:
    """A key with its help, values and default."""
    text = option.help
    if group := option.part_group:
        text = text.replace(f"{{{group}}}", ", ".join(registered_parts(group)))
    if len(option.values) > 1:
        joint = ", " if option.joint == "," else option.joint
        text += f": {joint.join(option.values)}"
    if option.type != "yes" and option.default not in (None, "", 0, ()):
        default = f"{option.default:g}" if option.type == "number" else option.default
        text += f"; default {default}"
    return _help_row(option.key, text, 18)


def _help_row(key: str, text: str, indent: int) -> str:
    """Write a key, and a text beside it in lines."""
    first, others = f"  {key}= ".ljust(indent), " " * indent
    return textwrap.fill(
        text, WIDTH, break_on_hyphens=False, initial_indent=first, subsequent_indent=others
    )
