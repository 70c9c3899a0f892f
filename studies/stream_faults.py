"""What a sensor that changes after training costs a detector: touches found and false alarms by fault.

    python studies/stream_faults.py data=skin model=lda features=touch detector=filter,frames false_alarms=100

Each fold of LOSO trains a system and a detector on recordings as they are (or composed ones, as `bench watch` has
them), once. The recordings of the test subjects then go through one fault after another. It prints a row for each
detector and fault, with all touches pooled. ``folds=3`` tests on the first three subjects alone.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd

from bench.arguments import KEYS, parse
from bench.corpora.corpus import Corpus
from bench.corpora.faults import FAULTS, as_readings, seeded
from bench.corpora.recordings import Recordings
from bench.endless.detectors.named import detectors
from bench.endless.kind import Continuous
from bench.endless.watch import recordings_of, usual
from bench.outcomes.events import FALSE_ALARM, matched
from bench.plan.cells import cells
from bench.plan.plan import planned

VIBRATION_HZ = 3.0  # of a motor or a step
Change = Callable[[np.ndarray, float, np.random.Generator], np.ndarray]


def of(name: str, amount: float) -> Change:
    """A fault of captures, at some amount."""
    return lambda frames, rate_hz, rng: FAULTS[name].damage(frames, amount, rng)


def vibration(amount: float) -> Change:
    """All taxels swing together by so much of full scale."""

    def swing(frames: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        phase = 2 * np.pi * (VIBRATION_HZ * np.arange(len(frames)) / rate_hz + rng.random())
        return frames + np.float32(amount) * np.sin(phase).astype(np.float32)[:, None, None]

    return swing


def drift(amount: float, seconds: float) -> Change:
    """All taxels rise by so much of full scale in so many seconds."""

    def rise(frames: np.ndarray, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        return frames + (amount * np.arange(len(frames), dtype=np.float32) / (seconds * rate_hz))[:, None, None]

    return rise


def times(factor: float) -> Change:
    """All readings are multiplied."""
    return lambda frames, rate_hz, rng: frames * np.float32(factor)


CHANGES: dict[str, Change] = {
    "none": times(1.0),
    **{f"white noise, SD {100 * sd:g} % of full scale": of("noise", 100 * sd) for sd in (0.005, 0.01, 0.02)},
    **{f"vibration of {100 * a:g} %": vibration(a) for a in (0.005, 0.01, 0.02)},
    **{f"drift of {100 * a:g} % in {s:g} s": drift(a, s) for a, s in ((0.02, 3600), (0.02, 60), (0.1, 60))},
    **{f"gain {factor:g}": times(factor) for factor in (0.7, 1.4)},
    **{f"{percent:g} % of the taxels stuck": of("stuck_taxels", percent) for percent in (0.5, 2)},
    **{f"{percent:g} % of the taxels dead": of("dead_taxels", percent) for percent in (2, 10)},
    "a line dead": of("dead_lines", 1),
}


def changed(recordings: Recordings, name: str) -> Recordings:
    """Recordings after a fault; each has random numbers of its own."""
    corpus = recordings.corpus
    streams = []
    for i, stream in enumerate(corpus):
        shares = stream.astype(np.float32) / np.float32(corpus.full_scale)
        rng = seeded(f"{name} in recording {i} of {recordings.subjects[i]}")
        streams.append(as_readings(corpus, CHANGES[name](shares, corpus.rate_hz, rng)))
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": corpus.info}
    return replace(recordings, corpus=Corpus.from_captures(streams, corpus.captures, corpus.rate_hz, **fields))


def main(arguments: list[str]) -> pd.DataFrame:
    """Print and return a row for each detector and fault."""
    values = parse(arguments, {*KEYS, "detector", "false_alarms", "folds"})
    own = {
        key: value for key, value in values.items() if key.partition(".")[0] in ("detector", "false_alarms", "folds")
    }
    (cell,) = Continuous.ready(cells({k: v for k, v in values.items() if k not in own}))
    (plan,) = planned([cell], 1)
    corpus, rows = plan.corpus, []
    for part in detectors({k: v for k, v in own.items() if k.partition(".")[0] == "detector"}):
        for fold in plan.folds[: int(own.get("folds", len(plan.folds)))]:
            train, background = corpus[fold.train], usual(corpus)
            taught, test = (recordings_of(captures, background) for captures in (train, corpus[fold.test]))
            system = cell.estimator().fit(train, train.gestures)
            aim = float(own.get("false_alarms", 5))
            watcher, _ = part.make().learn(cell.estimator, system, train, taught, aim)
            hours = test.background_frames().sum() / test.corpus.rate_hz / 3600
            for name in CHANGES:
                reports = watcher.reports(changed(test, name).corpus)
                touches, reports = matched(test.events, reports, test.corpus.rate_hz, doubtful=test.doubtful)
                counts = touches[["found", "first_correct", "end_correct"]].sum().to_dict()
                alarms = int((reports["touch"] == FALSE_ALARM).sum())
                counts |= {"touches": len(touches), "alarms": alarms, "hours": hours}
                rows.append({"detector": part.typed(), "fault": name} | counts)
    sums = pd.DataFrame(rows).groupby(["detector", "fault"], sort=False).sum()
    shares = (100 * sums[["found", "first_correct", "end_correct"]].div(sums["touches"], axis=0)).round(1)
    table = shares.assign(alarms_per_hour=(sums["alarms"] / sums["hours"]).round(1)).reset_index()
    print(table.to_string(index=False))
    return table


if __name__ == "__main__":
    main(sys.argv[1:])
