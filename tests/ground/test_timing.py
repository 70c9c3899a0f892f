"""Times as on a quiet machine, with clocks that the tests turn."""

import json

import pytest

from bench.ground import timing
from bench.ground.digests import json_with_digest, read_json_with_digest
from bench.ground.scratch import data_folder


class Clocks:
    """Processor and wall clock of a machine that other programs slow down.

    Work takes ``cost`` of processor time when the machine is quiet.
    """

    def __init__(self, monkeypatch):
        self.cpu = self.wall = 0.0
        self.shared, self.waiting = 1.0, 1.0  # factors of processor time, and of wall time on top
        monkeypatch.setattr(timing.time, "process_time", lambda: self.cpu)
        monkeypatch.setattr(timing.time, "perf_counter", lambda: self.wall)
        monkeypatch.setattr(timing, "run_reference_workload", lambda: self.work(0.002))

    def work(self, cost):
        self.cpu += cost * self.shared
        self.wall += cost * self.shared * self.waiting


@pytest.fixture
def clocks(monkeypatch, tmp_path):
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path))
    monkeypatch.setattr(timing, "REPEATS", 2)
    return Clocks(monkeypatch)


def test_a_busy_machine_changes_no_time_but_the_wall_clock(clocks):
    works = [lambda: clocks.work(0.010), lambda: clocks.work(0.030)]
    quiet = timing.time_repeatedly(works)
    clocks.shared, clocks.waiting = 1.25, 3.0
    busy = timing.time_repeatedly(works)
    result, once, cpu_ms = timing.time_once(lambda: clocks.work(0.5) or "result")
    for times in (quiet, busy):
        assert times.ms == pytest.approx([10, 30]) and times.quiet_ms == pytest.approx(2)
    assert quiet.wall_ms == pytest.approx([10, 30]) and busy.wall_ms == pytest.approx([37.5, 112.5])
    assert (quiet.slowdown, busy.slowdown) == (pytest.approx(1), pytest.approx(3.75))
    assert (result, cpu_ms) == ("result", pytest.approx(625)) and once.ms == pytest.approx([500])


def test_an_interruption_of_one_repetition_does_not_count(clocks):
    costs = iter([0.010, 0.200, 0.150, 0.010])
    times = timing.time_repeatedly([lambda: clocks.work(next(costs))] * 2)
    assert times.ms == pytest.approx([10, 10])


def test_seconds_that_a_system_reports_replace_the_measured_ones(clocks):
    _, times, cpu_ms = timing.time_once(lambda: clocks.work(9.0), lambda w, c: (w / 3, c / 9))
    assert (times.wall_ms[0], times.ms[0], cpu_ms) == pytest.approx((3000, 1000, 1000))


def test_the_quiet_machine_is_the_fastest_that_was_seen(clocks):
    for clocks.shared, ms in ((2.0, 20), (1.0, 10), (2.0, 10)):  # at first the slow one is fastest
        assert timing.time_repeatedly([lambda: clocks.work(0.01)]).ms == pytest.approx([ms])
    (stored,) = read_json_with_digest(data_folder() / timing.REFERENCE_FILE).values()
    assert stored == pytest.approx(2)


@pytest.mark.parametrize("ms", ["cut off", 1.0, -5, 0, None, float("nan"), "many", [1]])
def test_a_damaged_time_of_the_quiet_machine_is_measured_anew_with_a_warning(clocks, capsys, ms):
    """Also one with a digest that no clock has measured."""
    work, file = [lambda: clocks.work(0.01)], data_folder() / timing.REFERENCE_FILE
    assert timing.time_repeatedly(work).quiet_ms == pytest.approx(2)
    values = json.dumps(dict.fromkeys(read_json_with_digest(file), ms))
    texts = [values, values[:-1]]
    if ms != 1.0:
        texts.append(json_with_digest(values))
    for text in texts:
        file.write_text(text)
        capsys.readouterr()
        assert timing.time_repeatedly(work).quiet_ms == pytest.approx(2)
        assert "is damaged; the reference workload" in capsys.readouterr().err.replace("\n", " ")
        assert timing.time_repeatedly(work) and not capsys.readouterr().err


def test_a_clock_that_stands_still_is_an_error(clocks):
    clocks.shared = 0.0
    with pytest.raises(OSError, match="too coarse"):
        timing.time_repeatedly([lambda: clocks.work(0.01)])


def test_the_workload_does_the_same_each_time():
    assert timing.run_reference_workload() == timing.run_reference_workload() > 0
