"""Another skin: trained on one corpus, tested on another."""

from __future__ import annotations

import re
from itertools import chain

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.library import made_once, open_corpus
from bench.errors import InputError, nearest
from bench.ground.registry import parameters
from bench.ground.words import convert
from touchbench_people import skins
from touchbench_people.personal import WEIGHT, Folds, Pairs, Personal, with_shots
from touchbench_people.skins import OWN, SOURCE


class Transfer(Personal):
    """Train on all captures of another corpus, test on those of ``data=``, on the classes that both have.

    Both are brought to what both skins can give (`touchbench_people.skins`): shares of full scale, the lower of their
    rates and, each way, the fewer of their taxels. A finer one that is trained on would teach what the coarser cannot
    show, and the other way round. With ``shots`` or ``unlabelled`` each tested person calibrates, as in `Personal`.

    Args:
        source: name of the corpus that is trained on; ``synth`` may be followed by parameters, as in
            ``synth+rows=6+cols=6``.
        classes: names in ``data=`` of its classes where they differ, as in ``tap:pat+massage:rub``.
        shots: labelled captures of each class of the tested person.
        draws: calibrations that are drawn, each tested.
        unlabelled: half of the captures of the tested person, without labels, in place of shots.
        weight: number of times that a shot counts for a system that cannot adapt.
        seed: random seed of halves and draws.
    """

    def __init__(
        self,
        source: str = "",
        classes: str = "",
        shots: int = 0,
        draws: int = 5,
        unlabelled: bool = False,
        weight: int = WEIGHT,
        seed: int = 0,
    ) -> None:
        super().__init__(shots, draws, unlabelled, weight, seed)
        self.source = source
        self.classes = classes

    def joined(self, corpus: Corpus) -> Corpus:
        """The captures of ``data=``, and behind them those of the source, both as a skin that is as coarse as either.

        Raises:
            InputError: there is no such source, or too few classes are shared.
        """
        self.check()
        if corpus.target != "gesture":
            raise InputError(
                f"protocol=transfer tells gestures apart, not {corpus.target}; leave target= out"
            )
        if not self.source:
            raise InputError(
                "protocol=transfer needs protocol.source=, the corpus that is trained on; see bench data"
            )
        name, *pairs = re.split(r"\+(?=[a-z_]+=)", self.source)
        try:
            source = open_corpus(name, _generator(name, pairs))
        except InputError as e:
            raise InputError(f"protocol.source={self.source}: {e}") from e
        names = self._names()
        parts = [
            part
            for each in (corpus, source)
            for part in (each.digest, each.name, each.index.tolist())
        ]
        about = [*parts, sorted(names.items())]
        return made_once(".transfer", about, lambda: skins.joined(corpus, source, names), skins)

    def _names(self) -> dict[str, str]:
        pairs = [pair.partition(":") for pair in self.classes.split("+") if pair]
        for old, _, new in pairs:
            if not old or not new:
                raise InputError(
                    f"protocol.classes={self.classes}: give pairs such as tap:pat, joined by +"
                )
        if len({old for old, _, _ in pairs}) < len(pairs):
            raise InputError(
                f"protocol.classes={self.classes}: a class is named twice; name it once"
            )
        return {old: new for old, _, new in pairs}

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        target = corpus.captures["skin"].to_numpy() == OWN
        personal = super().label(corpus[target]).removeprefix("personal, ").rpartition(" (")[0]
        calibration = f", {personal}" if self.shots or self.unlabelled else ""
        people = [f"{len(set(corpus.subjects[part]))} subjects" for part in (~target, target)]
        count = len(set(corpus.gestures))
        return f"transfer from {self.source} ({people[0]}), {count} shared classes{calibration} ({people[1]})"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield one (train, test, pairs): the source, all of ``data=``, and pairs of each draw and tested subject."""
        skin = X.captures["skin"].to_numpy()
        yield np.flatnonzero(skin == SOURCE), np.flatnonzero(skin == OWN), self._pairs(X, y)

    def _pairs(self, X: Corpus, y: object) -> Pairs:
        """Calibration captures of a subject, and captures tested after them: draw by draw, subject by subject."""
        target = np.flatnonzero(X.captures["skin"].to_numpy() == OWN)
        people = list(self.calibrations(X[target], None if y is None else np.asarray(y)[target]))
        draws = chain.from_iterable(chain.from_iterable(draw) for draw in zip(*people, strict=True))
        return with_shots([(target[shots], target[tested]) for shots, tested in draws])


def _generator(name: str, pairs: list[str]) -> dict[str, object]:
    """Parameters of the generated corpus from ``rows=6`` and the like; an imported one has none.

    Raises:
        InputError: a parameter that is not there, or no value of one.
    """
    from bench.corpora.synth import generate

    if name != "synth":
        if pairs:
            raise InputError(f"only synth has parameters, not {name}")
        return {}
    defaults = parameters(generate)
    values = dict(defaults)
    for pair in pairs:
        key, _, text = pair.partition("=")
        if key not in defaults:
            raise InputError(f"synth has no parameter {key!r}; {nearest(key, defaults)}")
        values[key] = convert(key, text, defaults[key])
    return values
