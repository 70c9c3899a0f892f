"""The folder of a build: C, examples, a test with expected results, and the certificate."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.digests import json_with_digest
from bench.ground.scratch import check_empty_folder, fill_then_rename, remove_path
from bench.running.saved import Recogniser
from touchbench_builder.certificate import render_page, summary_lines
from touchbench_builder.stream import count_other_reports, reports_of_news
from touchbench_chip.classifiers import format_float
from touchbench_chip.measure import compile_labeller, compile_watcher
from touchbench_chip.write import PREFIX, rename_public, write_c_sources

if TYPE_CHECKING:
    import pandas as pd

CODE = Path(__file__).parent / "code"
CERTIFICATE = "certificate.json"
VECTOR_S = 2.0  # of a capture in vectors.h
READINGS_PER_LINE = 15
VECTORS = """/* The first {seconds:g} s of a capture of each class, and predictions of Python. */
#include <stdint.h>
#define VECTORS {count}
#define READING {reading}
static const struct {{
    int frames, label;
    float probabilities[TOUCH_CLASSES];
}} vectors[VECTORS] = {{
{rows}
}};
static const READING readings[] = {{
{lines}
}};
"""


def check_build_folder(out: Path, replaces: bool) -> Path:
    """Return a folder that is new or empty, or has an earlier build to replace."""
    if not shutil.which("cc") or not shutil.which("make"):
        raise InputError(
            "bench build needs cc and make, which are not installed; on Debian, install gcc make"
        )
    earlier = _earlier_build(out)
    if earlier.is_dir():  # a command was killed between two names
        remove_path(earlier) if out.exists() else earlier.rename(out)
    if not (out / CERTIFICATE).is_file():
        return check_empty_folder(out)
    if not replaces:
        raise InputError(
            f"out={out}: an earlier build is there; replace it with replace=yes, or name another "
            "folder"
        )
    return out


def _earlier_build(out: Path) -> Path:
    """Place of an earlier build until the new one has its name."""
    return out.absolute().with_name(f".{out.name}.earlier")


def write_build(
    out: Path,
    recogniser: Recogniser,
    facts: dict[str, Any],
    corpus: Corpus,
    recording: Corpus | None,
) -> None:
    """Write the folder of a build and test its C; then it replaces an earlier build.

    Args:
        out: the folder.
        recogniser: the model.
        facts: content of the certificate, which gets what the C does.
        corpus: captures that the C labels.
        recording: one that the C watches; None if it cannot.
    """
    texts = source_texts(recogniser, facts, header_lines(facts), corpus)
    prefix = facts["system"]["prefix"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_texts(folder, texts)
        labels, _ = label_with_c(folder, recogniser.classes, corpus, prefix)
        others = int((recogniser.label(corpus)["label"].to_numpy() != labels).sum())
        (model,) = re.findall(r'(?m)^#define \w+_MODEL "(\w+)"', texts["touch.h"])
        facts["c"] = {"captures": len(corpus), "other_labels": others, "model": model}
        if recording is not None and recogniser.watcher is not None:
            reports = recogniser.watcher.report_touches(recording)
            of_c = watch_with_c(folder, recogniser.classes, recording, prefix)
            facts["c"] |= {"reports": len(reports)}
            facts["c"] |= {"other_reports": count_other_reports(reports, of_c)}
            minutes = recording.lengths.sum() / recording.rate_hz / 60
            facts["c"] |= {"watched_minutes": round(float(minutes), 1)}
        certificate = json_with_digest(json.dumps(facts, indent=1, ensure_ascii=False) + "\n")
    write_tested(out, texts | {CERTIFICATE: certificate, "README.md": render_page(facts)})


def source_texts(
    recogniser: Recogniser, facts: Mapping[str, Any], head: list[str], corpus: Corpus
) -> dict[str, str]:
    """Files of C by name, with examples and a test; ``head`` is that of ``touch.h``."""
    bits, prefix = facts["system"]["bits"], facts["system"]["prefix"]
    chip, board = facts["chip"], facts["board"]
    if chip and recogniser.watcher is not None:
        recogniser.watcher = replace(recogniser.watcher, slices=chip["slices"])
    texts = write_c_sources(recogniser, bits, "\n   ".join(head), prefix)
    for name in ("flash", "ram") if board else ():  # of make chip
        size = f"{name.upper()} = {board[f'{name}_kb'] / 1.024:.0f}K"
        texts["Makefile"] = re.sub(rf"(?m)^{name.upper()} = .*$", size, texts["Makefile"])
    texts["touch.c"] = f"/* {origin_comment(facts)} */\n\n{texts['touch.c']}"
    more = {path.name: path.read_text(encoding="utf-8") for path in CODE.iterdir()}
    more["vectors.h"] = vectors_header(recogniser, corpus)
    more = {name: rename_public(text, prefix) for name, text in more.items()}
    texts["Makefile"] += more.pop("Makefile.more")
    return texts | more


def write_tested(out: Path, texts: Mapping[str, str]) -> None:
    """Run the test of files of C, then write them; they replace an earlier build."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_texts(folder, texts)
        _run_own_test(folder)
        with fill_then_rename(out) as complete:
            for path in folder.iterdir():
                shutil.copyfile(path, complete / path.name)
            if out.exists():
                out.rename(_earlier_build(out))
        if _earlier_build(out).exists():
            remove_path(_earlier_build(out))


def _write_texts(folder: Path, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def header_lines(facts: Mapping[str, Any]) -> list[str]:
    """Head of ``touch.h``: corpus, people, accuracy to expect, and what another session costs.

    Operating points have the alarms.
    """
    lines = [*origin_lines(facts), *summary_lines(facts)]
    if sessions := facts["sessions"]:
        between = " and ".join(sessions["values"])
        cost = f"{sessions['cost']:.1f} points ({sessions['column']} {between})"
        lines.append(f"Not included: in another session than those of training, it loses {cost}.")
    return lines


def origin_lines(facts: Mapping[str, Any]) -> list[str]:
    """Lines of the head of ``touch.h`` about captures and people."""
    data = facts["data"]
    kind = "synthetic " if data["synthetic"] else ""
    grid, people = "x".join(map(str, data["grid"])), f"{data['people']} people of {data['corpus']}"
    return [
        f"touchbench: {len(data['gestures'])} classes of {kind}touch on {grid} taxels at "
        f"{data['rate_hz']:g} Hz.",
        f"{facts['system']['name']}, from {data['captures']} {kind}captures of {people}.",
    ]


def origin_comment(facts: Mapping[str, Any]) -> str:
    """Comment of ``touch.c``: model, data and command."""
    system, data = facts["system"], facts["data"]
    command = facts["command"].replace("*/", "* /").replace("/*", "/ *")
    return (
        f"Model {system['model']}; data {data['corpus']}, digest {data['digest']};\n"
        f"   C, digest {system['code']}; touchbench {facts['touchbench']}:\n   {command}"
    )


def label_with_c(
    folder: Path, classes: list[str], corpus: Corpus, prefix: str = PREFIX
) -> tuple[np.ndarray, np.ndarray]:
    """Labels of captures by the C of a folder, and True for those that look unlike training.

    The C is compiled for this machine, outside of the folder.
    """
    with _compiled(folder) as copy:
        run = compile_labeller(copy, len(classes), prefix)
        answers = [run(frames) for frames in corpus]
    labels = np.array([classes[int(proba.argmax())] for proba, _ in answers], dtype=object)
    return labels, np.array([unlike for _, unlike in answers])


def watch_with_c(
    folder: Path, classes: list[str], recordings: Corpus, prefix: str = PREFIX
) -> pd.DataFrame:
    """Reports of ``touch_watch``, by the C of a folder, on recordings."""
    with _compiled(folder) as copy:
        run = compile_watcher(copy, prefix)
        news = [run(frames) for frames in recordings]
    return reports_of_news(news, recordings, classes)


@contextmanager
def _compiled(folder: Path) -> Iterator[Path]:
    """A temporary copy of the C of a folder, to be compiled; errors are one line."""
    with tempfile.TemporaryDirectory() as name:
        try:
            for file in ("touch.c", "touch.h", "tables.h"):
                shutil.copyfile(folder / file, Path(name, file))
            yield Path(name)
        except (OSError, ValueError) as e:  # no such file, no compiler, changed C
            raise InputError(f"{folder}: its C cannot be run: {e}; build it again") from e


def vectors_header(recogniser: Recogniser, corpus: Corpus) -> str:
    """First seconds of a capture of each class, with label and probabilities of Python, as C."""
    members = [np.flatnonzero(corpus.gestures.astype(str) == name) for name in recogniser.classes]
    examples = corpus[np.array([rows[len(rows) // 2] for rows in members if len(rows)])].detach()
    lengths = np.minimum(examples.lengths, round(VECTOR_S * corpus.rate_hz))
    examples = examples.with_fields(lengths=lengths, digest="", path=None)
    table = recogniser.label(examples)
    probabilities = table[[f"p_{name}" for name in recogniser.classes]].to_numpy()
    rows = []
    for length, label, row in zip(lengths, table["label"], probabilities, strict=True):
        shares = ", ".join(f"{share:.6f}f" for share in row)
        rows.append(f"    {{{length}, {recogniser.classes.index(label)}, {{{shares}}}}},")
    values = np.concatenate([frames.ravel() for frames in examples])
    fits_uint16 = float(values.max()) < 2**16 and (values == np.rint(values)).all()
    texts = [str(int(value)) if fits_uint16 else format_float(value) for value in values]
    starts = range(0, len(texts), READINGS_PER_LINE)
    lines = [f"    {', '.join(texts[i : i + READINGS_PER_LINE])}," for i in starts]
    return VECTORS.format(
        seconds=VECTOR_S,
        count=len(rows),
        reading="uint16_t" if fits_uint16 else "float",
        rows="\n".join(rows),
        lines="\n".join(lines),
    )


def _run_own_test(folder: Path) -> None:
    """Compile and run the test of the folder as its user does, and remove the program."""
    command = ["make", "-s", "test"]
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if process.returncode:
        text = " ".join((process.stdout + process.stderr).split())
        raise InputError(f"the C does not pass its own test, so nothing is written: {text[-200:]}")
    (folder / "test_touch").unlink()
