"""Detectors of touch in a stream, a file each."""
