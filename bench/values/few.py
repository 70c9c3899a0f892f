"""How few people are too few for a number, and the sentence that takes its place."""

from __future__ import annotations

FEWEST_FOR_INTERVAL = 5  # fewest people for an interval over people and a forecast for new people
FEWEST_FOR_TEST = 6  # fewest people for a p value: with five, no two-sided sign or Wilcoxon test can reach p < 0.05


def too_few_sentence(people: int) -> str:
    """The sentence for a number of people, such as "3 subjects: too few for an interval"; empty if they are enough."""
    if people >= FEWEST_FOR_TEST:
        return ""
    lacks = "an interval" if people < FEWEST_FOR_INTERVAL else "a p value"
    return f"{people} subject{'s' * (people != 1)}: too few for {lacks}"
