"""What ``bench build`` refuses, as golden files (``--golden`` writes them)."""

import json
import re
from pathlib import Path

from bench.corpora.read.table import write_table
from bench.ground.digests import json_with_digest
from tests.conftest import random_corpus
from tests.net.build import step

SENSOR = ["grid=4x4", "rate_hz=100", "full_scale=1023"]
WRONG = [
    ["build", "data=synth"],
    ["build", "data=synth", "board=nano34ble", "out=robot"],
    ["build", "a.csv", "b.csv", "out=robot"],
    ["build", "a.csv", "data=synth", "out=robot"],
    ["build", "nowhere.csv", *SENSOR, "out=robot"],
    ["build", "data=synth", "out=."],
    *(
        ["build", f"{name}.csv", *SENSOR, "out=robot"]
        for name in ("alone", "pat", "case", "saturated")
    ),
    ["build", "check", "nowhere", "data=synth"],
    ["build", "check", "four", "data=synth"],
    ["build", "check", "five", "data=synth", "board=uno-r3"],
]


def test_recordings_that_cannot_teach_and_wrong_words_are_refused(golden):
    corpus = random_corpus(2, 1, grid=(4, 4))
    subject, gesture = corpus.captures["subject"], corpus.captures["gesture"]
    captures = {
        "alone": corpus.captures.assign(subject="1"),
        "pat": corpus.captures.assign(gesture="pat"),
        "case": corpus.captures.assign(
            gesture=gesture.where(subject != "1", gesture.str.capitalize())
        ),
    }
    for name, table in captures.items():
        write_table(corpus.with_fields(captures=table), Path(f"{name}.csv"))
    write_table(corpus.with_fields(frames=0 * corpus.frames + 1023), Path("saturated.csv"))
    for name, people in {"four": 4, "five": 5}.items():
        Path(name).mkdir()
        facts = {
            "certificate": 2,
            "data": {"people": people},
        }
        Path(name, "certificate.json").write_text(json_with_digest(json.dumps(facts)))
    text = "".join(map(step, WRONG))
    golden("refusals.txt", re.sub(r"! step \d of .*\n", "", text))  # with the seconds that passed
    assert not Path("robot").exists()
