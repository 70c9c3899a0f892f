"""The split of the 2015 challenge, or the most similar one that a corpus allows."""

from dataclasses import dataclass

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.protocols.subjects import CaptureSplitter, Folds, sort_naturally


@dataclass(eq=False, repr=False)
class Challenge(CaptureSplitter):
    """Train on the declared training subjects, test on the others (Jung et al. 2015).

    A corpus declares a split by a column ``split`` with ``train``, ``test`` or nothing. HAART has
    it; for CoST the importer recovers it from frame counts. Without it, subjects are drawn at
    random, and the label says so: CoST's gentle and normal captures with 21 / 10 subjects, any
    other corpus with 2/3 / 1/3 of them.

    Args:
        repeats: number of random splits without a declared one.
        seed: random seed of the draws.
    """

    repeats: int = 5
    seed: int = 0

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        if self.official_split(corpus):
            counts = corpus.captures["split"].value_counts()
            train, test = counts.get("train", 0), counts.get("test", 0)
            return f"challenge split, declared ({train} / {test} captures)"
        train = _count_training_subjects(corpus)
        split = f"{train} / {len(set(corpus.subjects)) - train}"
        seed = f"seed {self.seed}, not the official split"
        return f"{self.repeats} random subject splits {split}, {seed}"

    def official_split(self, corpus: Corpus) -> bool:
        """True if the corpus declares the split of the challenge."""
        if "split" not in corpus.captures:
            return False
        return bool(corpus.captures["split"].isin(["train", "test"]).any())

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: the declared split has an empty side or a subject on both, or there is only
                one subject.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        if self.official_split(X):
            split = X.captures["split"].to_numpy(dtype=object)
            train, test = np.flatnonzero(split == "train"), np.flatnonzero(split == "test")
            if not len(train) or not len(test):
                counts = f"{len(train)} training and {len(test)} test captures"
                raise InputError(f"protocol=challenge: {counts} are left")
            if both := set(groups[train]) & set(groups[test]):
                fact = f"subject {min(both)} of {X.name} is in both parts of its column split"
                raise InputError(f"protocol=challenge: {fact}; mend it")
            yield train, test
            return
        subjects = sort_naturally(groups)
        if len(subjects) < 2 or self.repeats < 1:
            counts = f"{len(subjects)} and {self.repeats}"
            needs = "protocol=challenge needs two subjects and one repeat"
            raise InputError(f"{needs}, here are {counts}")
        is_used, training = _is_in_challenge(X), _count_training_subjects(X)
        for repeat in range(self.repeats):
            order = np.random.default_rng([self.seed, repeat]).permutation(len(subjects))
            is_training = np.isin(groups, [subjects[i] for i in order[:training]])
            yield np.flatnonzero(is_training & is_used), np.flatnonzero(~is_training & is_used)


def _is_cost(corpus: Corpus) -> bool:
    return corpus.info.get("format") == "cost"


def _is_in_challenge(corpus: Corpus) -> np.ndarray:
    """True for captures that the challenge used, gentle and normal ones of CoST."""
    if _is_cost(corpus):
        return corpus.captures["variant"].isin(["gentle", "normal"]).to_numpy()
    return np.ones(len(corpus), dtype=bool)


def _count_training_subjects(corpus: Corpus) -> int:
    subjects = len(set(corpus.subjects))
    if _is_cost(corpus) and subjects == 31:
        return 21
    return min(max(round(subjects * 2 / 3), 1), subjects - 1)
