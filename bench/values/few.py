"""How few people are too few for a number, and the sentence that takes its place."""

from __future__ import annotations

INTERVAL = 5  # fewest people for an interval over people and a forecast for new people
TEST = 6  # fewest people for a p value: with five, no two-sided sign or Wilcoxon test can reach p < 0.05


def too_few(people: int) -> str:
    """The sentence for a number of people, such as "3 subjects: too few for an interval"; empty if they are enough."""
    if people >= TEST:
        return ""
    lacks = "an interval" if people < INTERVAL else "a p value"
    return f"{people} subject{'s' * (people != 1)}: too few for {lacks}"
