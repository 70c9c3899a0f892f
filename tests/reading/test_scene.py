"""Scene files: what their lines mean, and what is refused in one line."""

import pytest

from bench.errors import InputError
from bench.reading.scene import load_boards, read_scene

SCENE = """
[budget]
board = "pico2"
share = 0.25
ram = "20kB"
decision = "1s"
[faults]
names = ["noise"]
severity = 2
loss = 7
"""


def test_a_board_gives_budgets_and_a_line_of_its_own_goes_before(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(SCENE)
    scene = read_scene(str(path))  # a quarter of 4096 KiB, 20 kB instead of a quarter of 520 KiB
    budgets = {
        "max_flash": "1048.58kB",
        "max_ram": "20kB",
        "max_decision": "1s",
        "max_fault_loss": "7",
    }
    assert scene.values == budgets | {"clock": "150MHz"}
    assert (scene.faults, scene.severity) == (("noise",), 2)
    (line,) = scene.board.budget_sentences(scene.values)  # of flash alone: RAM has its own line
    assert (
        line.startswith("The budget of flash is 25 % of that of Raspberry Pi Pico 2")
        and "https://" in line
    )


def test_shipped_scenes_and_boards_can_be_read():
    for name in ("companion", "toy", "handle"):
        assert read_scene(name).reactions.groups
    every = load_boards()
    assert len(every) >= 10 and all(
        b.source.startswith("https://") and b.ram_kb < b.flash_kb for b in every.values()
    )
    assert (every["nano33ble"].flash_kb, every["nano33ble"].fpu, every["pico"].fpu) == (
        1048.576,
        True,
        False,
    )
    uno = every["uno-r3"].as_budgets(timed=False)  # 2 KiB and 0.2 KiB are of Arduino's core
    assert uno == {"max_flash": "30.72kB", "max_ram": "1.8432kB"}


WRONG = [
    (b"[costs]\nscratch = { calm = true }", "give a number from 0"),
    (b"by = ['flash']", "by: give one value"),
    (b"[costs]\nsilence = 1e308", "silence = 1e[+]308: give a number from 0 to 1000000"),
    (b"[costs]\nsilence = nan", "from 0 to 1000000"),
    (b"[people]\nworst_person = " + b"9" * 5000, "not TOML: Exceeds the limit"),
    (b"[people]\nworst_person = 0x" + b"F" * 9000, "not TOML: Exceeds the limit"),
    (b"by." + b"a." * 3000 + b"a = 1", "nested more deeply"),
    (b"\xff\xfe\x00", "not UTF-8"),
]


@pytest.mark.parametrize(("content", "fact"), WRONG)
def test_odd_files_are_refused_in_one_line(content, fact, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=fact) as error:
        read_scene(str(path))
    assert str(error.value).count("\n") == 0 and str(error.value).startswith(f"scene={path}")


def test_a_file_that_is_not_there_names_the_shipped_scenes_and_a_device_is_none(tmp_path):
    for path, fact in (
        (tmp_path / "none.toml", "companion, handle, toy"),
        ("/dev/zero", "not a plain file"),
    ):
        with pytest.raises(InputError, match=fact):
            read_scene(str(path))
