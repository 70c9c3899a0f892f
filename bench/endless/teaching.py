"""How a system learns to watch, for those who save it or write it as C (entry points ``touchbench.watchers``)."""

from __future__ import annotations

from bench import contract
from bench.corpora.corpus import Corpus
from bench.endless.composer import check_background, pieces
from bench.endless.watch import recordings_of, usual
from bench.endless.watcher import Watcher
from bench.endless.watcher_training import learned
from bench.usual import FALSE_ALARMS


class Watching:
    """The post-processing for endless streams, learned from captures with the usual background."""

    @staticmethod
    def check(captures: Corpus) -> None:
        """Refuse captures that cannot teach it.

        Raises:
            InputError: there is no background to compose recordings with.
        """
        check_background(*pieces(captures, usual(captures)))

    @staticmethod
    def learned(system: contract.System, captures: Corpus, whole: Corpus) -> Watcher:
        """A fitted system that watches.

        Args:
            system: the system.
            captures: captures that teach, of two subjects at least.
            whole: the captures that tell which background is the usual one.

        Raises:
            InputError: they cannot teach it.
        """
        return learned(system, recordings_of(captures, usual(whole)), FALSE_ALARMS)[0]
