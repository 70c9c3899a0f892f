"""Kinds of run, a file each: what is done in a fold, and how its result is shown and chosen by."""

PARTS = {  # by the command that makes them
    "run": "bench.kinds.captures:Captures",
}
