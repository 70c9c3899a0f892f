"""touchbench: recognisers of social touch on the same captures under the same protocol.

    import bench

    corpus = bench.corpus("synth", subjects=6)
    table = bench.run(data="synth", protocol="loso", model=["svm", "bayes"], data__subjects=6)
    bench.choose(data="synth", protocol="loso", max_flash="256kB")

The functions take the names of the command line (see ``bench run --help``): lists instead of commas, ``model__C=8`` for
``model.C=8``, and scikit-learn estimators, feature sets and splitters besides names. Nothing heavy is loaded before
one of them is asked for.
"""

from __future__ import annotations

import importlib

API = ("audit", "choose", "corpus", "extract", "fit", "groups", "look", "plans", "run", "tune")
VALUES = {"Corpus": "bench.corpora.corpus", "InputError": "bench.errors", "fault": "bench.corpora.faults"}
VALUES |= {"compare": "bench.stored", "latex": "bench.reports.latex", "results": "bench.stored"}
__all__ = [*API, *VALUES]


def __getattr__(name: str) -> object:
    if name.startswith("_") or (name not in __all__ and name not in _makers()):
        raise AttributeError(f"module 'bench' has no attribute {name!r}")
    return getattr(importlib.import_module(VALUES.get(name, "bench.api")), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *_makers()})


def _makers() -> list[str]:
    """Commands that make runs, each also a function."""
    from bench.options import makers

    return [*makers()]
