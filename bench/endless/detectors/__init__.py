"""Detectors of touch in a stream, a file each."""

PARTS = {
    "frames": "bench.endless.detectors.frames:Frames",
    "threshold": "bench.endless.detectors.threshold:Threshold",
}
