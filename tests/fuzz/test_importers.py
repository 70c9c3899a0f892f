"""A bounded run of the importers' fuzzer; the long one is by hand: python tests/fuzz/importers.py --examples 5000"""

from tests.fuzz.importers import BAD, outcomes
from tests.fuzz.inputs import KINDS


def test_every_file_is_imported_right_or_refused_in_a_line(tmp_path):
    found = list(outcomes(range(150), seed=0, keep=tmp_path / "bad"))
    bad = [
        f"{outcome.kind}: {given.kind}, {given.damage}: {outcome.message}"
        for given, outcome in found
        if outcome.kind in BAD
    ]
    assert not bad, "\n".join(bad)
    for kind in KINDS:  # the run looks at both sides
        assert {outcome.kind for given, outcome in found if given.kind == kind} == {"refused", "right"}
