"""What buys what: from a published classifier on published features to `reflex`, one addition at a time.

``python -m reports.ablation`` runs every row by `bench run`, `bench stream` and `bench stress` on HAART, each subject
left out once, and writes a table and a figure. Folds that are stored are not run again. ``data=``, ``protocol=``,
``rows=`` (labels joined by ``;``) and ``out=`` change what is run, and where it goes. ``rows=networks`` runs every
network as it is published and with scaling, repair, damaged and turned copies, on the challenge split, whose training
people chose rates and epochs of some. ``device=`` says where networks learn.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from bench.commands.printing import console, writable
from bench.commands.stream import streamed
from bench.commands.stress import stressed
from bench.errors import InputError, nearest
from bench.outcomes.scores import subject_interval
from bench.outcomes.stopping import standing
from bench.plan.arguments import parse
from bench.plan.cells import cells
from models import contract
from reports.figures import Picture, new_figure, save

LDA = {"model": "lda"}
TOUCH = {"features": "touch"}
WINDOWS = {"model.window": "1.0"}
REPAIR = {"model.repair": "stuck+dead"}
FAULTS = {"model.faults": "all"}
# cut short, as in docs/haart.md: the epochs of the paper take hours
HUGHES = {"model": "hughes2017_cnn", "model.epochs": "6", "model.rate": "1e-3"}
ROWS: dict[str, dict[str, str]] = {
    "svm, jung54": {"model": "svm", "features": "jung54"},
    "svm, touch": {"model": "svm"} | TOUCH,
    "lda, jung54": LDA | {"features": "jung54"},
    "lda, touch": LDA | TOUCH,
    "lda, touch, windows": LDA | TOUCH | WINDOWS | {"model.windows": "2"},
    "lda, touch, windows, repair": LDA | TOUCH | WINDOWS | REPAIR | {"model.windows": "2"},
    "lda, touch, windows, repair, faults": LDA
    | TOUCH
    | WINDOWS
    | REPAIR
    | FAULTS
    | {"model.windows": "2", "model.damaged": "0.1"},
    "perceptron, touch, windows, repair, faults": {"model": "perceptron", "model.units": "18", "model.copies": "8"}
    | TOUCH
    | WINDOWS
    | REPAIR
    | FAULTS,
    "reflex": {"model": "reflex"},
    "reflex without faults": {"model": "reflex", "model.faults": "none"},
    "reflex without repair": {"model": "reflex", "model.repair": "none"},
    "reflex, windows of 4 s": {"model": "reflex", "model.window": "4.0"},
    "lda, jung54, windows, repair, faults": LDA
    | {"features": "jung54", "model.windows": "2", "model.damaged": "0.1"}
    | WINDOWS
    | REPAIR
    | FAULTS,
    "xgb, jung54": {"model": "xgb", "features": "jung54"},
    "xgb, touch": {"model": "xgb"} | TOUCH,
    "xgb, touch, windows, repair": {"model": "xgb"} | TOUCH | WINDOWS | REPAIR,
    "xgb, touch, repair, faults": {"model": "xgb"} | TOUCH | REPAIR | FAULTS,  # on windows besides, it takes hours
    "rocket": {"model": "rocket"},
    "rocket, windows, repair": {"model": "rocket", "model.window": "2.0"} | REPAIR,
    "rocket, repair, faults": {"model": "rocket"} | REPAIR | FAULTS,
    "hughes2017_cnn": HUGHES,
    "hughes2017_cnn, repair, faults": HUGHES | REPAIR | FAULTS | {"model.copies": "1"},
}
# Scaling, repair, damaged and turned copies: four captures to learn from for each one, so a quarter of the epochs.
SAME = REPAIR | FAULTS | {"model.scale": "log", "model.copies": "1", "model.turns": "1"}
# As published; rates and epochs of hughes2017 as one group of HAART's training people chose them (docs/networks.md).
NETWORKS: dict[str, tuple[dict[str, str], int]] = {
    "touchnet": ({}, 0),  # counts updates, and mirrors and turns by itself
    "zhou2016_3dcnn": ({}, 60),
    "hughes2017_cnn_rnn": ({"model.rate": "3e-3"}, 82),
    "hughes2017_cnn": ({"model.rate": "3e-3"}, 41),
    "ren2023_transformer": ({"model.precision": "bfloat16"}, 100),
    "zhou2016_lrcn": ({}, 60),
    "zhou2016_2dcnn": ({}, 60),
    "hughes2017_ae_rnn": ({"model.rate": "3e-3"}, 31),
    "cnn85": ({}, 50),
    "zhou2016_gm_lstm": ({}, 60),
}


def chances(name: str) -> dict[str, dict[str, str]]:
    """A network as published, and with what helps others: by label, the keys of its rows."""
    published, epochs = NETWORKS[name]
    own = {"model": name} | published
    if not epochs:
        alike = {k: v for k, v in SAME.items() if k != "model.turns"}
        return {f"{name} as it is": own, f"{name} with scaling, repair, faults": own | alike}
    alike = SAME | {"model.epochs": str(round(epochs / 4))}
    return {
        f"{name} as published": own | {"model.epochs": str(epochs)},
        f"{name} with scaling, repair, faults, turns": own | alike,
    }


CHANCES = {"reflex": ROWS["reflex"], "lda, touch": ROWS["lda, touch"]}
CHANCES |= {label: keys for network in NETWORKS for label, keys in chances(network).items()}
SHOWN = {
    "accuracy": "% of captures",
    "accuracy_500_ms": "% after 0.5 s",
    "accuracy_1000_ms": "% after 1 s",
    "loss": "points lost, mean of all faults",
    "flash_bytes": "kB of flash, 32 bits",
}


def main(arguments: list[str]) -> int:
    """Run the rows, print their table and write it and the figure."""
    values = parse(arguments, {"data", "protocol", "rows", "out", "jobs", "device"})
    for key in ("data", "protocol", "device"):
        if "," in values.get(key, ""):
            raise InputError(f"{key}={values[key]}: give one")
    known, named = ROWS | CHANCES, values["rows"].split(";") if "rows" in values else [*ROWS]
    asked = [label for name in named for label in (CHANCES if name == "networks" else [name])]
    for label in asked:
        if label not in known:
            raise InputError(f"rows={label}: not known; {nearest(label, known)}")
    protocol = "challenge" if "networks" in named else "loso"
    shared = {"data": "haart", "protocol": protocol}
    shared |= {k: v for k, v in values.items() if k.split(".")[0] in {"data", "protocol", "jobs"}}
    runs = {label: shared | known[label] | _device(label, values) for label in asked}
    if "device" in values and not any("model.device" in keys for keys in runs.values()):
        raise InputError(f"device={values['device']}: none of these rows is a network; leave it out")
    for keys in runs.values():
        for cell in cells({k: v for k, v in keys.items() if k != "jobs"}):
            contract.check(cell.estimator())
    out = writable(Path(values.get("out", "ablation")))
    rows, failed = [], []
    for label, keys in runs.items():
        console.print(label, style="bold")
        if found := measured(keys, out):
            context, numbers = found
            rows.append({"row": label} | numbers)
        else:
            failed.append(label)
    if failed:
        console.print(f"left out, for some of their folds failed: {'; '.join(failed)}", style="red", markup=False)
    if not rows:
        return 1
    table = pd.DataFrame(rows)
    table.to_csv(out / "ablation.csv", index=False)
    words = f"{context}; captures in percent, 95 % over people\n\n{markdown(table)}"
    (out / "ablation.md").write_text(words, encoding="utf-8")
    drawn(table, context, out)
    console.print(words, markup=False, soft_wrap=True)
    return 1 if failed else 0


def _device(label: str, values: dict[str, str]) -> dict[str, str]:
    """Where a row of `CHANCES` that is a network learns, if it was said."""
    deep = label in CHANCES and label not in ROWS
    return {"model.device": values["device"]} if deep and "device" in values else {}


def measured(values: dict[str, str], out: Path) -> tuple[str, dict[str, float]] | None:
    """Data and protocol, and one row in shares, loss the mean over faults and severities; None where a fold failed."""
    (replay,), _ = streamed(values)
    (stress,), _ = stressed(values | {"out": str(out / "stress")})
    if replay.errors or stress.errors:
        return None
    losses = [v for k, v in stress.metrics.items() if k.startswith("loss.")]
    found = {"accuracy": replay.metrics["accuracy"], "loss": float(np.mean(losses))}
    found |= {"low": replay.metrics["accuracy_low"], "high": replay.metrics["accuracy_high"]}
    table = pd.concat([result.table for result in replay.results], ignore_index=True)
    whole = standing(table, int(table["instant"].max()))
    found["subject_accuracy"] = float((whole["true"] == whole["predicted"]).groupby(whole["subject"]).mean().mean())
    for ms in (500, 1000):
        seen = standing(table, int(ms * replay.plan.corpus.rate_hz / 1000 + 1e-6))
        low, high = subject_interval(seen)
        found |= {f"accuracy_{ms}_ms": float((seen["true"] == seen["predicted"]).mean())}
        found |= {f"low_{ms}_ms": low, f"high_{ms}_ms": high}
    found |= {name: replay.metrics[name] for name in ("flash_bytes", "fit_seconds")}
    corpus = replay.plan.corpus
    kind = " (synthetic)" if corpus.synthetic else ""
    return f"{corpus.name}{kind}, {replay.tags['protocol_label']}", found


def markdown(table: pd.DataFrame) -> str:
    """The table as it goes into a page: percent, points and kB."""
    lines = ["| | captures | interval | subjects | 0.5 s | 1 s | mean loss | flash kB | fit s |", "|---" * 9 + "|"]
    for row in table.to_dict("records"):
        share = [f"{100 * row[name]:.1f}" for name in ("accuracy_500_ms", "accuracy_1000_ms", "loss")]
        lines.append(
            f"| {row['row']} | {100 * row['accuracy']:.1f} | {100 * row['low']:.0f} - {100 * row['high']:.0f} | "
            f"{100 * row['subject_accuracy']:.1f} | {' | '.join(share)} | {row['flash_bytes'] / 1e3:.0f} | "
            f"{row['fit_seconds']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def drawn(table: pd.DataFrame, context: str, out: Path) -> Picture:
    """A panel per measure, a bar per row, in the order in which they were run."""
    figure, axes = new_figure((13, 1.2 + 0.24 * len(table)), (1, len(SHOWN)), (3.0, 0.2, 0.6, 0.5), (0.25, 0.9))
    place = np.arange(len(table))[::-1]
    for axis, (name, words) in zip(axes[0], SHOWN.items(), strict=True):
        scale = 1e-3 if name == "flash_bytes" else 100
        shown = scale * table[name].to_numpy()
        axis.barh(place, shown, height=0.6, color=["tab:red" if "reflex" in r else "tab:blue" for r in table["row"]])
        for at, value in zip(place, shown, strict=True):
            axis.text(value, at, f" {value:.0f}" if scale < 1 else f" {value:.1f}", va="center", fontsize=8)
        axis.set_xlim(0, 1.25 * shown.max())
        axis.set_xlabel(words)
        axis.set_yticks(place, table["row"] if axis is axes[0][0] else [""] * len(table))
        axis.spines[["top", "right"]].set_visible(False)
    caption = f"{context}: what every addition does to accuracy, early labels, faults and size"
    return save(figure, out, "ablation", "ablation", context, caption)


if __name__ == "__main__":
    try:
        raise SystemExit(main(sys.argv[1:]))
    except InputError as error:
        console.print(str(error), style="red", markup=False)
        raise SystemExit(2) from error
