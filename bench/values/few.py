"""The fewest people for an interval and for a test, and the sentence for fewer."""

from __future__ import annotations

FEWEST_FOR_INTERVAL = 5  # also for a forecast for new people
FEWEST_FOR_TEST = 6  # with five, no two-sided sign or Wilcoxon test can reach p < 0.05


def too_few_sentence(people: int) -> str:
    """Say "3 subjects: too few for an interval"; empty for enough people."""
    if people >= FEWEST_FOR_TEST:
        return ""
    lacks = "an interval" if people < FEWEST_FOR_INTERVAL else "a p value"
    return f"{people} subject{'s' * (people != 1)}: too few for {lacks}"
