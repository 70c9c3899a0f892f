"""The example in C++ compiles for Arduino, reads a frame every period, and tells of lost ones."""

import shutil
import subprocess

import pytest

from addons.chip.tests.compiled import STRICT, describe_missing, fit_system, write_files
from addons.streams.tests.test_c import fit_watcher
from touchbench_builder import folder

SERIAL = """
#pragma once
struct Terminal { void begin(unsigned long); void println(const char *); };
extern Terminal Serial;
unsigned long micros();
"""
ROBOT = """
#include <cstdio>
#include "example.cpp"
static unsigned long now = 0xFFFF0000ul;
unsigned long micros() { return now; }
void Terminal::begin(unsigned long) {}
void Terminal::println(const char *text) { std::puts(text); }
Terminal Serial;
int main()
{
    setup();
    for (const unsigned long begin = now; now - begin < 3000000; now += 97)
        loop();
    unsigned long read = frames;
    now += 10 * PERIOD_US;
    loop();
#if TOUCH_WATCH
    frame[0] = -TOUCH_FULL_SCALE; // a frame that is refused is lost
    take_frame(0);
    touch_counts_t counts;
    touch_status(&watch, &counts);
    std::printf("%lu %lu %u", read, frames - read, (unsigned)counts.missed);
#else
    std::printf("%lu %lu", read, frames - read);
#endif
}
"""
SYSTEMS = {"watch": lambda: fit_watcher("threshold"), "captures": lambda: fit_system("bayes")}


@pytest.mark.skipif(bool(describe_missing("gcc", "g++")), reason=describe_missing("gcc", "g++"))
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_frame_is_read_every_period_and_lost_ones_are_told(name, tmp_path):
    recogniser = SYSTEMS[name]()
    write_files(recogniser, tmp_path)
    shutil.copy(folder.CODE / "example.cpp", tmp_path)
    (tmp_path / "Arduino.h").write_text(SERIAL)
    (tmp_path / "robot.cpp").write_text(ROBOT)
    strict = "-std=c++11 -Wall -Wextra -Wconversion -Werror -DARDUINO=10819 -I.".split()
    for call in (
        ["gcc", "-std=c99", "-c", "touch.c"],
        ["g++", *strict, "robot.cpp", "touch.o", "-lm", "-o", "robot"],
    ):
        subprocess.run(call, cwd=tmp_path, check=True, capture_output=True)
    done = subprocess.run([tmp_path / "robot"], capture_output=True, text=True, check=True)
    *words, numbers = done.stdout.splitlines()
    read, after, *missed = map(int, numbers.split())
    assert abs(read - 3 * recogniser.rate_hz) <= 1 and after == 1
    assert missed == ([10 + 1] if name == "watch" else [])
    assert set(words) <= {*recogniser.classes, "ended", "unknown", "out of range"}
    assert name == "watch" or words


@pytest.mark.skipif(bool(describe_missing("gcc")), reason=describe_missing("gcc"))
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_example_in_c_compiles_and_tells_what_to_do(name, tmp_path):
    write_files(SYSTEMS[name](), tmp_path)
    # a sensor whose frames are refused
    code = (folder.CODE / "example.c").read_text()
    code = code.replace("return n++", "frame[0] = -TOUCH_FULL_SCALE;\n    return n++")
    (tmp_path / "example.c").write_text(code)
    call = ["gcc", *STRICT, "-Wconversion", "example.c", "touch.c", "-lm", "-o", "example"]
    subprocess.run(call, cwd=tmp_path, check=True, capture_output=True)
    done = subprocess.run([tmp_path / "example"], capture_output=True, text=True, check=True)
    expected = "out of range: correct" if name == "watch" else "a frame was refused"
    assert done.stderr.startswith(expected)
