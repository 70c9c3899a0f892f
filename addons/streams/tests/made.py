"""Results of ``bench watch`` as if it had made them."""

import numpy as np
import pandas as pd

from tests.reports.store import keep
from tests.results import HAART, result

TINY = "data=synth data.subjects=3 data.variants=normal data.rate_hz=20 data.rows=3 data.cols=3 jobs=1".split()
WATCHED = pd.DataFrame(  # 100 s at 50 Hz, 10 s of it touched; one touch is found, one missed, one false alarm raised
    [("recording", np.nan, 5000, None, np.nan, None, None, np.nan)]
    + [("touch", 500, 750, "pat", np.nan, None, None, np.nan), ("touch", 1000, 1250, "rub", np.nan, None, None, np.nan)]
    + [("report", np.nan, 755, None, 550, "tap", "pat", 0.8), ("report", np.nan, 2000, None, 1900, "rub", "rub", 0.6)]
    + [("probability", np.nan, np.nan, None, seen, None, None, 0.1) for seen in range(20, 5000, 100)],
    columns=["kind", "start", "end", "gesture", "reported", "first", "label", "confidence"],
).assign(recording=0, subject="1", fold="1")


def watched(system, end_correct, alarms, latency, flash=4000.0, tables=None, **about):
    """A result of ``bench watch`` with the shares of touches of each subject that end with the correct label."""
    metrics = {"end_correct": sum(end_correct) / len(end_correct), "touches_found": 0.9, "first_correct": 0.5}
    metrics |= {"false_alarms_per_hour": alarms, "latency_s_p50": latency, "flash_bytes": flash, "ram_bytes": 900.0}
    metrics |= {"touches": 2.0, "background_minutes": 1.5, "quiet_ms": 2.0}
    hours = {"false_alarms_per_hour": alarms, "background_s": 90.0 / len(end_correct)}
    names = map(str, range(1, len(end_correct) + 1))
    usual = {
        "predictions": WATCHED,
        "per_subject": pd.DataFrame({"subject": names, "end_correct": end_correct, **hours}),
        "curve": pd.DataFrame({"offset": [-1, 0], "missed": [0.5, 0.0], "false_alarms_per_hour": [0.0, 40]}),
    }
    options = {"watch.detector": "frames", "watch.false_alarms": "5.0", "watch.background": "", "watch.unknown": ""}
    return result(system, "watch", metrics, usual | (tables or {}), **HAART | options | about)


def stored(store, system, end_correct, alarms, latency, flash=4000.0, **about):
    """Store such a run."""
    return keep(store, watched(system, end_correct, alarms, latency, flash, **about))
