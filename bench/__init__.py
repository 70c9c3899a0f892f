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

_PLACES = {
    "audit": "bench.commands.audit",
    "choose": "bench.commands.choose",
    "compare": "bench.stored",
    "corpus": "bench.commands.data",
    "extract": "bench.commands.data",
    "fault": "bench.corpora.faults",
    "fit": "bench.commands.fit",
    "groups": "bench.commands.groups",
    "latex": "bench.stored",
    "look": "bench.commands.data",
    "plans": "bench.commands.run",
    "predictions": "bench.stored",
    "run": "bench.commands.run",
    "runs": "bench.stored",
    "stress": "bench.commands.run",
    "tune": "bench.commands.tune",
    "Corpus": "bench.corpora.corpus",
    "InputError": "bench.errors",
}
__all__ = [*_PLACES]


def __getattr__(name: str) -> object:
    if name in _PLACES:
        return getattr(importlib.import_module(_PLACES[name]), name)
    if not name.startswith("_") and name in _makers():  # a package's command that makes runs
        from bench.commands.run import maker

        return maker(name)
    raise AttributeError(f"module 'bench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*__all__, *_makers()})


def _makers() -> list[str]:
    from bench.options import makers

    return [*makers()]
