"""What bringing captures to another skin loses: a corpus is sent through each step and back.

Accuracy of `lda` on `touch` (z), leaving each subject out, of the captures as they are, and of what is left of them.

    python benchmarks/bench_transfer.py haart 30 6x6
"""

import sys

import numpy as np

from bench.corpora.corpus import Corpus
from bench.corpora.library import open_corpus
from bench.corpora.skins import brought
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.protocols.subjects import LOSO


def there_and_back(corpus: Corpus, rate_hz: float, grid: tuple[int, int], full_scale: float) -> Corpus:
    """A corpus in memory, after another skin has seen it."""
    there = like(corpus, brought(corpus, rate_hz, grid, full_scale), rate_hz, full_scale)
    return like(
        corpus, brought(there, corpus.rate_hz, corpus.grid, corpus.full_scale), corpus.rate_hz, corpus.full_scale
    )


def like(corpus: Corpus, arrays: list[np.ndarray], rate_hz: float, full_scale: float) -> Corpus:
    """The same captures with other frames."""
    return Corpus.from_captures(arrays, corpus.captures, rate_hz, full_scale=full_scale)


def accuracy(corpus: Corpus) -> float:
    """Mean over subjects, in percent."""
    table = TouchFeatures().fit_transform(corpus)
    found = []
    for train, test in LOSO().split(corpus):
        machine = lda(TouchFeatures()).named_steps["classifier"].fit(table.iloc[train], corpus.gestures[train])
        found.append(100 * (machine.predict(table.iloc[test]) == corpus.gestures[test]).mean())
    return float(np.mean(found))


def main(name: str, rate_hz: str, grid: str) -> None:
    """Print the accuracy after each step alone and after all."""
    corpus = open_corpus(name, {})
    rows, cols = map(int, grid.split("x"))
    own = corpus.rate_hz, corpus.grid, corpus.full_scale
    steps = {
        "as it is": own,
        "full scale 1 and back": (corpus.rate_hz, corpus.grid, 1.0),
        f"{rate_hz} Hz and back": (float(rate_hz), corpus.grid, corpus.full_scale),
        f"{grid} taxels and back": (corpus.rate_hz, (rows, cols), corpus.full_scale),
        "all of it and back": (float(rate_hz), (rows, cols), 1.0),
    }
    for said, skin in steps.items():
        back = corpus if skin == own else there_and_back(corpus, *skin)
        said += f": {accuracy(back):.1f} %"
        if len(back.frames) == len(corpus.frames):
            apart = np.sqrt(np.mean((back.frames - corpus.frames.astype(float)) ** 2)) / corpus.full_scale
            said += f", {100 * apart:.2f} % of full scale apart (RMS)"
        print(said, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
