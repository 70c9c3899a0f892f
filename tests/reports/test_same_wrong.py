"""Film strips of captures with the same wrong label, in the report and in bench data show."""

import base64
import io
import re
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

import bench
from bench.cli import main
from bench.outcomes.same_wrong import Agreement, agreement
from bench.outcomes.store import connect
from bench.reports import page, same_wrong
from bench.reports.same_wrong import curve, same_wrong_section, strip
from tests.conftest import random_corpus
from tests.reports.store import tracked_run

CHIP = dict.fromkeys(("chip_flash_bytes", "chip_ram_bytes", "chip_most_instructions"), 1e4)


def predicted(corpus, labels):
    """Predictions of one system: right except for the captures of ``labels``."""
    names = sorted(set(corpus.gestures))
    said = [labels.get(int(c), g) for c, g in zip(corpus.index, corpus.gestures, strict=True)]
    rows = {"fold": corpus.subjects, "capture": corpus.index, "start": 0, "frames": corpus.lengths}
    rows |= {"true": corpus.gestures, "subject": corpus.subjects}
    return pd.DataFrame(rows | {f"p_{g}": [0.7 if g == s else 0.15 for s in said] for g in names})


def agreed(corpus, digest="d" * 64, synthetic="false"):
    """Of nine captures of the first subject, five systems label capture 0 and all its taps wrongly."""
    mine = [int(c) for c in corpus.index[corpus.subjects == corpus.subjects[0]]]
    wrong = {c: "rub" for c in mine if corpus.gestures[c] == "tap"} | {0: "rub"}
    run = {"data": "mine", "corpus_digest": digest, "synthetic": synthetic}
    return Agreement("mine", run, list("abcde"), agreement([predicted(corpus, wrong)] * 5)), wrong


def images(section):
    return [films for each in section["pairs"].values() for _, films in each]


def test_strips_of_the_capture_and_of_either_label(monkeypatch):
    corpus = random_corpus(digest="d" * 64)
    found, wrong = agreed(corpus)
    monkeypatch.setattr(same_wrong, "imported", lambda: ["mine"])
    monkeypatch.setattr(same_wrong, "open_corpus", lambda name, parameters: corpus)
    section = same_wrong_section(found)
    assert section["listed"] == len(wrong) and section["left_out"] == 0 and not section["why"]
    labels = [[re.sub(r"capture \d+: ", "", words).split(",")[0] for words, *_ in films] for films in images(section)]
    assert ["labelled pat", "pat", "rub"] in labels  # and no tap of this subject is ever right
    assert labels.count(["labelled tap", "rub"]) == len(wrong) - 1
    monkeypatch.setattr(same_wrong, "SHOWN", 1)
    assert same_wrong_section(found)["left_out"] == len(wrong) - 1
    for change, why in ((agreed(corpus, "e" * 64), "has changed"), (agreed(corpus, synthetic="true"), "generated")):
        section = same_wrong_section(change[0])
        assert why in section["why"] and not images(section) and len(section["table"].rows) == 1
    monkeypatch.undo()
    assert same_wrong_section(found)["why"] == "mine is not imported"


def test_pixels_and_points_by_hand():
    frames = np.zeros((16, 2, 3), np.uint16)
    frames[1, 0, 2], frames[15, 1, 0] = 100, 25  # the middles of the first and the last eighth
    image = Image.open(io.BytesIO(base64.b64decode(strip(frames, 100.0))))
    assert image.size == (8 * 3 + 7, 2) and image.mode == "P" and image.info["transparency"] == 128
    pixels = np.asarray(image)
    expected = np.zeros((2, 31), int)
    expected[:, 3::4] = 128  # gaps
    expected[0, 2], expected[1, 28] = 127, 64  # the root of a quarter of the scale is half of it
    assert (pixels == expected).all()
    assert curve(np.array([0.0, 5.0, 10.0]), 0.0, 10.0) == "20,30 60,15 100,0"
    peaks = curve(np.arange(240) % 2 * 4.0, 0.0, 8.0).split()
    assert len(peaks) == 120 and {p.split(",")[1] for p in peaks} == {"15"}  # no peak is lost


def test_the_page_and_data_show_name_them(store, capsys, monkeypatch):
    small = ["subjects=2", "variants=normal", "repetitions=1"]
    corpus = bench.corpus("synth", subjects=2, variants=("normal",), repetitions=1)
    names = sorted(set(corpus.gestures))
    other = {int(c): names[names.index(corpus.gestures[c]) - 1] for c in (3, 20)}
    for i in range(5):
        labels = other | ({20: corpus.gestures[20]} if i == 2 else {})
        tracked_run(store, f"m{i}", predicted(corpus, labels), corpus_digest=corpus.digest)
    on_chip = {"touchbench.kind": "chip", "chip.bits": 8}  # and never run otherwise
    chip = tracked_run(store, "only_on_chip", predicted(corpus, {}), corpus_digest=corpus.digest, **on_chip)
    store.log(chip, CHIP)
    with monkeypatch.context() as patch:  # nothing is drawn
        patch.setattr("matplotlib.figure.Figure.savefig", lambda self, path, **_: Path(path).write_text("<svg/>"))
        page.write_report(connect(), Path("report"))
    table = pd.read_csv("report/same_wrong_label.csv")
    assert table[["capture", "true", "predicted"]].values.tolist() == [[3, corpus.gestures[3], other[3]]]
    text = Path("report/index.html").read_text(encoding="utf-8")
    assert "the captures are generated" in text and "only_on_chip" in text
    assert main(["data", "show", "synth", *small]) == 0
    assert f"  {corpus.gestures[3]}, predicted as {other[3]}: 3\n" in capsys.readouterr().out
    assert main(["data", "show", "synth", *small, f"where=subject != '{corpus.subjects[3]}'"]) == 0
    assert "Same wrong label from all 5 systems: 0 captures" in capsys.readouterr().out
    assert main(["data", "show", "synth", *small[:-1], "repetitions=2"]) == 0  # other captures
    assert "Same wrong label" not in capsys.readouterr().out
