"""Detectors of touch in a stream: names and where they are made (nothing is imported before it is used)."""

PARTS = {
    "filter": "bench.work.filter:Filter",
    "frames": "bench.detectors.frames:Frames",
    "threshold": "bench.detectors.threshold:Threshold",
}
