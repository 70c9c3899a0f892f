"""What buys what: from a published classifier on published features to `reflex`, one addition at a time.

    python studies/ablation.py data=haart protocol=loso "rows=reflex;lda, touch"

runs every row by `bench stream` and `bench stress` and writes a table and a figure to ``out=``; without ``rows=`` all
of `ROWS`. Stored folds are not run again. ``rows=networks`` runs every network as it is published and with scaling,
repair, damaged and turned copies, on the challenge split; ``device=`` says where networks are trained.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import bench
from bench.arguments import parse
from bench.errors import nearest
from bench.reports.figures import new_figure, save

LDA, XGB, ROCKET, REFLEX = ({"model": name} for name in ("lda", "xgb", "rocket", "reflex"))
JUNG, TOUCH = {"features": "jung54"}, {"features": "touch"}
WINDOWS, TWO = {"model.window": "1.0"}, {"model.windows": "2"}
REPAIR, FAULTS, FEW = {"model.repair": "stuck+dead"}, {"model.faults": "all"}, {"model.damaged": "0.1"}
# cut short: the epochs of the paper take hours
HUGHES = {"model": "hughes2017_cnn", "model.epochs": "6", "model.rate": "1e-3"}
PERCEPTRON = {"model": "perceptron", "model.units": "18", "model.copies": "8"}
ROWS: dict[str, dict[str, str]] = {
    "svm, jung54": {"model": "svm"} | JUNG,
    "svm, touch": {"model": "svm"} | TOUCH,
    "lda, jung54": LDA | JUNG,
    "lda, touch": LDA | TOUCH,
    "lda, touch, windows": LDA | TOUCH | WINDOWS | TWO,
    "lda, touch, windows, repair": LDA | TOUCH | WINDOWS | TWO | REPAIR,
    "lda, touch, windows, repair, faults": LDA | TOUCH | WINDOWS | TWO | REPAIR | FAULTS | FEW,
    "perceptron, touch, windows, repair, faults": PERCEPTRON | TOUCH | WINDOWS | REPAIR | FAULTS,
    "reflex": REFLEX,
    "reflex without faults": REFLEX | {"model.faults": "none"},
    "reflex without repair": REFLEX | {"model.repair": "none"},
    "reflex, windows of 4 s": REFLEX | {"model.window": "4.0"},
    "lda, jung54, windows, repair, faults": LDA | JUNG | WINDOWS | TWO | REPAIR | FAULTS | FEW,
    "xgb, jung54": XGB | JUNG,
    "xgb, touch": XGB | TOUCH,
    "xgb, touch, windows, repair": XGB | TOUCH | WINDOWS | REPAIR,
    "xgb, touch, repair, faults": XGB | TOUCH | REPAIR | FAULTS,  # on windows besides, it takes hours
    "rocket": ROCKET,
    "rocket, windows, repair": ROCKET | {"model.window": "2.0"} | REPAIR,
    "rocket, repair, faults": ROCKET | REPAIR | FAULTS,
    "hughes2017_cnn": HUGHES,
    "hughes2017_cnn, repair, faults": HUGHES | REPAIR | FAULTS | {"model.copies": "1"},
}
# As published, with epochs; rates and epochs of hughes2017 as one group of HAART's training subjects chose them
# (docs/notes/networks.md). touchnet counts updates, and mirrors and turns by itself.
NETWORKS: dict[str, tuple[dict[str, str], int]] = {
    "touchnet": ({}, 0),
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
SAME = REPAIR | FAULTS | {"model.scale": "log", "model.copies": "1"}
CHANCES = {label: ROWS[label] for label in ("reflex", "lda, touch")}
for network, (published, epochs) in NETWORKS.items():
    keys, turns = {"model": network} | published, {"model.turns": "1"} if epochs else {}
    # With copies there are four captures to learn from for each one, so a quarter of the epochs.
    many, few = ({"model.epochs": str(n)} if epochs else {} for n in (epochs, round(epochs / 4)))
    CHANCES[f"{network} as published"] = keys | many
    CHANCES[f"{network} with scaling, repair, faults{', turns' if turns else ''}"] = keys | SAME | turns | few
SHOWN = {
    "accuracy": "% of captures",
    "accuracy_at_500_ms": "% after 0.5 s",
    "accuracy_at_1000_ms": "% after 1 s",
    "loss": "points lost, mean of all faults",
    "flash kB": "kB of flash, 32 bits",
}


def measured(label: str, values: dict[str, str], out: Path) -> dict[str, object]:
    """One row: percent, loss in points as the mean over faults and severities, flash in kB."""
    stream = bench.stream(**values, out=str(out / "stream")).full.iloc[0]
    stress = bench.stress(**values, out=str(out / "stress")).full.iloc[0]
    row = {"row": label} | stream.reindex(["data", "protocol", "folds", *SHOWN, "fit_seconds"]).to_dict()
    row |= {"low": stream.get("accuracy_low"), "high": stream.get("accuracy_high")}
    return row | {"loss": 100 * stress.filter(like="loss.").mean(), "flash kB": stream.get("flash_bytes", np.nan) / 1e3}


def drawn(table: pd.DataFrame, out: Path) -> None:
    """A panel per measure, a bar per row, in the order in which they were run."""
    figure, axes = new_figure((13, 1.2 + 0.24 * len(table)), (1, len(SHOWN)), (3.0, 0.2, 0.6, 0.5), (0.25, 0.9))
    place = np.arange(len(table))[::-1]
    for axis, (name, words) in zip(axes[0], SHOWN.items(), strict=True):
        shown = table[name].to_numpy(float)
        bars = axis.barh(place, shown, height=0.6, color=["tab:red" if "reflex" in r else "C0" for r in table["row"]])
        axis.bar_label(bars, fmt=" {:.1f}", fontsize=8)
        axis.set_xlim(0, 1.25 * np.nanmax(shown))
        axis.set_xlabel(words)
        axis.set_yticks(place, table["row"] if axis is axes[0][0] else [""] * len(table))
        axis.spines[["top", "right"]].set_visible(False)
    context = ", ".join(table.loc[0, ["data", "protocol"]])
    caption = f"{context}: what every addition does to accuracy, early labels, faults and size"
    save(figure, out, "ablation", context, caption)


def main(words: list[str]) -> pd.DataFrame:
    """Run the rows, write the table and the figure, return the table."""
    values = parse(words, {"data", "protocol", "rows", "out", "jobs", "device"})
    labels = [*ROWS] if "rows" not in values else values["rows"].split(";")
    protocol = "challenge" if labels == ["networks"] else "loso"
    labels = [label for name in labels for label in (CHANCES if name == "networks" else [name])]
    rows, out = ROWS | CHANCES, Path(values.get("out", "ablation"))
    for label in labels:
        if label not in rows:
            raise bench.InputError(f"rows={label}: not known; {nearest(label, rows)}")
    shared = {"data": "haart", "protocol": protocol}
    shared |= {k: v for k, v in values.items() if k.split(".")[0] in ("data", "protocol", "jobs")}
    device = {"model.device": values["device"]} if "device" in values else {}
    runs = {label: shared | rows[label] | (device if rows[label]["model"] in NETWORKS else {}) for label in labels}
    for keys in runs.values():
        if len(bench.plans(**keys)) > 1:
            raise bench.InputError("give one corpus, one protocol and one device")
    table = pd.DataFrame([measured(label, keys, out) for label, keys in runs.items()])
    table.to_csv(out / "ablation.csv", index=False)
    drawn(table, out)
    return table


if __name__ == "__main__":
    try:
        print(main(sys.argv[1:]).round(1).to_string(index=False))
    except bench.InputError as error:
        sys.exit(str(error))
