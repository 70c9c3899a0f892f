"""The split of the 2015 challenge, or the nearest thing that a corpus allows."""

import numpy as np

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.protocols.subjects import Folds, sort_naturally


class Challenge:
    """Train on the subjects that the corpus declares as training, test on the others (Jung et al. 2015).

    A corpus declares a split with a column ``split`` that holds ``train``, ``test`` or nothing. HAART carries it; for
    CoST the importer recovers it from frame counts. Where it is not declared, subjects are drawn at random, and the
    label says so: CoST's gentle and normal captures with 21 / 10 subjects, any other corpus with 2/3 - 1/3 of them.

    Args:
        repeats: number of random splits without a declared one.
        seed: random seed of the draws.
    """

    def __init__(self, repeats: int = 5, seed: int = 0) -> None:
        self.repeats = repeats
        self.seed = seed

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        if self.official_split(corpus):
            split = corpus.captures["split"]
            return f"challenge split, declared ({(split == 'train').sum()} / {(split == 'test').sum()} captures)"
        train = _count_training_subjects(corpus)
        rest = len(set(corpus.subjects)) - train
        return f"{self.repeats} random subject splits {train} / {rest}, seed {self.seed}, not the official split"

    def official_split(self, corpus: Corpus) -> bool:
        """True if the corpus declares the split of the challenge."""
        return "split" in corpus.captures and bool(
            corpus.captures["split"].isin(["train", "test"]).any()
        )

    def get_n_splits(self, X: Corpus, y: object = None, groups: object = None) -> int:
        """1 where the corpus declares its split, else the number of repeats."""
        return 1 if self.official_split(X) else self.repeats

    def split(self, X: Corpus, y: object = None, groups: np.ndarray | None = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: the declared split has an empty side or a subject on both, or there is only one subject.
        """
        groups = np.asarray(X.subjects if groups is None else groups)
        if self.official_split(X):
            split = X.captures["split"].to_numpy(dtype=object)
            train, test = np.flatnonzero(split == "train"), np.flatnonzero(split == "test")
            if not len(train) or not len(test):
                raise InputError(
                    f"protocol=challenge: {len(train)} training and {len(test)} test captures are left"
                )
            if both := set(groups[train]) & set(groups[test]):
                raise InputError(
                    f"protocol=challenge: subject {min(both)} of {X.name} is in both parts of its column split; mend it"
                )
            yield train, test
            return
        subjects = sort_naturally(groups)
        if len(subjects) < 2 or self.repeats < 1:
            raise InputError(
                f"protocol=challenge needs two subjects and one repeat, here are {len(subjects)} and {self.repeats}"
            )
        usable = _is_in_challenge(X)
        for repeat in range(self.repeats):
            order = np.random.default_rng([self.seed, repeat]).permutation(len(subjects))
            train = np.isin(groups, [subjects[i] for i in order[: _count_training_subjects(X)]])
            yield np.flatnonzero(train & usable), np.flatnonzero(~train & usable)


def _is_cost(corpus: Corpus) -> bool:
    return corpus.info.get("format") == "cost"


def _is_in_challenge(corpus: Corpus) -> np.ndarray:
    """The challenge used CoST's gentle and normal captures only; bool [captures]."""
    if _is_cost(corpus):
        return corpus.captures["variant"].isin(["gentle", "normal"]).to_numpy()
    return np.ones(len(corpus), dtype=bool)


def _count_training_subjects(corpus: Corpus) -> int:
    subjects = len(set(corpus.subjects))
    if _is_cost(corpus) and subjects == 31:
        return 21
    return min(max(round(subjects * 2 / 3), 1), subjects - 1)
