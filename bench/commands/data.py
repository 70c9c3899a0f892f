"""The command ``bench data``, and corpora in Python."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError, suggest_names
from bench.grammar.options import START, Command, Option, parse_arguments, typed_settings
from bench.ground.typed import DEFAULTS, Values

if TYPE_CHECKING:
    import pandas as pd


ACTIONS = ("import", "show", "verify", "export")
IMPORT = (  # the format has others
    Option("name", "text", "", "name of the corpus; an earlier corpus of this name is replaced"),
    Option("grid", "text", "", "table: rows and columns of the skin, such as 8x8"),
    Option("rate_hz", "number", None, "table: frame rate in Hz"),
    Option("full_scale", "number", 1023, "table: largest possible reading"),
)
SHOW = (
    Option("where", "text", DEFAULTS["where"], "captures to show"),
    Option("target", "text", DEFAULTS["target"], "columns whose classes are also counted"),
    Option("out", "text", "look", "folder for figures and index.html, which shows them"),
)
EXPORT = (
    Option(
        "format",
        "text",
        "",
        "file format: that of CoST.csv, or a table of any skin",
        ("cost", "table"),
    ),
)
COMMAND = Command(
    START,
    "list, import, show, verify and export corpora",
    "Without an action, lists the corpora with counts, digest, source and licence. import reads the Corpus of "
    "Social Touch, HAART (zip or folder), CuddleBot (folder or archive) or a table. align=, frames= and crop= "
    "change captures of any format. A CSV or parquet table has the columns subject, gesture, "
    "frame, conditions and channels. A .npz table has frames, offsets, subject and gesture. A column synthetic "
    "marks generated captures. "
    "show prints counts, gaps, durations, pressure, broken taxels, seams and equal captures. verify reads every "
    "stored file again; exit code 1 if one has changed. show and export take parameters of synth, such as "
    "subjects=4.",
    "bench data import cost CoST.csv\n"
    'bench data import haart "HAART DataSet.zip" align=yes\n'
    "bench data import table my.csv name=arm grid=10x10 rate_hz=54 full_scale=1023\n"
    "bench data export synth out.csv subjects=31 repetitions=6",
    "\nimport cost|cuddlebot|haart|table FILE [key=value ...]\nshow NAME [key=value ...]\nverify NAME\n"
    "export NAME FILE",
    options=(*IMPORT, *SHOW, *EXPORT),
)


def extract_features(values: Values) -> pd.DataFrame:
    """The features of all captures, beside their subject, gesture and conditions."""
    import pandas as pd

    from bench import contract
    from bench.corpora.library import left_out_message
    from bench.ground.progress import warn
    from bench.plan.grid import make_cells
    from bench.plan.plan import load_captures

    cell, *more = make_cells({**values, "model": DEFAULTS["model"]})
    if more:
        raise InputError("bench.extract makes one table; give one value of each key")
    captures = load_captures(cell.data, cell.data_parameters, cell.where, cell.target)
    (features,) = cell.feature_sets().values()
    contract.check(features)
    columns = features.fit(captures, captures.gestures).transform(captures)
    if both := sorted({*captures.captures.columns} & {*columns.columns}):
        raise InputError(
            f"{captures.name} has a column {both[0]!r}, also a feature; rename it and import again"
        )
    if line := left_out_message(captures):
        warn(line)
    return pd.concat([captures.captures, columns], axis=1)


def command(arguments: list[str]) -> int:
    """List the corpora, or import, show, verify or export one."""
    from bench.commands import data_actions
    from bench.corpora.library import imported_names

    match arguments:
        case []:
            return data_actions.list_corpora()
        case ["import", kind, source, *rest]:
            return data_actions.import_and_print(
                kind, Path(source), parse_arguments(rest, None)
            )  # the reader knows its options
        case ["show", name, *rest] if "=" not in name:
            return data_actions.show_corpus(
                name, values := parse_arguments(rest, None), typed_settings("data", values, SHOW)
            )
        case ["verify", name]:
            return data_actions.verify_corpus(name)
        case ["export", name, target, *rest]:
            typed_settings("data", values := parse_arguments(rest, None), EXPORT)
            return data_actions.export_corpus(name, Path(target), values)
        case ["show", *_]:
            raise InputError(
                f"bench data show: give the name of a corpus: {', '.join(['synth', *imported_names()])}"
            )
        case [name, *_] if name in ("synth", *imported_names()):
            raise InputError(
                f"bench data {name}: an action is missing; give for example bench data show {name}"
            )
        case [word, *_] if word not in ACTIONS:
            raise InputError(
                f"bench data {word}: {suggest_names(word, ACTIONS)}; see bench data --help"
            )
    raise InputError(
        f"bench data {' '.join(arguments)}: not an action with its arguments; see bench data --help"
    )
