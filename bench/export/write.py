"""The files of a system as C."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.corpora.steps import PASSES
from bench.export.classifiers import number
from bench.export.tables import Chip, chip_of
from features import touch

if TYPE_CHECKING:
    from bench.work.saved import Recogniser

CODE = Path(__file__).parent / "code"
TYPES = {"int8": "int8_t", "int16": "int16_t", "int32": "int", "float32": "float"}
PUBLIC = ("ROWS", "COLS", "TAXELS", "CLASSES", "RATE_HZ", "FULL_SCALE", "STOPPING", "THRESHOLD")
SETTLED = "settled: how settled the label is, 0 to 1; from TOUCH_THRESHOLD on, waiting for more gains too little."
NOT_SETTLED = "settled: always 0, as no moment was learned from which waiting for more gains too little."
TOP = """/* From frames to a label, in the order in which it happens: a frame is checked and repaired, joins what is
   kept of the capture, and, where a decision is due, features are computed and classified. touch_push and touch_label
   stand at the end. All that changes is in touch_t; what was learnt is in tables.h. */
"""
FUNCTIONS = ("measured", "layer", "softmax", "leaf", "machine")  # that a classifier may use, each in a file of its name
ABOUT = {  # by the first constant of each group
    "ROWS": "The sensor, classes and features; readings are 0 to FULL_SCALE.",
    "CHECKED": "Frames of make check, and most of a capture.",
    "SETTLED": "Repair: frames after which a taxel that has not moved is at rest, or broken; which kinds are repaired.",
    "WINDOW": "Frames of a window and from one to the next, and of the shorter ones before the first; 0 for none.",
    "CONVOLVED": "Frames of a window and from one to the next; windows that are open at a time; filters and pools.",
    "SEGMENT": "Spectra: frames of a segment, most points; lags of autocorrelations, in frames.",
    "STOPPING": "How settled a label must be, as training people have shown.",
    "CALIBRATED": "How sure a label may be after so many ms, as training people have shown.",
    "PASSES": "Rounds in which broken taxels are filled from their neighbours; labels that are remembered.",
    "SIGNALS": "Features of touch: signals of a frame, what is taken of each, and of the taxels in order of size.",
    "NAMES": "Classes, in the order of probabilities.",
}
REMEMBERED = {"PASSES": str(PASSES), "REMEMBERED": "32"}
CONSTANTS = REMEMBERED | {  # of the feature set touch
    "SIGNALS": str(len(touch.SIGNALS)),
    "STATISTICS": str(len(touch.STATISTICS)),
    "SPECTRAL": str(len(touch.SPECTRAL)),
    "LAGGED": str(len(touch.LAGGED)),
    "LAGS": str(len(touch.LAGS_S)),
    "BANDS": str(len(touch.BANDS) - 1),
    "SPREAD": str(touch.SPREAD),
    "POINTS": str(touch.POINTS),
    "ROW": str(touch.CENTRE[0]),
    "COL": str(touch.CENTRE[1]),
    "EPS": number(touch.EPS),
    "STILL": number(touch.STILL),
    "PI": number(math.pi),
}


def files_of(found: Recogniser, bits: int, about: str) -> dict[str, str]:
    """Names and contents of the files.

    Args:
        found: a saved system.
        bits: of a learnt weight, 32 or 8.
        about: what it is, in a line.

    Raises:
        InputError: it cannot become C.
    """
    chip = chip_of(found, bits)
    return {
        "touch.h": _header(chip, about, found.rate_hz),
        "tables.h": _tables(chip, bits),
        "touch.c": _code(chip),
        **{name: _fixed(name) for name in ("main.c", "count.c", "Makefile", "cortex_m4.c", "cortex_m4.ld")},
    }


def _fixed(name: str) -> str:
    return (CODE / name).read_text(encoding="utf-8")


def _header(chip: Chip, about: str, rate_hz: float) -> str:
    told = chip.defines | {"RATE_HZ": repr(rate_hz)}  # in full, as main.c counts hops with it
    public = "\n".join(f"#define TOUCH_{name} {told[name]}" for name in PUBLIC if name in told)
    settled = SETTLED if told["STOPPING"] == "1" else NOT_SETTLED
    return f"""/* {about} */
#ifndef TOUCH_H
#define TOUCH_H

#include <stdint.h>

{public}

/* Return codes below 0. */
#define TOUCH_BAD -1   /* no state or frame, or a reading that is not within 0 and the full scale */
#define TOUCH_LONG -2  /* the capture is longer than any that was learnt from: begin a new one */
#define TOUCH_EMPTY -3 /* nothing was touched yet */

{_state(chip)}
/* Begin a capture; the state is all the memory that is needed. */
int touch_init(touch_t *t);

/* Take a frame, row by row, readings from 0 to TOUCH_FULL_SCALE: 1 if there is a new decision, 0 if not yet, or a code.
   A frame that is refused changes nothing. */
int touch_push(touch_t *t, const float *frame);

/* The class of what has been seen since the beginning, or a code; and probabilities of all classes.
   {settled}
   settled may be NULL. */
int touch_label(touch_t *t, float *probabilities, float *settled);

/* What a class is called. */
const char *touch_name(int label);

#endif
"""


def _state(chip: Chip) -> str:
    """What is kept between frames, and what features and classifier work in."""
    d = chip.defines
    taxels, classes = int(d["TAXELS"]), int(d["CLASSES"])
    lines = [f"float frame[{taxels}];  /* this one, repaired */"]
    if d["REPAIR_STUCK"] == "1" or d["REPAIR_DEAD"] == "1":
        lines.append(f"float least[{taxels}], most[{taxels}], moved[{taxels}];  /* of each taxel in this capture */")
        lines.append(f"float sound[{taxels}], mean_around[{taxels}];  /* which taxels are, and what replaces others */")
    if d["REPAIR_OFFSET"] == "1":
        lines.append(f"float offset[{taxels}];  /* least reading so far */")
    if d["SCALE_PEAK"] == "1":
        lines.append("float peak;  /* largest reading so far */")
    part = ""
    if chip.features == "touch":
        window, points = int(d["WINDOW"]), int(d["MOST_POINTS"])
        part = f"""/* What the taxels did in half a window. */
typedef struct {{
    int n;
    float mean[{taxels}], m2[{taxels}], most[{taxels}];
}} part_t;

"""
        early = int(d["EARLY"]) > 0
        lines += [
            f"float before[{taxels}];  /* the last one */",
            f"float signals[{window}][{len(touch.SIGNALS)}];  /* of the last window, a ring */",
            f"part_t whole[2]{', early[2]' if early else ''};  /* halves of the last window */",
            f"float sum[{classes}]; int windows;  /* of decisions */",
            *(
                [f"float early_sum[{classes}]; int early_windows;  /* of shorter ones, before the first */"]
                if early
                else []
            ),
            f"float series[{window}], sorted[{window}], centre[{window}], taxels[{taxels}];  /* to work in */",
            f"float cosine[{points}], sine[{points}], power[{points // 2}]; int points;  /* of spectra */",
        ]
    elif chip.features == "convolved":
        maps = f"{d['FILTERS1']}][{d['MAP']}"
        sums = f"{d['FILTERS2']}][{d['SUM_FRAMES']}][{d['SUM_ROWS']}][{d['SUM_COLS']}"
        lines += [
            f"float ring[{d['KERNEL1_FRAMES']}][{taxels}];  /* the last frames */",
            f"float maps[{maps}], kept_maps[{maps}];  /* of the first layer, at the last time */",
            f"float sums[{d['OPEN']}][{sums}], kept_sums[{sums}];  /* of the second, of each open window */",
            f"float sum[{classes}]; int windows;  /* of decisions */",
        ]
    else:
        lines += [
            f"float before[{taxels}];  /* the last one */",
            f"float total[{d['LONGEST']}];  /* of each frame */",
            f"float row[{d['ROWS']}], col[{d['COLS']}], centre[2], distance[2];  /* means, the last, path so far */",
            "float change, area, area_there, highest, highest_total;  /* means, and of the strongest frame */",
        ]
    lines.append(f"float features[{d['FEATURES']}], proba[{classes}];")
    buffers: dict[str, int] = {}
    for decider in chip.deciders.values():
        buffers |= {k: max(v, buffers.get(k, 0)) for k, v in decider.buffers.items()}
    lines += [f"float {name}[{size}];  /* the classifier works in it */" for name, size in buffers.items()]
    if d["STOPPING"] == "1":
        lines.append(
            "int remembered, label_at[32]; int16_t labels[32];  /* labels so far, and after how many frames */"
        )
    body = "\n".join(f"    {line}" for line in lines)
    return f"{part}typedef struct {{\n    int seen;  /* frames */\n{body}\n}} touch_t;\n"


def _tables(chip: Chip, bits: int) -> str:
    names = ", ".join(f'"{_escaped(name)}"' for name in chip.classes)
    constants = CONSTANTS if chip.features == "touch" else REMEMBERED
    defines = {**chip.defines, **constants, "NAMES": f"{{{names}}}"}
    lines = []
    for name, value in defines.items():
        if name in ABOUT:
            lines.append(f"\n/* {ABOUT[name]} */")
        lines.append(f"#define {name} {value}")
    lines.append("")
    lines.append(f"typedef {'int8_t' if bits == 8 else 'float'} weight_t;")
    if any("vectors" in decider.arrays for decider in chip.deciders.values()):
        lines.append(f"typedef {'int16_t' if bits == 8 else 'float'} vector_t;")
    if any("nodes" in decider.arrays for decider in chip.deciders.values()):
        lines.append("typedef struct { int16_t feature; uint16_t right; float threshold; } node_t;")
    lines += [_array(name, values) for name, values in chip.arrays.items()]
    for function, decider in chip.deciders.items():
        for name, values in decider.arrays.items():
            lines.append(_array(f"{function}_{name}", values))
    return "/* Sizes, and what was learnt. */\n" + "\n".join(lines) + "\n"


def _escaped(name: str) -> str:
    """A class name inside a C string; what is not ASCII as its bytes."""
    return "".join(chr(b) if 32 <= b < 127 and chr(b) not in '"\\?' else f"\\{b:03o}" for b in name.encode())


def _array(name: str, values: np.ndarray) -> str:
    flat = values.ravel()
    if flat.dtype.names:
        cells = [f"{{{v['feature']}, {v['right']}, {number(v['threshold'])}}}" for v in flat]
        kind = "node_t"
    elif flat.dtype.kind == "f":
        cells, kind = [number(v) for v in flat], "float"
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


def _code(chip: Chip) -> str:
    pieces = [
        f'{TOP}\n#include "touch.h"\n\n#include <math.h>\n#include <string.h>\n\n#include "tables.h"\n',
        _fixed("frame.c"),
    ]
    pieces.append(_fixed(f"features_{chip.features}.c"))
    used = "".join(decider.body for decider in chip.deciders.values())
    used += "softmax(" if chip.defines["CALIBRATED"] == "1" else ""
    pieces += [_fixed(f"{name}.c") for name in FUNCTIONS if f"{name}(" in used]
    for function, decider in chip.deciders.items():
        body = decider.body.format(**{name: f"{function}_{name}" for name in decider.arrays})
        about = f"/* Probabilities from the features: {decider.about}. */\n"
        pieces.append(f"{about}static void {function}(touch_t *t, float *proba)\n{{\n{body}}}\n")
    return "\n".join([*pieces, _fixed("api.c")])
