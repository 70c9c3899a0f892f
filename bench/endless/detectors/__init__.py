"""Detectors of touch in a stream, a file each."""

PARTS = {
    "best": "bench.endless.detectors.best:Best",
    "filter": "bench.endless.detectors.filter:Filter",
    "frames": "bench.endless.detectors.frames:Frames",
    "threshold": "bench.endless.detectors.threshold:Threshold",
}
