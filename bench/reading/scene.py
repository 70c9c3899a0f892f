"""Scene files: what a robot needs of a recogniser, in TOML; `docs/scenes.md` describes them."""

from __future__ import annotations

import csv
import errno
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path

from bench.corpora.fault_names import FAULT_NAMES, SEVERITIES
from bench.errors import InputError
from bench.ground.typed import parse_amount, parse_toml
from bench.reading.reactions import Reactions, check_known
from bench.values.measures import Cost, all_costs
from bench.values.sentences import render_sentences

KEYS = ("by", "margin", "unit")  # of a scene and of `bench choose`
# Lines of each section that are no budgets, and their key of `bench choose`, "" for none.
OTHER_LINES = {
    "budget": {"clock": "clock", "board": "", "share": ""},
    "faults": {"names": "", "severity": ""},
    "people": {},
    "skin": {},
}
COSTLIEST = 1e6  # of one mistake, so that sums of costs and scores stay finite


@dataclass(frozen=True)
class Board:
    """A microcontroller board.

    Args:
        title: its name in sentences.
        flash_kb: flash in kB.
        ram_kb: RAM in kB.
        clock_mhz: clock in MHz.
        fpu: True if it has a floating-point unit.
        source: the maker's page.
        core_flash_kb: rough flash of the bootloader and the core that each program of it has; 0
            if it is not known.
        core_ram_kb: the same of RAM.
        tables_in_ram: True if constants of C take RAM, too.
        share: share of the other flash and RAM that touch may use.
    """

    title: str
    flash_kb: float
    ram_kb: float
    clock_mhz: float
    fpu: bool
    source: str
    core_flash_kb: float = 0.0
    core_ram_kb: float = 0.0
    tables_in_ram: bool = False
    share: float = 1.0

    @property
    def free_kb(self) -> tuple[float, float]:
        """Flash and RAM without its core, in kB."""
        return self.flash_kb - self.core_flash_kb, self.ram_kb - self.core_ram_kb

    def as_budgets(self, timed: bool) -> dict[str, str]:
        """Keys of ``bench choose``; with the clock if there is a budget of time and an FPU."""
        flash, ram = (f"{self.share * kilobytes:.6g}kB" for kilobytes in self.free_kb)
        budgets = {"max_flash": flash, "max_ram": ram}
        if timed and self.fpu:
            budgets["clock"] = f"{self.clock_mhz:g}MHz"
        return budgets

    def budget_sentences(self, values: Mapping[str, object]) -> list[str]:
        """Sentences on its budgets that no other line replaces, and on counted instructions."""
        budgets = self.as_budgets(timed=False)
        memories = {"flash": "max_flash", "RAM": "max_ram"}
        names = [name for name, key in memories.items() if values.get(key) == budgets[key]]
        counted = [cost for cost in all_costs().values() if cost.at_clock]
        keys = {all_costs()[n].budget_key for cost in counted for n in (cost.key, cost.at_clock)}
        timed = not keys.isdisjoint(values)
        return render_sentences(
            "bench.reading", "choice", "board", board=self, names=names, timed=timed
        )


@dataclass(frozen=True)
class Scene:
    """The needs of a robot.

    Args:
        values: lines of the file as keys of ``bench choose``.
        reactions: reactions to gestures and costs of mistakes.
        faults: faults over which losses are taken.
        severity: their highest severity; lower ones count, too.
        board: the board of the robot.
    """

    values: Mapping[str, str] = field(default_factory=dict)
    reactions: Reactions = field(default_factory=Reactions)
    faults: tuple[str, ...] = ()
    severity: int = SEVERITIES
    board: Board | None = None


def load_boards() -> dict[str, Board]:
    """The boards of ``bench/boards.csv`` by name, with KiB of their makers as kB."""
    boards = {}
    with files("bench").joinpath("boards.csv").open(encoding="utf-8") as f:
        for row in csv.DictReader(f):
            sizes = {
                name.replace("kib", "kb"): 1.024 * float(row[name])
                for name in ("flash_kib", "ram_kib", "core_flash_kib", "core_ram_kib")
            }
            board = Board(
                row["title"],
                sizes["flash_kb"],
                sizes["ram_kb"],
                clock_mhz=float(row["clock_mhz"]),
                fpu=row["fpu"] == "yes",
                source=row["source"],
                core_flash_kb=sizes["core_flash_kb"],
                core_ram_kb=sizes["core_ram_kb"],
                tables_in_ram=row["tables_in_ram"] == "yes",
            )
            boards[row["name"]] = board
    return boards


def budgets_by_section() -> dict[str, dict[str, Cost]]:
    """The budgets that each section can have, by their keys there."""
    sections: dict[str, dict[str, Cost]] = {name: {} for name in OTHER_LINES}
    for cost in all_costs().values():
        section, key = cost.scene_line
        sections.setdefault(section, {})[key] = cost
    return sections


def read_scene(name: str) -> Scene:
    """Read a scene file, or one of the shipped scenes.

    Raises:
        InputError: the file cannot be read, or has a line that no scene has.
    """
    shipped = {Path(f.name).stem: f for f in files("bench").joinpath("scenes").iterdir()}
    try:
        file = Path(str(shipped[name])) if name in shipped else Path(name)
        if file.exists() and not (file.is_file() or file.is_dir()):  # a device may have no end
            raise OSError(errno.EINVAL, "not a plain file")
        return scene_from_table(parse_toml(file.read_bytes()))
    except OSError as e:
        raise InputError(
            f"scene={name}: {e.strerror}; give a TOML file, or {', '.join(sorted(shipped))}"
        ) from e
    except RecursionError as e:
        raise InputError(
            f"scene={name}: it is nested more deeply than any line of a scene; see docs/scenes.md"
        ) from e
    except ValueError as e:  # a number of thousands of digits
        raise InputError(f"scene={name}: not TOML: {str(e).partition(';')[0]}") from e
    except InputError as e:
        raise InputError(f"scene={name}: {e}") from e


def scene_from_table(table: Mapping[str, object]) -> Scene:
    """A scene from the content of its file."""
    costs = budgets_by_section()
    check_known("scene", "line", table, {*KEYS, *costs, "unlisted", "reactions", "costs"})
    sections = {name: _read_section(table, name) for name in costs}
    values = {key: _read_text(key, table[key]) for key in KEYS if key in table}
    for name, lines in sections.items():
        others = OTHER_LINES.get(name, {})
        check_known(f"[{name}]", "line", lines, {*costs[name], *others})
        for line, value in lines.items():
            key = others[line] if line in others else costs[name][line].budget_key
            if key:
                values[key] = _read_text(f"[{name}] {line}", value)
                where = f"[{name}] {line} = {value}"
                _check_amount(where, costs[name].get(line), key, values[key])
    budget = sections["budget"]
    unmeasured = ["clock"]  # by runs of studies
    unmeasured += [k for k, cost in costs["budget"].items() if "studies" not in cost.measured_on]
    studies = [name for name in costs if name not in OTHER_LINES and sections[name]]
    wrong = [key for key in unmeasured if key in budget]
    if studies and wrong:
        raise InputError(
            f"[budget] {wrong[0]}: runs of [{studies[0]}] do not measure it; leave one of them out"
        )
    board = _read_board(budget)
    more = {} if board is None else board.as_budgets("decision" in budget)
    return Scene(more | values, _read_reactions(table), *_read_faults(sections["faults"]), board)


def _read_board(budget: Mapping[str, object]) -> Board | None:
    if "board" not in budget:
        if "share" in budget:
            raise InputError("[budget] share: it is a share of a board; add board, or leave it out")
        return None
    boards, name = load_boards(), _read_text("[budget] board", budget["board"])
    check_known("[budget] board", "board", [name], boards)
    share = _read_number("[budget] share", budget.get("share", 1.0), 0, 1)
    if not share:
        raise InputError("[budget] share = 0: give a share above 0")
    return replace(boards[name], share=share)


def _check_amount(where: str, cost: Cost | None, key: str, value: str) -> None:
    """Refuse a number or unit that `bench choose` would refuse, by the name of its line."""
    try:
        if cost is not None:
            cost.parse_budget(value)
        elif key == "clock":
            parse_amount(key, value, "MHz")
    except InputError as e:
        raise InputError(f"{where}:{str(e).partition(':')[2]}") from e


def _read_reactions(table: Mapping[str, object]) -> Reactions:
    groups = {
        name: _read_names(f"[reactions] {name}", members, "gestures", '["stroke", "rub"]')
        for name, members in _read_section(table, "reactions").items()
    }
    counts = Counter(gesture for members in groups.values() for gesture in members)
    for gesture, count in counts.items():
        if count > 1:
            raise InputError(f"[reactions] the gesture {gesture} is listed twice; list it once")
    unlisted = table.get("unlisted", "own")
    if unlisted not in ("own", "ignored"):
        raise InputError(f"unlisted = {unlisted}: give own or ignored")
    costs: dict[str, dict[str, float]] = {}
    silence = 1.0
    for name, row in _read_section(table, "costs").items():
        where = f"[costs] {name}"
        if name == "silence":
            silence = _read_number(where, row, 0, COSTLIEST)
            continue
        if not isinstance(row, dict):
            raise InputError(
                f"{where}: give the reactions that it is taken for, such as {{ calm = 3 }}"
            )
        costs[name] = {k: _read_number(f"{where}: {k}", v, 0, COSTLIEST) for k, v in row.items()}
        if name in row:
            raise InputError(f"{where}: {name} taken for itself is no mistake; leave it out")
    return Reactions(groups, unlisted == "ignored", costs, silence)


def _read_faults(lines: Mapping[str, object]) -> tuple[tuple[str, ...], int]:
    """The names and the severity of a section ``[faults]``; no names without one."""
    if not lines:
        return (), SEVERITIES
    from bench.corpora.faults import FAULTS  # loads SciPy

    names = lines.get("names", [*FAULT_NAMES])
    names = _read_names("[faults] names", names, "faults", '["dead_taxels"]')
    check_known("[faults] names", "fault", names, FAULTS)
    severity = lines.get("severity", SEVERITIES)
    if type(severity) is not int or not 1 <= severity <= SEVERITIES:
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


def _read_names(where: str, value: object, noun: str, example: str) -> list[str]:
    if not isinstance(value, list) or not value or not all(isinstance(each, str) for each in value):
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
