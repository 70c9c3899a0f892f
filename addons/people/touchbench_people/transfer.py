"""Another skin: train on one corpus, test on another."""

from __future__ import annotations

import re
from itertools import chain

import numpy as np

from bench.corpora import spellings
from bench.corpora.corpus import Corpus
from bench.corpora.library import make_once, open_corpus
from bench.errors import InputError
from bench.plan.grid import expand_corpus_parameters
from touchbench_people import skins
from touchbench_people.personal import SHOT_WEIGHT, Folds, Personal, pairs_with_shots
from touchbench_people.skins import SOURCE_SKIN, TARGET_SKIN


class Transfer(Personal):
    """Train on all captures of another corpus, and test on those of ``data=``; shared classes only.

    Both are converted to what both skins can measure (`touchbench_people.skins`): shares of full
    scale, the lower rate and, for rows and columns, the fewer taxels. With ``shots`` or
    ``unlabelled`` each tested person calibrates, as in `Personal`.

    Args:
        source: name of the training corpus; ``synth`` may have parameters, as in
            ``synth+rows=6+cols=6``.
        classes: names in ``data=`` of its classes, if they differ, as in ``tap:pat+massage:rub``.
        shots: labelled captures of each class of the tested person.
        draws: number of calibrations to draw and test.
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
        weight: int = SHOT_WEIGHT,
        seed: int = 0,
    ) -> None:
        super().__init__(shots, draws, unlabelled, weight, seed)
        self.source = source
        self.classes = classes

    def joined(self, corpus: Corpus) -> Corpus:
        """Join the captures of ``data=`` and of the source, as one skin.

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
                "protocol=transfer needs protocol.source=, the corpus that is trained on; see "
                "bench data"
            )
        name, *pairs = re.split(r"\+(?=[a-z_]+=)", self.source)
        values = {f"data.{key}": value for key, _, value in (pair.partition("=") for pair in pairs)}
        try:
            source = open_corpus(name, expand_corpus_parameters(values, name, [name])[0])
        except InputError as e:
            raise InputError(f"protocol.source={self.source}: {e}") from e
        names = self._class_names()
        key: list[object] = []
        for each in (corpus, source):
            key += [each.digest, each.name, each.index.tolist()]
        key.append(sorted(names.items()))
        code = (skins, spellings)
        return make_once(".transfer", key, lambda: skins.join_skins(corpus, source, names), *code)

    def _class_names(self) -> dict[str, str]:
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
        """Protocol label of results."""
        target = corpus.captures["skin"].to_numpy() == TARGET_SKIN
        personal = super().label(corpus[target]).removeprefix("personal, ").rpartition(" (")[0]
        calibration = f", {personal}" if self.shots or self.unlabelled else ""
        trained, tested = (len(set(corpus.subjects[part])) for part in (~target, target))
        classes = f"{len(set(corpus.gestures))} shared classes"
        source = f"{self.source} ({trained} subjects)"
        return f"transfer from {source}, {classes}{calibration} ({tested} subjects)"

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield one (train, test, pairs): the source, all of ``data=``, and pairs of all draws.

        Pairs are ordered by draw, then by subject.
        """
        skin = X.captures["skin"].to_numpy()
        source, target = np.flatnonzero(skin == SOURCE_SKIN), np.flatnonzero(skin == TARGET_SKIN)
        labels = None if y is None else np.asarray(y)[target]
        pairs = []
        for draw in zip(*self.calibrations(X[target], labels), strict=True):
            pairs += [(target[shots], target[tested]) for shots, tested in chain(*draw)]
        yield source, target, pairs_with_shots(pairs)
