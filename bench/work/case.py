"""What a circumstance changes, once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bench import contract
    from bench.corpora.corpus import Corpus


@dataclass(frozen=True)
class Case:
    """What a circumstance changes, once.

    Attributes:
        case: its name, such as that of a fault; empty for the key of the circumstance.
        level: size of the change, to sort and draw by.
        amount: size of the change, in words.
        corpus: the captures as they are changed; None for the captures as they are.
        system: a system that labels in place of the fitted one.
        train_subjects: number of subjects that it was fitted on, where it is another one.
    """

    case: str = ""
    level: float = 0
    amount: str = ""
    corpus: Corpus | None = None
    system: contract.System | None = None
    train_subjects: int | None = None
