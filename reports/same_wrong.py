"""Captures with the same wrong label from all systems, as film strips beside correctly labelled captures."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.comparable import several
from bench.corpora.corpus import Corpus
from bench.corpora.library import imported, open_corpus
from bench.errors import InputError
from bench.outcomes.same_wrong import COLUMNS, PROBABILITY, Agreement
from bench.reports.corpus_page import FILMED, ROOT, place
from bench.table import of_text

SHOWN, ROOM = 60, 375_000  # captures of a group, and bytes of their images before they are encoded
POINTS, HIGH = 120, 30  # of a curve: points, and height of its drawing
COLOURS = 128  # besides that of the gaps between frames
NO_CONDITIONS = {*COLUMNS, "right", "split"}
Film = tuple[str, str, str]  # words, the PNG in base64, the points of the curve


def same_wrong_section(found: Agreement) -> dict[str, Any]:
    """The listed captures as a table, or by pair of labels with film strips if the corpus is on this machine."""
    rows = found.same_wrong
    corpus, missing = _opened(found)
    room = SHOWN if corpus is None else max(1, ROOM // (3 * (1000 + FILMED * int(np.prod(corpus.grid)))))
    shown = rows.head(min(SHOWN, room))
    pairs: dict[str, list[tuple[str, list[Film]]]] = {}
    for (true, predicted), part in shown.groupby(["true", "predicted"], sort=False):
        people = rows.loc[(rows["true"] == true) & (rows["predicted"] == predicted), "subject"].value_counts()
        counts = ", ".join(f"{n} of subject {name}" for name, n in people.items())
        pairs[f"{true}, predicted as {predicted}: {several(people.sum(), 'capture')} ({counts})"] = [
            (_words(row), list(_films(corpus, found, row))) for row in part.to_dict("records") if corpus is not None
        ]
    table = of_text(shown.round({PROBABILITY: 2}).rename(columns={"true": "label"}).astype(str))
    left_out = len(rows) - len(shown)
    return {"found": found, "listed": len(rows), "table": table, "left_out": left_out, "pairs": pairs, "why": missing}


def _opened(found: Agreement) -> tuple[Corpus | None, str]:
    """The corpus that the runs tested, or the reason why its frames cannot be shown."""
    name = str(found.run["data"])
    if found.run["synthetic"] == "true" or not {*name.split("+")} <= {*imported()}:
        return None, "the captures are generated" if found.run["synthetic"] == "true" else f"{name} is not imported"
    try:
        corpus = open_corpus(name, {})
    except InputError as e:
        return None, str(e)
    same = corpus.digest == found.run["corpus_digest"]
    return (corpus, "") if same else (None, f"{name} has changed since these runs")


def _words(row: dict) -> str:
    about = {"subject": row["subject"]} | {k: v for k, v in row.items() if k not in NO_CONDITIONS}
    words = ", ".join(f"{k} {v}" for k, v in about.items())
    return f"{words}; mean probability of {row['predicted']}: {row[PROBABILITY]:.2f}"


def _films(corpus: Corpus, found: Agreement, row: dict) -> Iterator[Film]:
    """Films of a capture, and of one with each of the two labels from the same person, all with the same scales.

    Most systems label these correctly, and they have as many conditions of the capture as possible. Where most systems
    label none correctly, the one with most correct labels is taken.
    """
    k, conditions = len(found.systems), [name for name in row if name not in NO_CONDITIONS]
    films = {row["capture"]: f"capture {row['capture']}: labelled {row['true']}, all predict {row['predicted']}"}
    others = found.table[(found.table["subject"] == row["subject"]) & (found.table["right"] > 0)]
    for name in (row["true"], row["predicted"]):
        beside = others[others["true"] == name].to_dict("records")
        rank = [(2 * o["right"] > k, sum(o[c] == row[c] for c in conditions), o["right"]) for o in beside]
        if beside:
            one = beside[max(range(len(rank)), key=rank.__getitem__)]
            parts = [f"{name}, {one['right']} of {k} systems are correct", *(str(one[c]) for c in conditions)]
            films[one["capture"]] = f"capture {one['capture']}: {', '.join(parts)}"
    frames = [corpus[place(corpus, capture)] for capture in films]
    totals = [each.sum(axis=(1, 2), dtype=np.float64) for each in frames]
    low, high = min(map(np.min, totals)), max(map(np.max, totals))
    most = max(float(each.max()) for each in frames)
    for words, each, total in zip(films.values(), frames, totals, strict=True):
        yield f"{words}, {len(each) / corpus.rate_hz:.1f} s", strip(each, most), curve(total, low, high)


def strip(frames: np.ndarray, most: float) -> str:
    """The middle frames of the eighths of a capture, side by side: a PNG in base64 with one pixel per taxel.

    Args:
        frames: sensor values [frames, rows, cols].
        most: value of the brightest colour; colours follow the square root.
    """
    from matplotlib import colormaps
    from PIL import Image

    shown = frames[(len(frames) * (np.arange(FILMED) + 0.5) / FILMED).astype(int)]
    level = np.round((shown / max(most, 1e-9)).clip(0, 1) ** ROOT * (COLOURS - 1)).astype(np.uint8)
    tiles = np.pad(level, ((0, 0), (0, 0), (0, 1)), constant_values=COLOURS)
    image = Image.fromarray(np.concatenate(tiles, axis=1)[:, :-1])
    colours = np.round(colormaps["magma"](np.linspace(0, 1, COLOURS))[:, :3] * 255).astype(np.uint8)
    image.putpalette(colours.tobytes() + bytes(3))
    buffer = io.BytesIO()
    image.save(buffer, "PNG", transparency=COLOURS)
    return base64.b64encode(buffer.getvalue()).decode()


def curve(total: np.ndarray, low: float, high: float) -> str:
    """Points of an SVG polyline of the total pressure; of many frames, the highest of each part.

    Args:
        total: pressure summed over the taxels [frames].
        low: value at the lower edge.
        high: value at the upper edge.
    """
    starts = np.unique(np.arange(POINTS) * len(total) // POINTS)
    y = HIGH * (high - np.maximum.reduceat(total, starts)) / max(high - low, 1e-9)
    return " ".join(f"{a:.4g},{b:.3g}" for a, b in zip((starts + 0.5) * POINTS / len(total), y, strict=True))
