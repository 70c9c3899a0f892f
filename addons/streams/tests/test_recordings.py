"""Recordings: reading, refusals, storing; composing from captures, and cutting into them."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bench
from bench.cli import main
from bench.corpora import synth
from bench.corpora.corpus import Corpus
from bench.corpora.folder import content_digest
from bench.corpora.library import import_corpus, open_corpus, open_imported
from bench.corpora.skin import Design
from bench.errors import InputError
from touchbench_streams import synth_recordings
from touchbench_streams.composer import compose_recordings, split_touch_and_background
from touchbench_streams.read import read as read_captures
from touchbench_streams.recordings import (
    Recordings,
    convert_recordings,
    cut_into_captures,
    event_table,
    find_events,
    restore_recordings,
)
from touchbench_streams.stored import load_recordings

HEADER = "recording,subject,label,ch1,ch2"
# Two recordings: r1 of ann with 9 frames, r2 of bob with 3.
LABELS = ["", "pat", "pat", "rub", "None", "none", "pat", "", "pat", "pat", " ", "rub"]
EVENTS = [
    (0, 1, 3, "pat"),
    (0, 3, 4, "rub"),
    (0, 6, 7, "pat"),
    (0, 8, 9, "pat"),
    (1, 0, 1, "pat"),
    (1, 2, 3, "rub"),
]
OPTIONS = {"name": "arm", "rate_hz": "50", "grid": "1x2"}


def read(*given, **options):
    return restore_recordings(read_captures(*given, **options))


def csv_rows(labels=LABELS):
    return [
        f"{'r1,ann' if i < 9 else 'r2,bob'},{label},{i},{2 * i}" for i, label in enumerate(labels)
    ]


def write_csv(folder, lines=None, header=HEADER):
    path = folder / "day.csv"
    path.write_text(
        "".join(f"{line}\n" for line in (header, *(csv_rows() if lines is None else lines)))
    )
    return path


def make_recordings(events, lengths=(9, 3)):
    """Recordings of one taxel whose readings count up."""
    frames = [np.arange(n, dtype=np.uint16).reshape(n, 1, 1) for n in lengths]
    captures = pd.DataFrame({"subject": [f"s{i}" for i in range(len(lengths))], "gesture": ""})
    return Recordings(Corpus.from_captures(frames, captures, 50.0), event_table(events))


def event_rows(events):
    return list(events.itertuples(index=False, name=None))


def check_refused(folder, *facts, lines=None, header=HEADER, **options):
    with pytest.raises(InputError) as error:
        read(write_csv(folder, lines, header), **({"rate_hz": 50.0, "grid": "1x2"} | options))
    message = str(error.value)
    assert all(fact in message for fact in facts) and "\n" not in message and len(message) <= 300, (
        message
    )


def test_a_table_by_hand(tmp_path):
    value = read(write_csv(tmp_path), 50.0, "1x2")
    assert (
        event_rows(value.events) == EVENTS
    )  # pat follows rub at once: two events; a recording that ends ends its event
    assert value.events.dtypes.astype(str).tolist()[:3] == ["int64"] * 3
    assert value.corpus.captures.to_dict("list") == {
        "subject": ["ann", "bob"],
        "gesture": ["", ""],
        "recording": [0, 1],
    }
    assert (
        read_captures(write_csv(tmp_path), 50.0, "1x2").captures["recording"].tolist()
        == ["r1"] * 7 + ["r2"] * 3
    )
    assert value.corpus.lengths.tolist() == [9, 3] and value.background_frames().tolist() == [4, 1]
    assert value.corpus[1].tolist() == [[[9, 18]], [[10, 20]], [[11, 22]]]


def read_parquet(folder, **columns):
    pq.write_table(pa.table(columns), folder / "day.parquet")
    return read(folder / "day.parquet", 50.0, "1x2")


def test_the_same_as_parquet_with_gaps_and_without_names(tmp_path):
    labels = [label.strip() if label.strip() not in ("", "none") else None for label in LABELS]
    value = read_parquet(
        tmp_path, label=labels, frame=[*range(1, 13)], b=[*range(12)], a=[*range(12)]
    )
    first = [
        *EVENTS[:3],
        (0, 8, 10, "pat"),
        (0, 11, 12, "rub"),
    ]  # now one recording: the pats touch each other
    assert event_rows(value.events) == first and value.subjects.tolist() == ["1"]
    assert "one subject" in value.corpus.info["warnings"][0]
    numbers = read_parquet(
        tmp_path, label=pa.array([None, 1, 1, 10, None], pa.int8()), a=[*range(5)], b=[*range(5)]
    )
    assert event_rows(numbers.events) == [
        (0, 1, 3, "1"),
        (0, 3, 4, "10"),
    ]  # whole numbers are gestures


@pytest.mark.parametrize("word", ["0", "nan", "NULL", "rest", "Idle", "background", "-"])
def test_another_word_for_background_is_read_as_an_empty_label_with_a_word(tmp_path, word):
    labels = ["", "pat", "pat", "", "rub", ""]
    empty = read_captures(write_csv(tmp_path, [f"r1,ann,{n},1,2" for n in labels]), 50.0, "1x2")
    lines = [f"r1,ann,{label or word},1,2" for label in labels]
    found = read_captures(write_csv(tmp_path, lines), 50.0, "1x2")
    pd.testing.assert_frame_equal(found.captures, empty.captures)
    (warning,) = found.info["warnings"]
    assert warning.startswith(f"label {word!r} (3 frames) is read as background")
    if word == "rest":
        both = read_captures(write_csv(tmp_path, [*lines, "r1,ann,,1,2"]), 50.0, "1x2")
        assert "rest" in both.gestures and "is read as a gesture" in both.info["warnings"][0]


def test_files_that_are_refused(tmp_path):
    for label in ("\u200b", "pat\u200b", "pa\xadt", "\u202epat"):  # labels that look the same
        lines = ["r1,ann,,1,2", f"r1,ann,{label},1,2"]
        check_refused(tmp_path, "line 3: label is", "cannot be seen; correct it", lines=lines)
    for label in ("\u0645\u06cc\u200c\u062e", "\u00fc"):  # joiners that join
        assert event_rows(
            read(write_csv(tmp_path, [f"r1,ann,{label},1,2"]), 50.0, "1x2").events
        ) == [(0, 0, 1, label)]
    check_refused(tmp_path, "no column label", header=HEADER.replace("label", "gesture"))
    check_refused(
        tmp_path,
        "line 6",
        "recording 'r1' begins a second time",
        lines=[*csv_rows()[:3], csv_rows()[10], *csv_rows()[3:9]],
    )
    check_refused(tmp_path, "line 3", "subject is empty", lines=[csv_rows()[0], "r1,,pat,1,2"])
    check_refused(
        tmp_path, "delete the column gesture", header=HEADER + ",gesture", lines=["r,a,pat,1,2,pat"]
    )
    extra = [f"{i if i != 4 else 7},{line}" for i, line in enumerate(csv_rows()[:9])]
    check_refused(
        tmp_path, "line 6", "frame 7 follows frame 3", header=f"frame,{HEADER}", lines=extra
    )
    covers = [f"{'fur' if i < 4 else 'skin'},{line}" for i, line in enumerate(csv_rows()[:9])]
    check_refused(
        tmp_path, "line 6", "cover changes within", header=f"cover,{HEADER}", lines=covers
    )


def test_an_event_with_the_name_of_gaps_is_refused():
    with pytest.raises(
        InputError,
        match="event 0 .*frames 2 to 4.* is called background, .* empty label; correct it",
    ):
        cut_into_captures(make_recordings([(1, 2, 4, "background")], (9, 5)))


def test_some_of_the_recordings_keep_their_events():
    value = make_recordings([*EVENTS, (3, 1, 2, "tap")], lengths=(9, 3, 5, 4))
    some = value[np.array([3, 2, 1])]
    assert event_rows(some.events) == [(0, 1, 2, "tap"), (2, 0, 1, "pat"), (2, 2, 3, "rub")]
    assert some.subjects.tolist() == ["s3", "s2", "s1"] and some.background_frames().tolist() == [
        3,
        5,
        1,
    ]
    assert (
        event_rows(value[value.subjects == "s1"].events)
        == event_rows(value[1].events)
        == [(0, *e[1:]) for e in EVENTS[4:]]
    )
    assert some.frame_labels().tolist() == ["", "tap", "", "", *[""] * 5, "pat", "", "rub"]


@given(
    st.lists(
        st.lists(st.sampled_from(["", "pat", "rub"]), min_size=1, max_size=12),
        min_size=1,
        max_size=5,
    )
)
def test_labels_become_events_and_labels_again(labels):
    lengths, flat = tuple(map(len, labels)), [label for one in labels for label in one]
    events = find_events(
        np.array([label or None for label in flat], dtype=object), np.array(lengths)
    )
    value = Recordings(make_recordings([], lengths).corpus, events)
    assert value.frame_labels().tolist() == flat
    expected = []  # frame by frame
    for number, one in enumerate(labels):
        for i, label in enumerate(one):
            if label and i and one[i - 1] == label:
                expected[-1] = (*expected[-1][:2], i + 1, label)
            elif label:
                expected.append((number, i, i + 1, label))
    assert event_rows(events) == expected


def test_what_is_imported_is_loaded_again_and_serves_as_captures_cut_at_its_labels(
    tmp_path, capsys
):
    path = write_csv(tmp_path)
    direct = read_captures(path, 50.0, "1x2")
    assert (
        main(["data", "import", "recording", str(path), *(f"{k}={v}" for k, v in OPTIONS.items())])
        == 0
    )
    out = capsys.readouterr().out
    assert "arm: 6 captures, 2 subjects, 2 gestures" in out
    assert "background: further 4 captures without a gesture, 0.00167 of 0.004 minutes" in out
    stored = open_imported("arm")
    assert np.array_equal(stored.frames, direct.frames) and stored.digest
    pd.testing.assert_frame_equal(stored.captures, direct.captures)
    pd.testing.assert_frame_equal(
        restore_recordings(stored).events, restore_recordings(direct).events
    )
    assert main(["data"]) == 0 and "6 captures, 2 subjects, 2 gestures" in capsys.readouterr().out
    with pytest.raises(InputError, match="no column 'gesture'"):
        load_recordings("arm", where="gesture == 'pat'")
    touches = open_corpus("arm", {})
    assert touches.gestures.tolist() == [event[3] for event in EVENTS]
    assert [t[:, 0, 0].tolist() for t in touches] == [[1, 2], [3], [6], [8], [9], [11]]
    table = bench.extract(data="arm", features="jung28", where="recording == 'r2'")
    assert table[["subject", "gesture", "recording"]].values.tolist() == [
        ["bob", "pat", "r2"],
        ["bob", "rub", "r2"],
    ]
    assert (
        capsys.readouterr().err
        == "arm: its 2 captures with a gesture are used; background and ? are left out\n"
    )
    import_corpus(
        "recording",
        write_csv(tmp_path, [line.replace(line.split(",")[2], "") for line in csv_rows()]),
        OPTIONS,
    )
    with pytest.raises(InputError, match="all captures are background or .; label"):
        open_corpus("arm", {})


def test_recordings_and_captures_are_not_mistaken_for_each_other(tmp_path):
    import_corpus("recording", write_csv(tmp_path), OPTIONS)
    captures = write_csv(tmp_path, ["ann,pat,0,1,2"], "subject,gesture,frame,a,b")
    import_corpus("table", captures, OPTIONS | {"name": "cut"})
    with pytest.raises(
        InputError, match="cut holds captures, not recordings; use bench run data=cut"
    ):
        load_recordings("cut")
    with pytest.raises(InputError, match="data=leg: not imported"):
        load_recordings("leg")
    import_corpus("table", captures, OPTIONS)  # takes the name of the recordings
    assert len(open_corpus("arm", {})) == 1


def test_generated_recordings_are_those_of_their_parameters_and_are_stored():
    small = {"variants": ("normal",), "rate_hz": 50.0, "seed": 3}
    value = synth_recordings.generate(subjects=2, **small)
    assert value.corpus.synthetic and value.subjects.tolist() == ["1", "2"]
    for number in (0, 1):  # every gesture once
        assert sorted(value[number].events["gesture"]) == sorted(synth.GESTURES)
    assert (
        value[0].events["gesture"].tolist() != value[1].events["gesture"].tolist()
    )  # in an order of its own
    more, other = (
        synth_recordings.generate(subjects=n, **small | {"seed": seed})
        for n, seed in ((3, 3), (2, 4))
    )
    assert (
        content_digest(value.corpus)
        == content_digest(more[:2].corpus)
        != content_digest(other.corpus)
    )
    stored = load_recordings("synth", small | {"subjects": 2})
    assert stored.path and content_digest(stored) == content_digest(cut_into_captures(value))
    with pytest.raises(InputError, match="data.subjects=0: give at least 1"):
        load_recordings("synth", {"subjects": 0})
    labels, lengths = value.frame_labels(), value.corpus.lengths
    idle = (
        np.diff(np.flatnonzero(np.append(labels != "", True)), prepend=-1) - 1
    )  # frames between touches
    assert 150 <= idle[idle > 0].min() and idle.max() <= 2 * 500 + 30
    far = (
        np.convolve(labels[: lengths[0]] != "", np.ones(101), "same") == 0
    )  # a second from any touch
    quiet = value.corpus[0][far].astype(float)
    noise = np.diff(quiet, axis=0).std() / np.sqrt(2)
    assert 1.4 < noise < 1.7  # 1.5, and what rounding adds
    assert quiet[-100:].mean((1, 2)).mean() != pytest.approx(
        quiet[:100].mean((1, 2)).mean(), abs=0.5
    )  # drift


def numbered_captures(subjects=("a", "b"), rate_hz=10.0):
    """Captures of one taxel whose readings number them: 1000 * capture + frame."""
    rows = [(s, g, v) for s in subjects for g in ("pat", "rub", "none") for v in ("hard", "soft")]
    lengths = [70 if g == "none" else 35 + 5 * i for i, (_, g, _) in enumerate(rows)]
    arrays = [
        1000.0 * (i + 1) + np.arange(n, dtype=np.float32).reshape(-1, 1, 1)
        for i, n in enumerate(lengths)
    ]
    return Corpus.from_captures(
        arrays, pd.DataFrame(rows, columns=["subject", "gesture", "cover"]), rate_hz, name="n"
    )


def test_a_recording_is_made_of_excerpts_of_the_subject_alone():
    corpus = numbered_captures(tuple("abcdef"))
    recordings = compose_recordings(*split_touch_and_background(corpus, "none"))
    of = corpus.captures
    for i, subject in enumerate(recordings.subjects):
        frames = recordings.corpus[i][:, 0, 0]
        capture = (frames // 1000 - 1).astype(int)
        assert set(of["subject"][capture]) == {subject}
        events = recordings.events[recordings.events["recording"] == i]
        touched = np.zeros(len(frames), bool)
        used = []
        for start, end, gesture in events[["start", "end", "gesture"]].itertuples(index=False):
            assert (np.diff(frames[start:end]) == 1).all()  # one excerpt, in order
            assert of["gesture"][capture[start]] == gesture and 20 <= end - start <= 60
            assert (
                of["cover"][capture[start - 1]] == of["cover"][capture[start]]
            )  # its background has its conditions
            assert (
                start >= 30 and not touched[start - 30 : start].any()
            )  # at least 3 s of background before
            touched[start:end] = True
            used.append(capture[start])
        assert sorted(used) == sorted(
            np.flatnonzero((of["subject"] == subject) & (of["gesture"] != "none"))
        )
        assert set(of["gesture"][capture[~touched]]) == {"none"}


def test_a_subject_has_the_same_recording_whoever_else_is_there():
    corpus = numbered_captures()
    both = compose_recordings(*split_touch_and_background(corpus, "none"))
    one = compose_recordings(
        *split_touch_and_background(corpus[np.flatnonzero(corpus.subjects == "b")], "none")
    )
    assert np.array_equal(both.corpus[1], one.corpus[0])
    pd.testing.assert_frame_equal(both[[1]].events, one.events)


def test_quiet_ends_of_captures():
    pressure = (
        np.array([0, 0, 1, 0, 9, 10, 2, 9, 0, 0, 0], dtype=np.float32).repeat(2).reshape(-1, 1, 1)
    )
    table = pd.DataFrame({"subject": ["a"], "gesture": ["pat"]})
    corpus = Corpus.from_captures([pressure], table, rate_hz=16.0)
    touches, quiet = split_touch_and_background(corpus, "quiet")
    # a tenth of the range is 1: frames 4 to 15 are touched (1 is not below a tenth);
    # a quarter of a second is 4 frames
    assert touches[0][:, 0, 0].tolist() == pressure[4:16, 0, 0].tolist()
    assert [each[:, 0, 0].tolist() for each in quiet] == [[0, 0, 0, 0], [0, 0, 0, 0, 0, 0]]
    with pytest.raises(InputError, match="background=quiet"):
        split_touch_and_background(
            corpus.with_fields(starts=np.array([4]), lengths=np.array([12])), "quiet"
        )
    with pytest.raises(InputError, match="background=rub"):
        split_touch_and_background(corpus, "rub")


def test_a_subject_without_background_is_refused():
    corpus = numbered_captures()
    lacking = corpus[((corpus.subjects != "b") | (corpus.gestures != "none")).nonzero()[0]]
    with pytest.raises(InputError, match="subject b"):
        compose_recordings(*split_touch_and_background(lacking, "none"))


@given(
    st.lists(
        st.lists(st.tuples(st.integers(1, 4), st.sampled_from(["", "pat", "rub"])), min_size=1),
        min_size=1,
    )
)
def test_captures_of_recordings_are_their_frames_and_make_them_again(plans):
    rows, lengths = [], []
    for number, plan in enumerate(plans):
        ends = np.cumsum([frames for frames, _ in plan]).tolist()
        rows += [
            (number, end - n, end, gesture)
            for end, (n, gesture) in zip(ends, plan, strict=True)
            if gesture
        ]
        lengths.append(ends[-1])
    recordings = make_recordings(rows, lengths)
    captures = cut_into_captures(recordings)
    every = np.concatenate([np.arange(n) for n in lengths])  # every frame once, in order
    assert np.array_equal(np.concatenate([*captures])[:, 0, 0], every)
    touched = captures.captures[captures.captures["gesture"] != "background"]
    assert touched["gesture"].tolist() == recordings.events["gesture"].tolist()
    again, expected = (
        restore_recordings(captures[captures.subjects != "s1"]),
        recordings[recordings.subjects != "s1"],
    )
    assert [a.tolist() for a in again.corpus] == [a.tolist() for a in expected.corpus]
    pd.testing.assert_frame_equal(again.events, expected.events)


@pytest.mark.parametrize("rate_hz", [25.0, 20.0, 50.0])
def test_a_design_measures_a_recording_as_a_whole(rate_hz):
    value = make_recordings([(0, 3, 8, "tap"), (0, 8, 15, "rub"), (1, 0, 4, "tap")], (41, 9))
    captures = cut_into_captures(value)
    made = convert_recordings(Design(rate_hz=rate_hz), captures)
    restored, step = restore_recordings(made), rate_hz / 50
    whole = Design(rate_hz=rate_hz).convert(value.corpus)
    for got, wanted in zip(restored.corpus, whole, strict=True):
        np.testing.assert_array_equal(got, wanted)
    times = value.labelled[["start", "end"]].to_numpy() * step
    assert np.abs(restored.labelled[["start", "end"]].to_numpy() - times).max() <= 0.5
    assert [*restored.labelled["gesture"]] == [*value.labelled["gesture"]]
    np.testing.assert_array_equal(made.index, captures.index)


def test_touches_of_less_than_a_frame_keep_one():
    captures = cut_into_captures(make_recordings([(0, 4, 5, "tap"), (0, 5, 6, "rub")], (30,)))
    made = convert_recordings(Design(rate_hz=10.0), captures)
    assert made.lengths.tolist() == [1, 1, 1, 3] and len(made.frames) == 6
    with pytest.raises(InputError, match="skin.rate_hz=2: a recording has 4 touches and gaps"):
        convert_recordings(Design(rate_hz=2.0), captures)
