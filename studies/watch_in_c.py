"""Whether exported C reports the same touches as Python, at the same frames and with the same labels.

    python studies/watch_in_c.py data=haart model=lda features=touch model.window=0.75 model.repair=stuck+dead

trains a system and its watcher on all captures, exports both with ``bits=32,8`` and compiles the C for this machine.
``detector=`` and ``false_alarms=`` are those of `bench fit`. C and Python then watch the recordings of all subjects,
or those that `bench watch` composes of them. It prints a row for each number of bits. In 8 bits, Python has the same
rounded weights (``model.bits=8``). The subjects are training subjects, so the numbers compare two programs and are no
accuracy. Of a touch that lasts at the end of a recording, the report and the first label are compared.
"""

import ctypes
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

import bench
from bench.arguments import KEYS, parse
from bench.corpora.corpus import Corpus
from bench.corpora.library import holds_recordings
from bench.corpora.recordings import certain
from bench.endless.teaching import Watching
from bench.endless.watch import recordings_of, usual
from bench.endless.watcher import UNKNOWN, Watcher
from bench.in_c.measure import FLAGS
from bench.in_c.tables import check
from bench.in_c.write import files_of
from bench.models.quantised import in_bits
from bench.outcomes.events import REPORT, report_table
from bench.plan.cells import cells
from bench.plan.plan import corpus_of, usable_cores
from bench.words import items
from bench.work.fold import computing
from bench.work.saved import Recogniser

NONE = -2  # no event; TOUCH_UNKNOWN is -1
LIBRARY = f"""#include "touch.c"
static touch_watch_t w;
int events(const float *frames, int n, float *rows) /* reported, end, first and last label, confidence; below 2^24 */
{{
    touch_event_t e;
    int count = 0, first = {NONE};
    touch_watch_init(&w);
    for (int i = 0; i <= n; i++) {{ /* at n: a touch that goes on as the recording ends, which has no end */
        int news = i < n ? touch_watch(&w, frames + (long)i * TAXELS, &e) : 0;
        if (news < 0)
            return news;
        if (news && first == {NONE})
            first = e.label;
        if (news == TOUCH_ENDED || (i == n && first != {NONE})) {{
            float row[] = {{(float)e.reported, i < n ? (float)e.end : 0, (float)first, (float)e.label, e.confidence}};
            memcpy(rows + 5 * count++, row, sizeof row);
            first = {NONE};
        }}
    }}
    return count;
}}
"""


def in_c(recogniser: Recogniser, bits: int, recordings: Corpus) -> pd.DataFrame:
    """Events of recordings by the exported C, as of `bench.endless.watcher.Watcher.reports`."""
    names, parts = [*recogniser.classes, UNKNOWN], []
    with tempfile.TemporaryDirectory() as folder:
        for file, text in (files_of(recogniser, bits, "a study") | {"library.c": LIBRARY}).items():
            Path(folder, file).write_text(text, encoding="utf-8")
        subprocess.run(["cc", *FLAGS, "library.c", "-lm", "-o", "library.so"], cwd=folder, check=True)
        events = ctypes.CDLL(str(Path(folder, "library.so"))).events
        for i, frames in enumerate(recordings):
            values = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
            rows = np.zeros((len(values), 5), np.float32)
            count = events(ctypes.c_void_p(values.ctypes.data), len(values), ctypes.c_void_p(rows.ctypes.data))
            if count < 0:
                raise ValueError(f"the C refuses a frame of recording {i}")
            for reported, end, first, last, confidence in rows[:count].tolist():
                parts.append((i, int(reported), int(end), names[int(first)], names[int(last)], confidence))
    return report_table(parts)


def compared(values: dict[str, str], bits: int) -> dict[str, object]:
    """Counts of events of C and Python on the recordings of all subjects: those that are equal, and the others.

    Raises:
        InputError: something in the values cannot be used, or the system's C cannot watch.
    """
    of_watcher = {key: values[key] for key in values if key.partition(".")[0] in ("detector", "false_alarms")}
    of_cell = {key: value for key, value in values.items() if key not in of_watcher}
    cell, *more = cells(of_cell | ({"model.bits": "8"} if bits == 8 else {}))
    if more or not check(cell.untrained):
        raise bench.InputError("give one system whose C can watch a stream: reflex, or a classifier on touch")
    if holds_recordings(cell.data):
        cell = cell.of_recordings()
    corpus = certain(corpus_of(cell))
    recordings = recordings_of(corpus, usual(corpus))
    with computing(usable_cores()):
        estimator = cell.estimator().fit(corpus, corpus.gestures)
        watcher = Watching(of_watcher).learned(cell.estimator, estimator, corpus)
        if bits == 8 and isinstance(watcher, Watcher):
            detector = Pipeline([("classifier", watcher.detector.classifier_)])
            watcher.detector.classifier_ = in_bits(detector, bits).steps[-1][1]
        python = watcher.reports(recordings.corpus)
    c = in_c(Recogniser(estimator, corpus, None, watcher), bits, recordings.corpus)
    return {"bits": bits, "touches": len(recordings.events)} | counted(c, python)


def counted(c: pd.DataFrame, python: pd.DataFrame) -> dict[str, object]:
    """How many events are equal; those with the same frame of the report are compared."""
    both = c.merge(python, on=["recording", "reported"], suffixes=("", "_python"))
    same = {name: both[name] == both[f"{name}_python"] for name in REPORT if f"{name}_python" in both}
    same |= {name: same[name] | (both["end"] == 0) for name in ("end", "label")}
    apart = (both["confidence"] - both["confidence_python"]).abs()[both["end"] > 0]
    return {
        "events in C": len(c),
        "in Python": len(python),
        "reported at the same frame": len(both),
        "same end": int(same["end"].sum()),
        "same first label": int(same["first"].sum()),
        "same last label": int(same["label"].sum()),
        "confidence apart, median": f"{apart.median():.1g}",
        "99 %": f"{apart.quantile(0.99):.1g}",
    }


def main(words: list[str]) -> pd.DataFrame:
    """Compare with each number of bits, return the table."""
    values = parse(words, {*KEYS, "bits", "detector", "false_alarms"})
    bits = [int(str(each)) for each in items("bits", values.pop("bits", "32,8"))]
    return pd.DataFrame([compared(values, each) for each in bits])


if __name__ == "__main__":
    try:
        print(main(sys.argv[1:]).T.to_string(header=False))
    except bench.InputError as error:
        sys.exit(str(error))
