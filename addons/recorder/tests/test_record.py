"""``bench record`` with a sensor that plays frames on a pseudo terminal."""

import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest

from addons.recorder.tests.player import Player, add_cobs, as_line, as_packet
from addons.streams.tests.test_live import make_recogniser
from bench.cli import main
from bench.errors import InputError
from touchbench_recorder import evening as evening_of
from touchbench_recorder.checks import check_corner, check_rest, check_strokes
from touchbench_recorder.files import Files
from touchbench_recorder.screen import Keys
from touchbench_streams import sensor_frames
from touchbench_streams.sensor import open_sensor
from touchbench_streams.sensor_frames import Frame, Gaps, Lines, Packets, remove_cobs

RATE = 100.0
FRAMES = np.random.default_rng(0).integers(0, 60, (4000, 4))
GRID = {"grid": "2x2", "gestures": "tap,pat,notouch", "subject": "anna", "repetitions": 2}
SHORT = GRID | {"seconds": 0.4, "rest": 0.2, "background": 1, "check": "no"}
CH = [f"ch{i}" for i in range(1, 5)]


def record(player, **keys):
    """Run ``bench record``; return its exit code."""
    player.start()
    typed = [f"{key}={value}" for key, value in (SHORT | keys).items()]
    try:
        return main(["record", "day1.csv", f"port={player.port}", *typed])
    finally:
        player.is_over = True


@pytest.mark.parametrize("encode", [as_line, as_packet])
def test_an_evening_is_prompted_and_every_frame_is_written(encode, capsys):
    player = Player(FRAMES, RATE, encode)
    name = "lines" if encode is as_line else "packets"
    assert record(player, format=name, columns="session=1,cover=fur") == 0
    captures, stream = pd.read_csv("day1.csv"), pd.read_csv("day1-stream.csv")
    prompts = captures[["gesture", "repetition"]].drop_duplicates()
    assert len(prompts) == 6 and set(prompts["gesture"]) == {"tap", "pat", "notouch"}
    assert captures[captures["frame"] == 1].shape[0] == 6
    assert set(captures["cover"]) == {"fur"} and set(captures["session"]) == {1}
    written = stream[CH].to_numpy()
    first = np.flatnonzero((FRAMES == written[0]).all(axis=1))[0]
    assert np.array_equal(written, FRAMES[first : first + len(written)])
    assert set(stream["label"].dropna()) == {"?", "tap", "pat"}
    for _, rows in captures.groupby(["gesture", "repetition"]):  # each lies in the stream, whole
        played = np.flatnonzero((FRAMES == rows[CH].to_numpy()[0]).all(axis=1))[0]
        assert np.array_equal(rows[CH].to_numpy(), FRAMES[played : played + len(rows)])
        assert 0.3 * RATE <= len(rows) <= 0.6 * RATE
    layout = ["grid=2x2", "rate_hz=100", "full_scale=1023"]
    assert main(["data", "import", "table", "day1.csv", "name=day1", *layout]) == 0
    assert main(["data", "import", "recording", "day1-stream.csv", "name=stream", *layout]) == 0
    assert "6 captures of 1 subject" in capsys.readouterr().out


def test_keys_repeat_pause_and_stop(monkeypatch, capsys):
    """r takes the last capture back, a pause begins the prompt anew, q stops; then it continues."""
    keys = {1: ["r"], 2: [" ", " "], 3: ["q"]}  # once so many captures are written
    written = []
    add = Files.add_capture

    def add_and_note(files, *capture):
        add(files, *capture)
        written.append(capture[1:3])

    def take(_):
        waiting = keys.get(len(written), [])
        return waiting.pop(0) if waiting else ""

    monkeypatch.setattr(Files, "add_capture", add_and_note)
    monkeypatch.setattr(Keys, "take", take)
    assert record(Player(FRAMES, RATE), gestures="tap,pat", background=0) == 0
    assert "stopped; the same command continues" in capsys.readouterr().err
    assert len(written) == 3 and written[0] == written[1]
    assert record(Player(FRAMES, RATE), gestures="tap,pat", background=0) == 0
    captures = pd.read_csv("day1.csv")
    prompts = captures.loc[captures["frame"] == 1, ["gesture", "repetition"]]
    assert len(prompts) == 4 and not prompts.duplicated().any()
    assert captures.groupby(["gesture", "repetition"]).size().between(30, 60).all()


def test_lost_frames_begin_another_recording_and_the_prompt_is_repeated(capsys):
    def lose(number, content):
        return b"" if 150 <= number < 170 else content

    assert record(Player(FRAMES, RATE, change=lose), gestures="tap,pat", background=0) == 0
    captures, stream = pd.read_csv("day1.csv"), pd.read_csv("day1-stream.csv")
    assert set(stream["recording"]) == {1, 2}
    assert captures[captures["frame"] == 1].shape[0] == 4
    assert captures.groupby(["gesture", "repetition"]).size().min() >= 0.3 * RATE


def test_noise_on_the_line_half_lines_and_a_restart_are_survived():
    def disturb(number, content):
        noise = {60: b"\xff\x00boot\r\n", 90: content[: len(content) // 2] + b"\n", 91: b"\n"}
        return noise.get(number, content)

    def restart(number, values):
        return as_line(number if number < 200 else number - 200, values)

    assert record(Player(FRAMES, RATE, restart, disturb), background=0) == 0
    captures, stream = pd.read_csv("day1.csv"), pd.read_csv("day1-stream.csv")
    assert captures[captures["frame"] == 1].shape[0] == 6
    assert stream["recording"].max() >= 2


@pytest.mark.parametrize("after", [0.3, 0.9, 1.7, 2.6])
def test_a_kill_loses_at_most_the_capture_that_is_being_made(tmp_path, after):
    np.save(tmp_path / "frames.npy", FRAMES)
    script = Path(__file__).with_name("player.py")
    player = [sys.executable, str(script), str(tmp_path / "frames.npy")]
    with subprocess.Popen([*player, str(RATE)], stdout=subprocess.PIPE, text=True) as sensor:
        port = sensor.stdout.readline().strip()
        typed = [f"{key}={value}" for key, value in SHORT.items()]
        command = [sys.executable, "-m", "bench", "record", "day1.csv", f"port={port}", *typed]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as killed:
            assert "measured" in killed.stderr.readline()
            time.sleep(after + 1)
            killed.send_signal(signal.SIGKILL)
        with open("day1.csv", "ab") as file:  # what a kill within a write leaves
            file.write(b"anna,tap,1,1,3,")
        before = pd.read_csv("day1.csv", nrows=0)
        done = len(Path("day1.journal").read_text().splitlines()) - 1
        finished = subprocess.run(command, capture_output=True, text=True)
        sensor.terminate()
    assert finished.returncode == 0, finished.stderr
    captures = pd.read_csv("day1.csv")
    assert list(captures) == list(before)
    prompts = captures.loc[captures["frame"] == 1, ["gesture", "repetition"]]
    assert len(prompts) == 6 and not prompts.duplicated().any()
    assert finished.stderr.count("go: ") == 6 - done
    main(["data", "import", "recording", "day1-stream.csv", "grid=2x2", "rate_hz=100"])


def test_a_full_disk_is_one_line_and_no_capture_is_half_written(tmp_path):
    np.save(tmp_path / "frames.npy", FRAMES)
    script = Path(__file__).with_name("player.py")
    player = [sys.executable, str(script), str(tmp_path / "frames.npy"), str(RATE)]
    limit = ["bash", "-c", 'ulimit -f 3; exec "$@"', "bash"]  # KiB of each file
    with subprocess.Popen(player, stdout=subprocess.PIPE, text=True) as sensor:
        port = sensor.stdout.readline().strip()
        typed = [f"{key}={value}" for key, value in SHORT.items()]
        command = [sys.executable, "-m", "bench", "record", "day1.csv", f"port={port}", *typed]
        full = subprocess.run([*limit, *command], capture_output=True, text=True)
        sensor.terminate()
    assert full.returncode == 2 and "cannot be written (File too large" in full.stderr, full.stderr
    assert "Traceback" not in full.stderr
    entries = [json.loads(line) for line in Path("day1.journal").read_text().splitlines()[1:]]
    captures = pd.read_csv("day1.csv")
    sizes = captures.groupby(["gesture", "repetition"]).size()
    assert {(e["gesture"], e["repetition"]): e["frames"] for e in entries} == dict(sizes)


def test_what_was_there_stays(tmp_path, capsys):
    player = Player(FRAMES, RATE)
    (tmp_path / "mine.csv").write_text("mine")
    typed = [f"{key}={value}" for key, value in SHORT.items()]
    assert main(["record", str(tmp_path / "mine.csv"), f"port={player.port}", *typed]) == 2
    assert (tmp_path / "mine.csv").read_text() == "mine"
    assert record(player, repetitions=1, background=0) == 0
    assert record(Player(FRAMES, RATE), grid="1x4") == 2
    assert "day1.csv was begun with grid=2x2, now 1x4" in capsys.readouterr().err
    (tmp_path / "day1.journal").write_text("notes\n")
    before = Path("day1.csv").read_bytes()
    assert record(Player(FRAMES, RATE)) == 2
    assert "day1.journal is damaged" in capsys.readouterr().err
    assert Path("day1.csv").read_bytes() == before


def test_keys_may_be_corrected_until_a_capture_is_made(capsys):
    assert record(Player(FRAMES, RATE), grid="3x3") == 2
    assert "instead of 9" in capsys.readouterr().err
    assert record(Player(FRAMES, RATE), repetitions=1, background=0) == 0
    assert list(pd.read_csv("day1.csv"))[-4:] == list(pd.read_csv("day1-stream.csv"))[-4:] == CH


@pytest.mark.parametrize("killed", ["os.truncate", "touchbench_recorder.files.Files._append"])
def test_a_kill_while_a_capture_is_taken_back_loses_no_other(killed, tmp_path, monkeypatch):
    settings, table = {"grid": "2x2", "columns": {}}, tmp_path / "day1.csv"
    files = Files(table, settings, 4)
    for repetition in (1, 2):
        files.add_capture("anna", "tap", repetition, np.ones((3, 4)))
    with monkeypatch.context() as kill, pytest.raises(KeyboardInterrupt):
        kill.setattr(killed, Mock(side_effect=KeyboardInterrupt))
        files.take_back()
    files.close()
    again = Files(table, settings, 4)
    kept = [entry["repetition"] for entry in again.done]
    assert kept in ([1], [1, 2]) and kept == sorted(set(pd.read_csv(table)["repetition"]))
    again.close()


@pytest.mark.parametrize(
    ("typed", "fact"),
    [
        (["port=/dev/none"], "there is no such port; known: "),
        (["tcp=localhost"], "give HOST:PORT"),
        (["tcp=127.0.0.1:9"], "cannot be reached (Connection refused)"),
        (["port=a", "tcp=b:1"], "give one"),
        (["gestures=tap,tap"], "give different names"),
        (["subject=a,b"], "give one person"),
        (["columns=label=1"], "label is a column of the file"),
        (["columns=ch1=1"], "ch1 is a column of the file"),
        (['subject="anna'], "give different names"),
        (["subject=an\nna"], "give different names"),
        (["gestures=tap,?"], "give different names"),
        (["seconds=9999"], "give a number of seconds"),
        (["grid=8"], "grid=8"),
    ],
)
def test_wrong_keys_are_one_line(typed, fact, capsys):
    keys = dict(word.split("=", 1) for word in typed)
    words = [f"{key}={value}" for key, value in (SHORT | keys).items()]
    assert main(["record", "day1.csv", *words]) == 2
    error = capsys.readouterr().err
    assert fact in error and error.count("\n") == 1, error
    assert not Path("day1.csv").exists()


@pytest.mark.parametrize(
    ("content", "keys", "fact"),
    [
        (b"", {}, "nothing arrived"),
        (b"1,2,3\n" * 5, {}, "3 values instead of 4"),
        (b"1,2,3,4000\n" * 5, {}, "is not between 0 and the full scale"),
        (bytes(range(128, 250)) * 3, {}, "no text; check baud="),
        (as_packet(1, range(600, 630)) * 5 + b"\n", {}, "no text; check baud="),
        (b"1,2,3,4\n", {"format": "packets"}, "text; give format=lines"),
        (b"\1\2\3\0" * 5, {"format": "packets"}, "instead of 12"),
    ],
)
def test_a_sensor_that_sends_no_frames_says_what_came(content, keys, fact, capsys, monkeypatch):
    monkeypatch.setattr(sensor_frames, "SILENCE_S", 0.5)
    player = Player(FRAMES, RATE, change=lambda number, _: content)
    assert record(player, **keys) == 2
    assert fact in capsys.readouterr().err


def arrivals(values, rate_hz=RATE):
    """Frames at a steady rate."""
    return [Frame(i / rate_hz, np.asarray(v, dtype=float)) for i, v in enumerate(values)]


def test_checks_by_hand():
    quiet = arrivals(np.random.default_rng(1).integers(0, 5, (300, 6)))
    assert check_rest(quiet, RATE, 1023) == []
    assert "not 200" in check_rest(quiet, 200, 1023)[0]
    assert "9 % of full scale" in check_rest(arrivals(np.full((300, 6), 95)), RATE, 1023)[0]
    uneven = [
        frame._replace(seconds=(i - i % 8) / RATE + i % 8 / 9999) for i, frame in enumerate(quiet)
    ]
    assert any("unevenly" in line for line in check_rest(uneven, None, 1023))
    stroked = arrivals(np.random.default_rng(2).integers(0, 900, (300, 6)) * [1, 1, 1, 1, 0, 1])
    assert check_strokes(stroked, (2, 3), 1023) == [
        "taxels that never change: row 1 col 1; check wires, or stroke them"
    ]
    assert "check full_scale=" in check_strokes(stroked, (2, 3), 65535)[1]
    for taxel, word in ((2, ""), (0, "mirrored"), (3, "transposed"), (5, "upside down")):
        press = arrivals(np.eye(6)[[taxel] * 50] * 500 + 3)
        lines = check_corner(quiet, press, (2, 3), 1023)
        assert (word in lines[0]) if word else not lines


def test_counters_time_stamps_and_wraps():
    def lost(stamps, **keys):
        gaps = Gaps(**keys)
        return [gaps.before(stamp) for stamp in stamps]

    assert sum(n for n, _ in lost([*range(40), *range(43, 60)])) == 3
    assert sum(n for n, _ in lost([*range(230, 256), *range(2, 30)])) == 2  # of a byte
    stamps = [18.5 * i for i in range(60) if i not in (40, 41)]
    assert sum(n for n, _ in lost(stamps)) == 2
    assert [is_new for _, is_new in lost([*range(500, 550), *range(10)])].count(True) == 1


def test_lines_and_packets_hold_what_was_sent():
    rng = np.random.default_rng(3)
    values = rng.integers(0, 1024, (50, 4)) * rng.integers(0, 2, (50, 4))
    header = b"n,a,b,c,d\n"
    for decoder, encode, head in ((Lines, as_line, header), (Packets, as_packet, b"\x07\x01\0")):
        sent = head + b"".join(encode(i, v) for i, v in enumerate(values.tolist()))
        frames = [*decoder(4, 1023).decode(io.BytesIO(sent))]
        assert np.array_equal([frame.values for frame in frames], values)
    for size in (0, 1, 253, 254, 255, 600):
        content = rng.integers(0, 3, size).astype(np.uint8).tobytes()
        assert remove_cobs(add_cobs(content)[:-1]) == content
    long = bytes([7]) * 700
    assert remove_cobs(add_cobs(long)[:-1]) == long


def test_a_sensor_in_the_network_is_read():
    import socket

    with socket.create_server(("127.0.0.1", 0)) as server:

        def send():
            with server.accept()[0] as connection:
                connection.sendall(b"1 2 3 4\n" * 3)

        thread = threading.Thread(target=send)
        thread.start()
        with open_sensor("", 1, f"127.0.0.1:{server.getsockname()[1]}") as stream:
            assert stream.readline() == b"1 2 3 4\n"
        thread.join()
    with pytest.raises(InputError):
        open_sensor("", 1, "no such host:1")


@pytest.mark.parametrize("encode", [as_line, as_packet])
def test_a_sensor_on_a_port_is_classified_live(encode, monkeypatch, capsys):
    recogniser = make_recogniser()
    monkeypatch.setattr("bench.running.saved.load_recogniser", lambda _: recogniser)
    player = Player(np.full((100, 6), 1), RATE, encode)
    name = "lines" if encode is as_line else "packets"
    play = threading.Thread(target=lambda: (player.run(), os.close(player.master)))
    play.start()
    words = [f"port={player.port}", f"format={name}", "hop_ms=100"]
    assert main(["live", "m", *words]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[0] == "capture,ms,label,confidence,settled" and len(rows) >= 8
    play.join()


@pytest.mark.parametrize(
    ("content", "fact"), [(b"", "nothing arrived"), (b"\1\2\3\0\n", "no text; check baud=")]
)
def test_a_silent_sensor_is_named_live(content, fact, monkeypatch, capsys):
    monkeypatch.setattr("bench.running.saved.load_recogniser", lambda _: make_recogniser())
    monkeypatch.setattr(sensor_frames, "SILENCE_S", 0.5)
    player = Player(np.full((30, 6), 1), RATE, change=lambda *_: content)
    player.start()
    assert main(["live", "m", f"port={player.port}"]) == 2
    assert fact in capsys.readouterr().err


def test_the_order_of_prompts_is_drawn_for_each_person_and_stays():
    keys = {"path": None, "conditions": {}, "format": "", "grid": "", "full_scale": 1}
    keys |= {"rate_hz": None, "repetitions": 3, "seconds": 1, "rest": 1, "background": 0}
    gestures = tuple("abcdefgh")
    anna, ben = (
        evening_of.Evening(subject=name, gestures=gestures, check=False, **keys).prompts()
        for name in ("anna", "ben")
    )
    assert sorted(anna) == sorted(ben) and anna != ben
    assert [sorted(g for g, n in anna if n == r) for r in (1, 2, 3)] == [[*gestures]] * 3
    assert json.dumps(anna) == json.dumps(
        evening_of.Evening(subject="anna", gestures=gestures, check=False, **keys).prompts()
    )
