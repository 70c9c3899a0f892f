"""Write the C files of a system."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaincinv

from bench.errors import InputError
from bench.features import touch
from bench.models.steps import DENOISED_FRAMES, FILL_PASSES, NOISE_STEPS, QUIET_PART
from touchbench_chip.classifiers import format_float
from touchbench_chip.tables import CContents, collect_contents

if TYPE_CHECKING:
    from bench.running.saved import Recogniser

CODE = Path(__file__).parent / "code"
TYPES = {"int8": "int8_t", "int16": "int16_t", "int32": "int", "float32": "float"}
PUBLIC = (
    "ROWS",
    "COLS",
    "TAXELS",
    "CLASSES",
    "RATE_HZ",
    "FULL_SCALE",
    "NEGATIVE",
    "STOPPING",
    "THRESHOLD",
    "WATCH",
    "DELAY",
)
SETTLED = "settled: 0 to 1; from TOUCH_THRESHOLD on, more touch is expected to gain too little."
NEVER_SETTLED = "settled: always 0, because training found no saving by deciding early."
TOP = (
    "/* From frames to a label, in the order in which it happens: a frame is checked and repaired, "
    "joins what is\n"
    "   kept of the capture, and, where a decision is due, features are computed and classified. "
    "touch_push and touch_label\n"
    "   stand at the end. All that changes is in touch_t; what was learnt is in tables.h. */\n"
)
# Functions that a classifier may use, each in a file of its name.
FUNCTIONS = ("measured", "layer", "softmax", "leaf", "machine")
COMMENTS = {  # by the first constant of each group
    "ROWS": "The sensor, classes and features; readings are 0 to FULL_SCALE.",
    "CHECKED": "Frames of make check, and most of a capture.",
    "SETTLED": "Repair: frames after which a taxel that has not moved is at rest, or broken; "
    "which kinds are repaired.",
    "WINDOW": "Frames of a window and from one to the next, and of the shorter ones before the "
    "first; 0 for none.",
    "CONVOLVED": "Frames of a window and from one to the next; windows that are open at a time; "
    "filters and pools.",
    "SEGMENT": "Spectra: frames of a segment, most points; lags of autocorrelations, in frames.",
    "STOPPING": "Early decisions: how settled a label must be, learned on training subjects.",
    "CALIBRATED": "Calibration: confidence by ms of touch, learned on training subjects.",
    "WATCH": "An endless stream, 0 for none: parts of captures, frames after which places repeat, "
    "most at full scale.",
    "PASSES": "Rounds in which broken taxels are filled from their neighbours; labels that are "
    "remembered; against noise, frames of a mean, steps, and quieter rows and columns.",
    "SIGNALS": "Features of touch: signals of a frame, what is taken of each, and of the taxels in "
    "order of size.",
    "MEAN": "Frames of the design from recorded ones: the mean, a picked one or the peaks of a "
    "period, whose length is in parts of which a recorded frame has so many; codes.",
    "NAMES": "Classes, in the order of probabilities.",
}
PREFIX = "touch"  # of all public names
PUBLIC_NAME = re.compile(rf"((?<![0-9A-Za-z_])|(?<=\\n))({PREFIX}|{PREFIX.upper()})_")
STANDARD_TYPES = r"u?int\w*|s?size|ptrdiff|w?char(16|32)?|wint|float|double|time|clock"  # before _t
FIXED_FILES = ("main.c", "Makefile", "cortex_m4.c", "cortex_m4.ld")
REMEMBERED = {
    "PASSES": str(FILL_PASSES),
    "REMEMBERED": "32",
    "DENOISED": str(DENOISED_FRAMES),
    "NOISE_STEPS": str(NOISE_STEPS),
    "QUIET": f"((ROWS + COLS - 1) / {QUIET_PART})",
}
CONSTANTS = REMEMBERED | {  # of the feature set touch
    "SIGNALS": str(len(touch.SIGNALS)),
    "STATISTICS": str(len(touch.STATISTICS)),
    "SPECTRAL": str(len(touch.SPECTRAL_SIGNALS)),
    "LAGGED": str(len(touch.LAGGED_SIGNALS)),
    "LAGS": str(len(touch.LAGS_S)),
    "BANDS": str(len(touch.BANDS) - 1),
    "SPREAD": str(touch.SORTED_POINTS),
    "POINTS": str(touch.SPECTRUM_POINTS),
    "ROW": str(touch.CENTRE_SIGNALS[0]),
    "COL": str(touch.CENTRE_SIGNALS[1]),
    "EPS": format_float(touch.EPS),
    "STILL": format_float(touch.STILL_SHARE),
    "PI": format_float(math.pi),
}


def write_c_sources(
    recogniser: Recogniser, bits: int, title: str, prefix: str = PREFIX
) -> dict[str, str]:
    """Names and contents of the C files of a saved system.

    Args:
        recogniser: the saved system.
        bits: bits per learnt weight, 32 or 8.
        title: first line of the header.
        prefix: what the names of all functions, types and macros begin with.
    """
    chip = collect_contents(recogniser, bits)
    pretended = chip.watch.pretended if chip.watch else ""
    files = {
        "touch.h": _write_header(chip, recogniser.rate_hz),
        "tables.h": _write_tables(chip, bits),
        "touch.c": _write_code(chip),
        "count.c": _read_code("count.c").replace("/* PRETENDED */", pretended),
    }
    files |= {name: _read_code(name) for name in FIXED_FILES}
    check_prefix(prefix, "\n".join(files.values()))
    names = ", ".join(f'"{_escape_name(name)}"' for name in chip.classes)
    model = hashlib.sha256("".join([*files.values(), names]).encode()).hexdigest()[:8]
    files = {name: rename_public(text, prefix) for name, text in files.items()}
    # Words of users come last, as they are no names of the C.
    words = {"title": title, "names": names, "model": model, "version": version("touchbench")}
    for name in ("touch.h", "tables.h"):
        files[name] = Template(files[name]).substitute(words)
    return files


def check_prefix(prefix: str, code: str = "") -> None:
    """Raise an InputError for a prefix that makes no names, or names of the C inside.

    Args:
        prefix: what the names of all functions, types and macros shall begin with.
        code: C besides that which all systems share.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", prefix) or re.fullmatch(STANDARD_TYPES, prefix):
        raise InputError(
            f"prefix={prefix}: names of the C begin with it; give a letter and then letters, "
            "digits or _, such as prefix=skin, and no type of C"
        )
    fixed = [_read_code(path.name) for path in CODE.iterdir()]
    names = {*re.findall(r"\w+", "\n".join([code, *fixed]))}
    public = filter(PUBLIC_NAME.match, names)
    clashes = sorted(names & {rename_public(name, prefix) for name in public})
    if clashes and prefix != PREFIX:
        raise InputError(
            f"prefix={prefix}: the C has the name {clashes[0]} inside; give another prefix"
        )


def rename_public(text: str, prefix: str) -> str:
    """Replace the prefix of all public names in C or a Makefile; that of macros is upper case."""

    def renamed(match: re.Match[str]) -> str:
        is_macro = match[2].isupper()
        return f"{prefix.upper() if is_macro else prefix}_"

    return PUBLIC_NAME.sub(renamed, text)


def hash_fixed_code() -> str:
    """Hash of the C that all systems share."""
    contents = b"".join(path.read_bytes() for path in sorted(CODE.iterdir()))
    return hashlib.sha256(contents).hexdigest()


def _read_code(name: str) -> str:
    return (CODE / name).read_text(encoding="utf-8")


def _fill_code(name: str, values: dict[str, str]) -> str:
    """Fill values for ``$NAME`` into a fixed file."""
    return Template(_read_code(name)).substitute(values)


def _write_header(chip: CContents, rate_hz: float) -> str:
    defines = chip.defines | {"RATE_HZ": repr(rate_hz)}  # in full, as main.c counts hops with it
    public = [f"#define TOUCH_{name} {defines[name]}" for name in PUBLIC if name in defines]
    parts = {
        "title": "$title",  # filled in after names are given their prefix
        "model": "$model",
        "version": "$version",
        "public": "\n".join(public),
        "state": _write_state(chip),
        "settled": SETTLED if defines["STOPPING"] == "1" else NEVER_SETTLED,
        "watch": _read_code("watch.h") + _write_points(chip) if chip.watch else "",
        "skin": chip.skin.header if chip.skin else "",
    }
    return _fill_code("touch.h", parts)


def _write_points(chip: CContents) -> str:
    """Write the function that changes the operating point, with the results of each point."""
    rows = []
    for i, (level, alarms, hours, found) in enumerate(chip.points):
        row = f"   {i}: {_alarm_words(alarms, hours)}; {100 * found:.1f} % of touches found"
        if format_float(level) == chip.defines["LEVEL"]:
            row += " (after touch_watch_init)"
        rows.append(row)
    lines = [
        "",
        f"#define TOUCH_POINTS {len(rows)} "
        "/* operating points, from the strictest to the most eager */",
        "",
        "/* Move to an operating point; TOUCH_BAD without it. On training recordings, each subject",
        "   left out in turn, the points gave:",
        *rows[:-1],
        f"{rows[-1]} */",
        "int touch_set_threshold(touch_watch_t *w, int point);",
        "",
    ]
    return "\n".join(lines)


def _alarm_words(alarms: float, hours: float) -> str:
    """Number of false alarms, and the upper bound of their rate (Poisson), in words."""
    if not hours:
        return "no background to count false alarms in"
    rate = poisson_upper_rate(alarms, hours)
    return (
        f"{alarms:g} false alarms in {60 * hours:.3g} minutes, so at most {rate:.3g} per hour "
        "(95 % confidence)"
    )


def poisson_upper_rate(events: float, hours: float) -> float:
    """Upper 95 % bound of the rate of so many events (Poisson, exact; 3 / hours after none)."""
    return float(gammaincinv(events + 1, 0.95)) / hours


def _write_state(chip: CContents) -> str:
    """Write the types of what is kept between frames, and of the buffers."""
    d = chip.defines
    taxels = d["TAXELS"]
    members = ["int seen;  /* frames */", f"float frame[{taxels}];  /* this one, repaired */"]
    if "1" in (d["REPAIR_STUCK"], d["REPAIR_DEAD"]):
        members += [
            f"float least[{taxels}], most[{taxels}], moved[{taxels}];  "
            "/* of each taxel in this capture */",
            f"float sound[{taxels}], mean_around[{taxels}];  "
            "/* which taxels are, and what replaces others */",
        ]
    if d["REPAIR_NOISE"] == "1":
        members += [
            f"float recent[{DENOISED_FRAMES}][{taxels}]; int newest, held;  /* frames, a ring */",
            f"float mean[{taxels}], variance[{taxels}];  /* of them */",
            f"float steps[{NOISE_STEPS}][{d['ROWS']} + {d['COLS']}]; int newest_step, held_steps;  "
            "/* of rows and columns, a ring */",
        ]
    if d["REPAIR_OFFSET"] == "1":
        members.append(f"float offset[{taxels}];  /* least reading so far */")
    if d["SCALE_PEAK"] == "1":
        members.append("float peak;  /* largest reading so far */")
    members += STATES[chip.features](d)
    members.append(f"float features[{d['FEATURES']}], proba[{d['CLASSES']}];")
    buffers: dict[str, int] = {}
    for decider in chip.deciders.values():
        for name, size in decider.buffers.items():
            buffers[name] = max(size, buffers.get(name, 0))
    for name, size in buffers.items():
        members.append(f"float {name}[{size}];  /* the classifier works in it */")
    if d["STOPPING"] == "1":
        members.append(
            "int remembered, label_at[32]; int16_t labels[32];  "
            "/* labels so far, and after how many frames */"
        )
    part = ""
    if chip.features == "touch":
        part = _fill_code("part_in_steps.h" if d["STEPPED"] == "1" else "part.h", d)
    return part + _write_struct("touch_t", members) + _write_watch_state(chip)


def _write_struct(name: str, members: Iterable[str]) -> str:
    lines = "".join(f"    {line}\n" for line in members)
    return f"typedef struct {{\n{lines}}} {name};\n"


def _write_watch_state(chip: CContents) -> str:
    """Write the type of what a watcher keeps between frames; empty without a watcher."""
    if chip.watch is None:
        return ""
    members = (
        "float level, reject;  /* the threshold; least confidence of a label */",
        "uint32_t seen;  /* frames; modulo 2^32 */",
        "touch_counts_t counts; unsigned status, of_frame;  "
        "/* all reasons; those of the last frame by itself */",
        "touch_health_t health;",
        "touch_t now;  /* the last frames, and what features and classifier work in */",
        "int is_refused;  /* of the last decision */",
        *(line.format_map(chip.defines) for line in chip.watch.state),
    )
    return _fill_code("counts.h", chip.defines) + _write_struct("touch_watch_t", members)


def _touch_state(d: dict[str, str]) -> list[str]:
    ring, points, taxels, classes = d["RING"], d["MOST_POINTS"], d["TAXELS"], d["CLASSES"]
    early, sorts = d["EARLY"] != "0", max(ring, points, key=int)  # spectra work in it, too
    halves = "halves of the last window" + (", and of a shorter one" if early else "")
    is_sliced = d.get("SLICES", "1") != "1"  # a tick is needed while the next one comes
    parts = 4 if early else 2 + is_sliced
    members = [
        f"float before[{taxels}];  /* the last one */",
        f"float signals[{ring}][{len(touch.SIGNALS)}];  /* of the last window, a ring */",
        f"touch_part_t parts[{parts}];  /* {halves} */",
        f"float sum[{classes}]; int windows;  /* of decisions */",
    ]
    if d["PROFILES"] == "1":
        lines = f"{d['ROWS']} + {d['COLS']}"
        members.append(f"float profiles[{ring}][{lines}];  /* means of rows and columns */")
    if early:
        members.append(
            f"float early_sum[{classes}]; int early_windows;  "
            "/* of shorter ones, before the first */"
        )
    return [
        *members,
        f"float series[{ring}], sorted[{sorts}], centre[{ring}], taxels[{taxels}];  "
        "/* to work in */",
        f"float cosine[{points}], sine[{points}], power[{int(points) // 2}]; int points;  "
        "/* of spectra */",
    ]


def _convolved_state(d: dict[str, str]) -> list[str]:
    maps = f"{d['FILTERS1']}][{d['MAP']}"
    sums = f"{d['FILTERS2']}][{d['SUM_FRAMES']}][{d['SUM_ROWS']}][{d['SUM_COLS']}"
    return [
        f"float ring[{d['KERNEL1_FRAMES']}][{d['TAXELS']}];  /* the last frames */",
        f"float maps[{maps}], kept_maps[{maps}];  /* of the first layer, at the last time */",
        f"float sums[{d['OPEN']}][{sums}], kept_sums[{sums}];  "
        "/* of the second, of each open window */",
        f"float sum[{d['CLASSES']}]; int windows;  /* of decisions */",
    ]


def _jung28_state(d: dict[str, str]) -> list[str]:
    return [
        f"float before[{d['TAXELS']}];  /* the last one */",
        f"float total[{d['LONGEST']}];  /* of each frame */",
        f"float row[{d['ROWS']}], col[{d['COLS']}], centre[2], distance[2];  "
        "/* means, the last, path so far */",
        "float change, area, area_there, highest, highest_total;  "
        "/* means, and of the strongest frame */",
    ]


STATES = {"touch": _touch_state, "convolved": _convolved_state, "jung28": _jung28_state}


def _write_tables(chip: CContents, bits: int) -> str:
    constants = CONSTANTS if chip.features == "touch" else REMEMBERED
    arrays = dict(chip.arrays)
    for function, decider in chip.deciders.items():
        arrays |= {f"{function}_{name}": values for name, values in decider.arrays.items()}
    lines = []
    groups = chip.watch.constants if chip.watch else ()
    comments = COMMENTS | {next(iter(group)): comment for comment, group in groups}
    for name, value in {**chip.defines, **constants, "NAMES": "{$names}"}.items():
        if name in comments:
            lines.append(f"\n/* {comments[name]} */")
        lines.append(f"#define {name} {value}")
    lines += ["", f"typedef {'int8_t' if bits == 8 else 'float'} touch_weight_t;"]
    if any(name.endswith("_vectors") for name in arrays):
        lines.append(f"typedef {'int16_t' if bits == 8 else 'float'} touch_vector_t;")
    if any(name.endswith("_nodes") for name in arrays):
        lines.append(
            "typedef struct { int16_t feature; uint16_t right; float threshold; } touch_node_t;"
        )
    lines += [_write_array(name, values) for name, values in arrays.items()]
    return "/* Sizes, and what was learnt. */\n" + "\n".join(lines) + "\n"


def _escape_name(name: str) -> str:
    """A class name for a C string; other characters than ASCII as their bytes."""
    escaped = ""
    for byte in name.encode():
        is_plain = 32 <= byte < 127 and chr(byte) not in '"\\?'
        escaped += chr(byte) if is_plain else f"\\{byte:03o}"
    return escaped


def _write_array(name: str, values: np.ndarray) -> str:
    flat = values.ravel()
    if flat.dtype.names:
        cells = [f"{{{v['feature']}, {v['right']}, {format_float(v['threshold'])}}}" for v in flat]
        kind = "touch_node_t"
    elif flat.dtype.kind == "f":
        cells, kind = [format_float(v) for v in flat], "float"
    else:
        cells, kind = [str(v) for v in flat.tolist()], TYPES[str(flat.dtype)]
    rows, row = [], ""
    for cell in cells:
        if len(row) + len(cell) > 116:
            rows.append(row)
            row = ""
        row += f"{cell}, "
    inside = "\n    ".join([*rows, row])
    return f"static const {kind} {name}[{len(cells)}] = {{\n    {inside.rstrip(', ')}}};"


def _write_code(chip: CContents) -> str:
    headers = ('"touch.h"\n', "<math.h>", "<stddef.h>", "<string.h>\n", '"tables.h"\n')
    includes = "".join(f"#include {header}\n" for header in headers)
    pieces = [
        f"{TOP}\n{includes}",
        _read_code("frame.c"),
        _read_code(f"features_{chip.features}.c"),
    ]
    bodies = "".join(decider.body for decider in chip.deciders.values())
    bodies += "softmax(" if chip.defines["CALIBRATED"] == "1" else ""
    pieces += [_read_code(f"{name}.c") for name in FUNCTIONS if f"{name}(" in bodies]
    for function, decider in chip.deciders.items():
        body = decider.render_body(function)
        kind = "Probabilities" if "softmax" in decider.body else "Scores"
        comment = f"/* {kind} from the features: {decider.comment}. */\n"
        pieces.append(f"{comment}static void {function}(touch_t *t, float *proba)\n{{\n{body}}}\n")
    pieces += [_read_code("api.c"), _read_code("look.c")]
    pieces += [_read_code("skin.c")] if chip.skin else []
    if chip.watch:
        pieces += [_read_code("status.c"), chip.watch.code, _read_code("watch.c")]
    return "\n".join(pieces)
