"""Leave one capture out: as many folds as captures, each tested on one of them."""

import numpy as np
from sklearn.model_selection import LeaveOneOut

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.protocols.subjects import Folds


class LeaveOneCapture:
    """Train on all captures but one, so on others of the same subject; a fold for each capture takes long."""

    def label(self, corpus: Corpus) -> str:
        """Protocol label of every row of results."""
        return f"leave one capture out ({len(corpus)} captures), subjects mixed"

    def get_n_splits(self, X: Corpus, y: object = None, groups: object = None) -> int:
        """Number of captures."""
        return len(X)

    def split(self, X: Corpus, y: object = None, groups: object = None) -> Folds:
        """Yield (train, test) capture indices.

        Raises:
            InputError: a class has a single capture, which no fold could train on.
        """
        y = X.gestures if y is None else np.asarray(y)
        names, counts = np.unique(y.astype(str), return_counts=True)
        if counts.min() < 2:
            rare = names[counts.argmin()]
            raise InputError(
                f"protocol=leave_one_capture: gesture {rare} of {X.name} has 1 capture here; leave it out with "
                f'where="gesture != {rare!r}"'
            )
        yield from LeaveOneOut().split(np.zeros(len(y)))
