"""Detectors of touch in a stream, a file each."""

PARTS = {
    "frames": "touchbench_streams.detectors.frames:Frames",
    "threshold": "touchbench_streams.detectors.threshold:Threshold",
}
