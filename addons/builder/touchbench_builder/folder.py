"""The folder of a build: C, examples, tests with golden vectors, and the certificate."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.scratch import made_whole, new_folder, remove
from bench.running.saved import Recogniser
from touchbench_builder.certificate import line, page
from touchbench_chip.classifiers import number
from touchbench_chip.measure import compiled
from touchbench_chip.write import files_of

CODE = Path(__file__).parent / "code"
JSON = "certificate.json"
VECTOR_S = 2.0  # of a capture in vectors.h
COLUMNS = 15  # readings in a row
VECTORS = """/* The first {seconds:g} s of a capture of each class, and what Python predicts. */
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


def new_build(out: Path, replaces: bool) -> Path:
    """A folder that is new or empty, or holds an earlier build that may be replaced."""
    if not shutil.which("cc") or not shutil.which("make"):
        raise InputError(
            "bench build needs cc and make, which are not installed; on Debian, install gcc make"
        )
    if (earlier := _earlier(out)).is_dir():  # a kill came between two names
        remove(earlier) if out.exists() else earlier.rename(out)
    if replaces and (out / JSON).is_file():
        return out
    if (out / JSON).is_file():
        raise InputError(
            f"out={out}: an earlier build is there; replace it with replace=yes, or name another folder"
        )
    return new_folder(out)


def _earlier(out: Path) -> Path:
    """The place of an earlier build while the new one takes its name."""
    return out.absolute().with_name(f".{out.name}.earlier")


def write(
    out: Path, recogniser: Recogniser, facts: dict[str, Any], corpus: Corpus, replaces: bool
) -> None:
    """Write the folder of a build, and test its C."""
    texts = files_of(recogniser, facts["system"]["bits"], "\n   ".join(heading(facts)))
    texts["touch.c"] = f"/* {origin(facts)} */\n\n{texts['touch.c']}"
    texts["Makefile"] += (CODE / "Makefile.more").read_text(encoding="utf-8")
    texts |= {
        path.name: path.read_text(encoding="utf-8")
        for path in CODE.iterdir()
        if path.suffix != ".more"
    }
    texts["vectors.h"] = vectors(recogniser, corpus)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _put(folder, texts)
        in_c, _ = labelled(folder, recogniser.classes, corpus)
        others = int((recogniser.label(corpus)["label"].to_numpy() != in_c).sum())
        facts["c"] = {"captures": len(corpus), "other_labels": others}
        _put(
            folder,
            {
                JSON: json.dumps(facts, indent=1, ensure_ascii=False) + "\n",
                "README.md": page(facts),
            },
        )
        _tested(folder)
        _placed(folder, out, replaces)


def _put(folder: Path, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _placed(folder: Path, out: Path, replaces: bool) -> None:
    """Give a folder its name; an earlier build makes room only when the new one lies beside it."""
    with made_whole(out) as beside:
        beside.mkdir()
        for path in folder.iterdir():
            shutil.copyfile(path, beside / path.name)
        if replaces and out.is_dir():
            out.rename(_earlier(out))
    if _earlier(out).exists():
        remove(_earlier(out))


def heading(facts: Mapping[str, Any]) -> list[str]:
    """The head of ``touch.h``: corpus, people, accuracy to expect; alarms stand at its operating points."""
    data = facts["data"]
    kind = "synthetic " if data["synthetic"] else ""
    grid = "x".join(map(str, data["grid"]))
    return [
        f"touchbench: {len(data['gestures'])} classes of {kind}touch on {grid} taxels at {data['rate_hz']:g} Hz.",
        f"{facts['system']['name']}, from {data['captures']} {kind}captures of {data['people']} people of "
        f"{data['corpus']}.",
        *line(facts),
    ]


def origin(facts: Mapping[str, Any]) -> str:
    """The comment of ``touch.c``: what it was made of, and by which command."""
    system, data = facts["system"], facts["data"]
    command = facts["command"].replace("*/", "* /").replace("/*", "/ *")
    return (
        f"Model {system['model']}; data {data['corpus']}, digest {data['digest']};\n"
        f"   C, digest {system['code']}; touchbench {facts['touchbench']}:\n   {command}"
    )


def labelled(folder: Path, classes: list[str], corpus: Corpus) -> tuple[np.ndarray, np.ndarray]:
    """Labels of captures by the C of a folder, and which look unlike training; compiled elsewhere for this machine."""
    with tempfile.TemporaryDirectory() as name:
        try:
            for file in ("touch.c", "touch.h", "tables.h"):
                shutil.copyfile(folder / file, Path(name, file))
            run = compiled(Path(name), len(classes))
            answers = [run(frames) for frames in corpus]
        except (
            OSError,
            ValueError,
        ) as e:  # a file or a compiler that is not there, C that was changed
            raise InputError(f"{folder}: its C cannot be run: {e}; build it again") from e
    labels = np.array([classes[int(proba.argmax())] for proba, _ in answers], dtype=object)
    return labels, np.array([unlike for _, unlike in answers])


def vectors(recogniser: Recogniser, corpus: Corpus) -> str:
    """The beginning of a capture of each class, with label and probabilities in Python, as C."""
    names = corpus.gestures.astype(str)
    picked = np.array(
        [
            np.flatnonzero(names == name)[len(names[names == name]) // 2]
            for name in recogniser.classes
        ]
    )
    some = corpus[picked].detached()
    some = some.changed(
        lengths=np.minimum(some.lengths, round(VECTOR_S * corpus.rate_hz)), digest="", path=None
    )
    table = recogniser.label(some)
    proba = table[[f"p_{name}" for name in recogniser.classes]].to_numpy()
    whole = all(
        float(frames.max()) < 2**16 and (frames == np.rint(frames)).all() for frames in some
    )
    rows = [
        f"    {{{len(frames)}, {recogniser.classes.index(label)}, {{{', '.join(f'{share:.6f}f' for share in row)}}}}},"
        for frames, label, row in zip(some, table["label"], proba, strict=True)
    ]
    values = np.concatenate([frames.ravel() for frames in some])
    texts = [str(int(value)) if whole else number(value) for value in values]
    lines = [f"    {', '.join(texts[i : i + COLUMNS])}," for i in range(0, len(texts), COLUMNS)]
    return VECTORS.format(
        seconds=VECTOR_S,
        count=len(rows),
        reading="uint16_t" if whole else "float",
        rows="\n".join(rows),
        lines="\n".join(lines),
    )


def _tested(folder: Path) -> None:
    """Compile and run the test of the folder as its user does, and remove what that made."""
    done = subprocess.run(
        ["make", "-s", "test"], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        lines = " ".join((done.stdout + done.stderr).split())
        raise InputError(f"the C does not pass its own test, so nothing is written: {lines[-200:]}")
    (folder / "test_touch").unlink()
