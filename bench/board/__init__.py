"""Frozen tasks, submissions, and marks of verified ones. Nothing here runs a fold."""
