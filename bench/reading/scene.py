"""Scene files: what a robot needs of a recogniser, in TOML; `docs/scenes.md` describes them."""

from __future__ import annotations

import csv
import errno
import tomllib
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path

from bench.corpora.fault_names import FAULT_NAMES, SEVERITIES
from bench.errors import InputError, suggest_names
from bench.ground.typed import parse_amount
from bench.reading.reactions import Reactions
from bench.values.measures import Cost, all_costs
from bench.values.sentences import render_sentences

KEYS = ("by", "margin", "unit")  # of a scene and of `bench choose`
OTHER = {  # lines of each section that are no budgets: a key, and that of `bench choose`, empty for those read here
    "budget": {"clock": "clock", "board": "", "share": ""},
    "faults": {"names": "", "severity": ""},
    "people": {},
}
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

    def as_budgets(self, timed: bool) -> dict[str, str]:
        """Budgets as keys of ``bench choose``; with the clock, if there is a budget of time and an FPU."""
        values = {
            "max_flash": f"{self.share * self.flash_kb:.6g}kB",
            "max_ram": f"{self.share * self.ram_kb:.6g}kB",
        }
        return values | ({"clock": f"{self.clock_mhz:g}MHz"} if timed and self.fpu else {})

    def budget_sentences(self, values: Mapping[str, object]) -> list[str]:
        """What its budgets are, as far as no other line sets them, and how far counted instructions hold for it."""
        own = self.as_budgets(timed=False)
        names = [
            name
            for name in ("flash", "RAM")
            if values.get(f"max_{name.lower()}") == own[f"max_{name.lower()}"]
        ]
        timed = {
            name
            for cost in all_costs().values()
            if cost.at_clock
            for name in (cost.key, cost.at_clock)
        }
        limited = {all_costs()[name].budget_key for name in timed} & {*values}
        return render_sentences(
            "bench.reading", "choice", "board", board=self, names=names, timed=bool(limited)
        )


@dataclass(frozen=True)
class Scene:
    """The needs of a robot."""

    values: Mapping[str, str] = field(default_factory=dict)  # its lines as keys of ``bench choose``
    reactions: Reactions = field(default_factory=Reactions)
    faults: tuple[str, ...] = ()  # over which losses are taken
    severity: int = SEVERITIES  # their highest severity; lower ones count, too
    board: Board | None = None


def load_boards() -> dict[str, Board]:
    """The boards of ``bench/boards.csv`` by name; KiB of their makers are turned into kB."""
    every = {}
    with files("bench").joinpath("boards.csv").open(encoding="utf-8") as f:
        for row in csv.DictReader(f):
            kb = 1.024 * float(row["flash_kib"]), 1.024 * float(row["ram_kib"])
            every[row["name"]] = Board(
                row["title"], *kb, float(row["clock_mhz"]), row["fpu"] == "yes", row["source"]
            )
    return every


def budgets_by_section() -> dict[str, dict[str, Cost]]:
    """The budgets that each section can have, by their keys there."""
    sections: dict[str, dict[str, Cost]] = {name: {} for name in OTHER}
    for cost in all_costs().values():
        section, key = cost.scene_line
        sections.setdefault(section, {})[key] = cost
    return sections


def read_scene(name: str) -> Scene:
    """Read a scene file."""
    shipped = {Path(f.name).stem: f for f in files("bench").joinpath("scenes").iterdir()}
    try:
        file = Path(str(shipped[name])) if name in shipped else Path(name)
        if file.exists() and not (file.is_file() or file.is_dir()):  # a device may have no end
            raise OSError(errno.EINVAL, "not a plain file")
        return scene_from_table(tomllib.loads(file.read_text(encoding="utf-8")))
    except (OSError, UnicodeError) as e:
        why = getattr(e, "strerror", None) or "not UTF-8 text"
        raise InputError(
            f"scene={name}: {why}; give a TOML file, or {', '.join(sorted(shipped))}"
        ) from e
    except RecursionError as e:
        raise InputError(f"scene={name}: {NESTED}") from e
    except ValueError as e:  # also a number of thousands of digits
        raise InputError(f"scene={name} is not TOML: {str(e).partition(';')[0]}") from e
    except InputError as e:
        raise InputError(f"scene={name}: {e}") from e


def scene_from_table(table: Mapping[str, object]) -> Scene:
    """A scene from the content of its file."""
    limits = budgets_by_section()
    _check_names("", table, {*KEYS, *limits, "unlisted", "reactions", "costs"})
    sections = {name: _read_section(table, name) for name in limits}
    values = {key: _read_text(key, table[key]) for key in KEYS if key in table}
    for name, given in sections.items():
        others = OTHER.get(name, {})
        _check_names(f"[{name}] ", given, {*limits[name], *others})
        for key, value in given.items():
            if typed := others[key] if key in others else limits[name][key].budget_key:
                values[typed] = _read_text(f"[{name}] {key}", value)
                _check_amount(
                    f"[{name}] {key} = {value}", limits[name].get(key), typed, values[typed]
                )
    if apart := [
        name for name in limits if name not in OTHER and sections[name]
    ]:  # budgets of a study
        unmeasured = [
            k for k, cost in limits["budget"].items() if "studies" not in cost.measured_on
        ] + ["clock"]
        if lacking := [k for k in unmeasured if k in sections["budget"]]:
            raise InputError(
                f"[budget] {lacking[0]}: runs of [{apart[0]}] do not measure it; leave one of them out"
            )
    board = _read_board(sections["budget"])
    more = {} if board is None else board.as_budgets("decision" in sections["budget"])
    return Scene(more | values, _read_reactions(table), *_read_faults(sections["faults"]), board)


def _read_board(budget: Mapping[str, object]) -> Board | None:
    if "board" not in budget and "share" in budget:
        raise InputError("[budget] share: it is a share of a board; add board, or leave it out")
    if "board" not in budget:
        return None
    known, name = load_boards(), _read_text("[budget] board", budget["board"])
    if name not in known:
        raise InputError(f"[budget] board: no board is called {name}; {suggest_names(name, known)}")
    if not (share := _read_number("[budget] share", budget.get("share", 1.0), 0, 1)):
        raise InputError("[budget] share = 0: give a share above 0")
    return replace(known[name], share=share)


def _check_amount(line: str, cost: Cost | None, key: str, value: str) -> None:
    """Refuse a number or a unit that `bench choose` would refuse, by the name of its line."""
    try:
        if cost is not None:
            cost.parse_budget(value)
        elif key == "clock":
            parse_amount(key, value, "MHz")
    except InputError as e:
        raise InputError(f"{line}:{str(e).partition(':')[2]}") from e


def _read_reactions(table: Mapping[str, object]) -> Reactions:
    groups = {
        name: _read_names(f"[reactions] {name}", members, "gestures", '["stroke", "rub"]')
        for name, members in _read_section(table, "reactions").items()
    }
    counts = Counter(gesture for members in groups.values() for gesture in members)
    if twice := [gesture for gesture, count in counts.items() if count > 1]:
        raise InputError(f"[reactions] the gesture {twice[0]} is listed twice; list it once")
    if (unlisted := table.get("unlisted", "own")) not in ("own", "ignored"):
        raise InputError(f"unlisted = {unlisted}: give own or ignored")
    costs = dict(_read_section(table, "costs"))
    silence, rows = (
        _read_number("[costs] silence", costs.pop("silence", 1.0), 0, COSTLIEST),
        dict[str, dict[str, float]](),
    )
    for name, row in costs.items():
        if not isinstance(row, dict):
            raise InputError(
                f"[costs] {name}: give the reactions that it is taken for, such as {{ calm = 3 }}"
            )
        rows[name] = {
            k: _read_number(f"[costs] {name}: {k}", v, 0, COSTLIEST) for k, v in row.items()
        }
        if name in row:
            raise InputError(f"[costs] {name}: {name} taken for itself is no mistake; leave it out")
    return Reactions(groups, unlisted == "ignored", rows, silence)


def _read_faults(lines: Mapping[str, object]) -> tuple[tuple[str, ...], int]:
    if not lines:
        return (), SEVERITIES
    from bench.corpora.faults import all_faults  # loads SciPy

    names = _read_names(
        "[faults] names", lines.get("names", [*FAULT_NAMES]), "faults", '["dead_taxels"]'
    )
    for name in names:
        if name not in all_faults():
            raise InputError(
                f"[faults] names: no fault is called {name}; {suggest_names(name, all_faults())}"
            )
    severity = lines.get("severity", SEVERITIES)
    if (
        isinstance(severity, bool)
        or not isinstance(severity, int)
        or not 1 <= severity <= SEVERITIES
    ):
        raise InputError(
            f"[faults] severity = {severity}: give a whole number from 1 to {SEVERITIES}"
        )
    return tuple(dict.fromkeys(names)), severity


def _read_section(table: Mapping[str, object], name: str) -> Mapping[str, object]:
    section = table.get(name, {})
    if not isinstance(section, dict):
        raise InputError(
            f"{name} = {section}: this is a section; write [{name}] and its lines below"
        )
    return section


def _check_names(where: str, given: Mapping[str, object], known: Collection[str]) -> None:
    for key in given:
        if key not in known:
            raise InputError(f"{where}{key}: there is no such line; {suggest_names(key, known)}")


def _read_names(where: str, value: object, noun: str, example: str) -> list[str]:
    if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
        raise InputError(f"{where}: give a list of {noun}, such as {example}")
    return value


def _read_number(where: str, value: object, least: float, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise InputError(f"{where} = {value}: give a number from {least:.0f} to {most:.0f}")
    return float(value)


def _read_text(where: str, value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"{where}: give one value, not {value}")
    return str(value)
