"""Scene files: what their lines mean, and what is refused in one line."""

import pytest

from bench.candidate import Losses
from bench.corpora.faults import SEVERITIES, usual_faults
from bench.errors import InputError
from bench.options import keys
from bench.outcomes.scene import EVERY, boards, read_scene

SCENE = """
by = "ram"
unlisted = "ignored"
[reactions]
calm = ["stroke", "rub"]
[costs]
silence = 0.5
scratch = { calm = 3 }
[budget]
board = "pico2"
share = 0.25
ram = "20kB"
decision = "1s"
[faults]
names = ["noise"]
severity = 2
loss = 7
[people]
worst_person = 60
worst_tenth = 70.5
"""


def test_lines_are_keys_of_choose(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(SCENE)
    scene = read_scene(str(path))
    assert scene.values == {
        "by": "ram",
        "max_flash": "1048.58kB",  # a quarter of 4096 KiB
        "max_ram": "20kB",  # instead of a quarter of 520 KiB
        "clock": "150MHz",
        "max_decision": "1s",
        "max_fault_loss": "7",
        "min_worst_person": "60",
        "min_worst_tenth": "70.5",
    }
    assert {*scene.values} - {"clock"} <= {*keys("choose")} and scene.faults == Losses(("noise",), 2)
    assert scene.faults.circumstances == [("noise", 1), ("noise", 2)]
    robot = scene.reactions
    assert (robot.groups, robot.costs, robot.silence, robot.ignored) == (
        {"calm": ["stroke", "rub"]},
        {"scratch": {"calm": 3.0}},
        0.5,
        True,
    )
    (line,) = scene.board.sentences(scene.values)  # of flash alone: RAM has its own line
    assert line.startswith("The budget of flash is 25 % of that of Raspberry Pi Pico 2") and "https://" in line


def test_shipped_scenes_and_boards_can_be_read():
    for name in ("companion", "toy", "handle"):
        assert read_scene(name).reactions.groups
    every = boards()
    assert (Losses(EVERY).severity, {*EVERY}) == (SEVERITIES, {*usual_faults()})
    assert len(every) >= 10 and all(b.source.startswith("https://") and b.ram_kb < b.flash_kb for b in every.values())
    assert (every["nano33ble"].flash_kb, every["nano33ble"].fpu, every["pico"].fpu) == (1048.576, True, False)


@pytest.mark.parametrize(
    ("text", "fact"),
    [
        ("[costs]\nscratch = { calm = true }", "give a number from 0"),
        ("by = ['flash']", "by: give one value"),
        ("[costs]\nsilence = 1e308", "silence = 1e[+]308: give a number from 0 to 1000000"),
        ("[costs]\nsilence = nan", "from 0 to 1000000"),
        ("[people]\nworst_person = " + "9" * 5000, "is not TOML: Exceeds the limit"),
        ("[people]\nworst_person = 0x" + "F" * 9000, "is not TOML: Exceeds the limit"),
        ("by." + "a." * 3000 + "a = 1", "nested more deeply"),
    ],
)
def test_odd_values_are_refused_in_one_line(text, fact, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=fact) as error:
        read_scene(str(path))
    assert str(error.value).count("\n") == 0 and str(error.value).startswith(f"scene={path}")


def test_a_file_that_is_not_there_names_the_shipped_scenes(tmp_path):
    with pytest.raises(InputError, match="companion, handle, toy"):
        read_scene(str(tmp_path / "none.toml"))
    with pytest.raises(InputError, match="/dev/zero: not a plain file"):
        read_scene("/dev/zero")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        read_scene(str(tmp_path / "binary.toml"))
