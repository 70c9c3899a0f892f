"""``bench adapt`` of a build writes C of the adapted model."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from bench.cli import main
from bench.corpora.read.table import write_table
from bench.ground.digests import json_with_digest
from bench.running.saved import load_recogniser
from tests.conftest import random_corpus
from touchbench_builder.folder import label_with_c
from touchbench_people.adaptation import adapt_system

TOOLS = [name for name in ("cc", "make") if shutil.which(name) is None]

pytestmark = pytest.mark.skipif(bool(TOOLS), reason=f"{', '.join(TOOLS)} not installed")


def test_a_build_with_weights_in_few_bits_is_adapted_and_passes_its_test(capsys, monkeypatch):
    corpus = random_corpus(subjects=3, per_class=4, grid=(4, 4), longest=90)
    write_table(corpus, Path("skin.csv"))
    own = corpus[np.flatnonzero(corpus.subjects == "3")].detach()
    write_table(own, Path("anna.csv"))
    sensor = ["grid=4x4", f"rate_hz={corpus.rate_hz:g}", f"full_scale={corpus.full_scale:g}"]
    assert main(["data", "import", "table", "skin.csv", "name=skin", *sensor]) == 0
    system = ["model=lda", "features=touch", "model.window=0.4", "model.bits=8", "watch=no"]
    assert main(["fit", "data=skin", *system, "stopping=no"]) == 0
    address = capsys.readouterr().out.split("run ")[-1].split()[0]
    data = {"gestures": sorted({*corpus.gestures}), "synthetic": False, "grid": [4, 4], "people": 3}
    data |= {"corpus": "skin", "captures": len(corpus), "rate_hz": corpus.rate_hz, "digest": "0"}
    names = {"name": "lda", "model": address, "bits": 8, "code": "0", "prefix": "skin"}
    facts = {"certificate": 2, "touchbench": "1", "command": "bench build", "data": data}
    facts |= {"chip": None, "board": None}
    Path("robot").mkdir()
    text = json_with_digest(json.dumps(facts | {"system": names}) + "\n")
    Path("robot/certificate.json").write_text(text)

    assert main(["adapt", "robot", "anna.csv", "out=robot_anna", "anyway=yes"]) == 0
    assert "next: make -C robot_anna test" in capsys.readouterr().out
    assert not Path("robot_anna/certificate.json").exists()
    assert "for one person" in Path("robot_anna/README.md").read_text()
    assert "Adapted to 12 captures" in Path("robot_anna/touch.h").read_text()
    subprocess.run(["make", "-s", "-C", "robot_anna", "test"], check=True)
    general = load_recogniser(address)
    general.estimator = adapt_system(general.estimator, own, own.gestures)
    labels, _ = label_with_c(Path("robot_anna"), general.classes, own, "skin")
    assert labels.tolist() == general.label(own)["label"].tolist()

    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{Path('another.db').absolute()}")
    assert main(["adapt", "robot", "anna.csv", "out=other"]) == 2
    error = capsys.readouterr().err
    assert f"its model {address} is not in" in error and "where bench build was run" in error
    monkeypatch.setitem(__import__("sys").modules, "touchbench_builder.personal", None)
    assert main(["adapt", "robot", "anna.csv", "out=other"]) == 2
    assert "install addons/builder" in capsys.readouterr().err
