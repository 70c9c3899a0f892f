"""Scene files: what a robot needs of a recogniser, in TOML; `docs/scenes.md` describes them."""

from __future__ import annotations

import csv
import errno
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path

from bench.candidate import Losses
from bench.errors import InputError, nearest
from bench.measures import Measure, costs
from bench.outcomes.reactions import Reactions
from bench.sentences import sentences
from bench.words import FAULTS, quantity

KEYS = ("by", "margin", "unit")  # of a scene and of `bench choose`
OTHER = {  # lines of each section that are no budgets: a key, and that of `bench choose`, empty for those read here
    "budget": {"clock": "clock", "board": "", "share": ""},
    "faults": {"names": "", "severity": ""},
    "people": {"shots": "shots"},
}
EVERY = tuple(FAULTS.split())
DEEPEST = 3  # levels of a scene: section, line, list or table
NESTED = "it is nested more deeply than any line of a scene; see docs/scenes.md"
COSTLIEST = 1e6  # of one mistake, so that sums of costs and scores stay finite


@dataclass(frozen=True)
class Board:
    """A microcontroller board: its size and clock, whether it computes with floats, the maker's page of it."""

    title: str
    flash_kb: float
    ram_kb: float
    clock_mhz: float
    fpu: bool
    source: str
    share: float = 1.0  # of flash and RAM that touch may use

    def budgets(self, timed: bool) -> dict[str, str]:
        """Budgets as keys of ``bench choose``; with the clock, if there is a budget of time and an FPU."""
        values = {"max_flash": f"{self.share * self.flash_kb:.6g}kB", "max_ram": f"{self.share * self.ram_kb:.6g}kB"}
        return values | ({"clock": f"{self.clock_mhz:g}MHz"} if timed and self.fpu else {})

    def sentences(self, values: Mapping[str, object]) -> list[str]:
        """What its budgets are, as far as no other line sets them, and how far counted instructions hold for it."""
        own = self.budgets(timed=False)
        names = [name for name in ("flash", "RAM") if values.get(f"max_{name.lower()}") == own[f"max_{name.lower()}"]]
        timed = bool({"max_cycles", "max_decision"} & {*values})
        return sentences("bench.outcomes", "choice", "board", board=self, names=names, timed=timed)


@dataclass(frozen=True)
class Scene:
    """The needs of a robot.

    Attributes:
        values: its lines as keys of ``bench choose``.
        reactions: reactions to gestures and costs of mistakes.
        faults: circumstances over which losses are taken; None if the scene names none.
        board: board of the robot, with the share of it that touch may use; None if the scene names none.
    """

    values: Mapping[str, str] = field(default_factory=dict)
    reactions: Reactions = field(default_factory=Reactions)
    faults: Losses | None = None
    board: Board | None = None


def boards() -> dict[str, Board]:
    """The boards of ``bench/boards.csv`` by name; KiB of their makers are turned into kB."""
    with files("bench").joinpath("boards.csv").open(encoding="utf-8") as f:
        rows = [*csv.DictReader(f)]
    kb = [(1.024 * float(row["flash_kib"]), 1.024 * float(row["ram_kib"]), float(row["clock_mhz"])) for row in rows]
    return {
        row["name"]: Board(row["title"], *size, row["fpu"] == "yes", row["source"])
        for row, size in zip(rows, kb, strict=True)
    }


def lines() -> dict[str, dict[str, Measure]]:
    """The budgets that each section can have, by their keys there."""
    sections: dict[str, dict[str, Measure]] = {name: {} for name in OTHER}
    for cost in costs().values():
        section, key = cost.line
        sections.setdefault(section, {})[key] = cost
    return sections


def read_scene(name: str) -> Scene:
    """Read a scene file."""
    shipped = {Path(f.name).stem: f for f in files("bench").joinpath("scenes").iterdir()}
    try:
        file = Path(str(shipped[name])) if name in shipped else Path(name)
        if file.exists() and not (file.is_file() or file.is_dir()):  # a device may have no end
            raise OSError(errno.EINVAL, "not a plain file")
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeError) as e:
        why = getattr(e, "strerror", None) or "not UTF-8 text"
        raise InputError(f"scene={name}: {why}; give a TOML file, or {', '.join(sorted(shipped))}") from e
    except RecursionError as e:
        raise InputError(f"scene={name}: {NESTED}") from e
    except ValueError as e:  # also a number of thousands of digits
        raise InputError(f"scene={name} is not TOML: {str(e).partition(';')[0]}") from e
    try:
        _check_size(table)
        return scene_of(table)
    except InputError as e:
        raise InputError(f"scene={name}: {e}") from e


def _check_size(value: object, where: str = "", depth: int = 0) -> None:
    """Refuse deep nesting and very large numbers: TOML allows them, and no line of a scene needs them."""
    if depth > DEEPEST:
        raise InputError(NESTED)
    if isinstance(value, int) and not -(2**63) <= value < 2**63:  # as TOML bounds whole numbers
        raise InputError(f"{where}: a whole number is too large; give one below 2^63")
    inside = value.items() if isinstance(value, dict) else [("", v) for v in value] if isinstance(value, list) else ()
    for key, v in inside:
        _check_size(v, f"{where} {key}".strip(), depth + 1)


def scene_of(table: Mapping[str, object]) -> Scene:
    """A scene from the content of its file."""
    limits = lines()
    _check("", table, {*KEYS, *limits, "unlisted", "reactions", "costs"})
    sections = {name: _section(table, name) for name in limits}
    for name, given in sections.items():
        _check(f"[{name}] ", given, {*limits[name], *OTHER.get(name, ())})
    values = {k: _text(k, table[k]) for k in KEYS if k in table}
    for name, given in sections.items():
        values |= {
            key: _text(f"[{name}] {k}", given[k]) for k, key in OTHER.get(name, {}).items() if key and k in given
        }
        values |= {c.budget: _text(f"[{name}] {k}", given[k]) for k, c in limits[name].items() if k in given}
    for name, given in sections.items():
        for k in given:
            _check_amount(f"[{name}] {k} = {given[k]}", limits[name].get(k), OTHER.get(name, {}).get(k, ""), values)
    if apart := [name for name in limits if name not in OTHER and sections[name]]:  # budgets of a study
        unmeasured = [k for k, cost in limits["budget"].items() if "studies" not in cost.on] + ["clock"]
        if lacking := [k for k in unmeasured if k in sections["budget"]]:
            raise InputError(f"[budget] {lacking[0]}: runs of [{apart[0]}] do not measure it; leave one of them out")
        if "shots" in sections["people"]:
            raise InputError(f"[people] shots: runs of [{apart[0]}] have none; leave one of them out")
    board = _of_board(sections["budget"])
    more = {} if board is None else board.budgets("decision" in sections["budget"])
    return Scene(more | values, _reactions(table), _faults(sections["faults"]), board)


def _of_board(budget: Mapping[str, object]) -> Board | None:
    if "board" not in budget:
        if "share" in budget:
            raise InputError("[budget] share: it is a share of a board; add board, or leave it out")
        return None
    known, name = boards(), _text("[budget] board", budget["board"])
    if name not in known:
        raise InputError(f"[budget] board: no board is called {name}; {nearest(name, known)}")
    share = _number("[budget] share", budget.get("share", 1.0), 0, 1)
    if not share:
        raise InputError("[budget] share = 0: give a share above 0")
    return replace(known[name], share=share)


def _check_amount(line: str, cost: Measure | None, key: str, values: Mapping[str, str]) -> None:
    """Refuse a number or a unit that `bench choose` would refuse, by the name of its line."""
    try:
        if cost is not None:
            cost.typed(values[cost.budget])
        elif key in ("clock", "margin"):
            quantity(key, values[key], "MHz" if key == "clock" else "")
    except InputError as e:
        raise InputError(f"{line}:{str(e).partition(':')[2]}") from e


def _reactions(table: Mapping[str, object]) -> Reactions:
    groups: dict[str, list[str]] = {}
    for name, members in _section(table, "reactions").items():
        if not isinstance(members, list) or not members or not all(isinstance(g, str) for g in members):
            raise InputError(f'[reactions] {name}: give a list of gestures, such as ["stroke", "rub"]')
        groups[name] = members
    every = [g for members in groups.values() for g in members]
    for gesture in every:
        if every.count(gesture) > 1:
            raise InputError(f"[reactions] the gesture {gesture} is listed twice; list it once")
    unlisted = table.get("unlisted", "own")
    if unlisted not in ("own", "ignored"):
        raise InputError(f"unlisted = {unlisted}: give own or ignored")
    costs: dict[str, dict[str, float]] = {}
    silence = 1.0
    for name, row in _section(table, "costs").items():
        if name == "silence":
            silence = _number("[costs] silence", row, 0, COSTLIEST)
        elif isinstance(row, dict):
            costs[name] = {k: _number(f"[costs] {name}: {k}", v, 0, COSTLIEST) for k, v in row.items()}
            if name in row:
                raise InputError(f"[costs] {name}: {name} taken for itself is no mistake; leave it out")
        else:
            raise InputError(f"[costs] {name}: give the reactions that it is taken for, such as {{ calm = 3 }}")
    return Reactions(groups, unlisted == "ignored", costs, silence)


def _faults(lines: Mapping[str, object]) -> Losses | None:
    if not lines:
        return None
    from bench.corpora.faults import SEVERITIES, all_faults  # loads SciPy

    names = lines.get("names", [*EVERY])
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError('[faults] names: give a list of faults, such as ["dead_taxels"]')
    for name in names:
        if name not in all_faults():
            raise InputError(f"[faults] names: no fault is called {name}; {nearest(name, all_faults())}")
    severity = lines.get("severity", SEVERITIES)
    if isinstance(severity, bool) or not isinstance(severity, int) or not 1 <= severity <= SEVERITIES:
        raise InputError(f"[faults] severity = {severity}: give a whole number from 1 to {SEVERITIES}")
    return Losses(tuple(dict.fromkeys(names)), severity)


def _section(table: Mapping[str, object], name: str) -> Mapping[str, object]:
    section = table.get(name, {})
    if not isinstance(section, dict):
        raise InputError(f"{name} = {section}: this is a section; write [{name}] and its lines below")
    return section


def _check(where: str, given: Mapping[str, object], known: Collection[str]) -> None:
    for key in given:
        if key not in known:
            raise InputError(f"{where}{key}: there is no such line; {nearest(key, known)}")


def _number(where: str, value: object, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise InputError(f"{where} = {value}: give a number from {least:.0f} to {most:.0f}")
    return float(value)


def _text(where: str, value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"{where}: give one value, not {value}")
    return str(value)
