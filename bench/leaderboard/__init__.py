"""Frozen tasks, submissions of anybody, and which of them were verified. Nothing here runs a fold."""
