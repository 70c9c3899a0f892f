"""The command ``bench record``."""

from __future__ import annotations

import re
from pathlib import Path

from bench.errors import InputError
from bench.grammar.options import Command, Option, key_options, parse_words, typed_settings
from touchbench_streams.sensor import SENSOR_OPTIONS

RECORD = Command(
    "ship",
    "record people on a skin of your own, from a serial port, the network or standard input",
    "Prompts a person for each gesture, and writes FILE as it goes: a table of captures for bench "
    "data import table and bench build. A second file, with -stream in its name, has all frames "
    "with their labels for bench data import recording. First it checks the sensor: rate, full "
    "scale, level at rest, dead and saturated taxels, a transposed grid. The same command "
    "continues where it stopped; the next person is another subject= with the same FILE. Keys: "
    "space pauses, r repeats the last prompt, q stops.",
    "bench record day1.csv port=/dev/ttyACM0 grid=8x8 gestures=stroke,tap,pat subject=anna\n"
    "sensor | bench record day1.csv grid=8x8 gestures=stroke,tap subject=ben",
    "FILE grid=8x8 gestures=... subject=... [key=value ...]",
    takes_words=True,
    module="touchbench_recorder.commands",
    options=(
        *SENSOR_OPTIONS,
        Option("grid", "text", "", "rows and columns of the skin, such as 8x8"),
        Option("full_scale", "number", 1023, "largest possible reading"),
        Option("rate_hz", "number", None, "frame rate; default: as measured"),
        Option("gestures", "text", "", "what to prompt for; notouch is a prompt to keep off"),
        Option("subject", "text", "", "the person"),
        Option("repetitions", "counts", 5, "prompts for each gesture"),
        Option("seconds", "number", 8, "length of a prompt"),
        Option("rest", "number", 3, "seconds before each prompt"),
        Option("background", "count", 60, "seconds of motion without touch at the end; 0: none"),
        Option("columns", "text", "", "conditions for each line, such as session=1,cover=fur"),
        Option("check", "yes", True, "no: skip the checks of the sensor"),
    ),
)
NAMED = re.compile(r'(?!\?$)[^,\s="][^,="\x00-\x1f]*')  # of a gesture, person or condition
OWN_COLUMN = re.compile("subject|gesture|frame|label|recording|repetition|ch[0-9]+")


def record(arguments: list[str]) -> int:
    """Run ``bench record``: prompt one person, and write the captures."""
    from touchbench_recorder.evening import Evening, record_evening

    words, values = parse_words(arguments, key_options("record"), 1)
    if not words:
        raise InputError("give the file to write: bench record day1.csv grid=8x8 ...")
    settings = typed_settings("record", values)
    for key in ("grid", "gestures", "subject"):
        if not settings[key]:
            raise InputError(f"bench record needs {key}=, such as {EXAMPLES[key]}")
    gestures = _split_names("gestures", settings["gestures"])
    (subject,) = _split_names("subject", settings["subject"])[:1]
    for key in ("seconds", "rest", "background"):
        if not 0 <= settings[key] <= 3600:
            raise InputError(f"{key}={settings[key]:g}: give a number of seconds up to 3600")
    path = Path(words[0])
    if path.suffix != ".csv":
        raise InputError(f"{path}: give a name that ends with .csv")
    evening = Evening(
        path=path,
        subject=subject,
        gestures=tuple(gestures),
        conditions=_parse_columns(settings["columns"]),
        **{key: settings[key] for key in SAME_NAMES},
    )
    return record_evening(evening, {key: settings[key] for key in ("port", "baud", "tcp")})


EXAMPLES = {"grid": "grid=8x8", "gestures": "gestures=stroke,tap,pat", "subject": "subject=anna"}
SAME_NAMES = (
    "format",
    "grid",
    "full_scale",
    "rate_hz",
    "repetitions",
    "seconds",
    "rest",
    "background",
    "check",
)


def _split_names(key: str, text: str) -> list[str]:
    """Names that are separated by commas, each once."""
    names = [name.strip() for name in text.split(",")]
    wrong = [name for name in names if not NAMED.fullmatch(name)]
    if wrong or len(set(names)) < len(names):
        raise InputError(f"{key}={text[:60]}: give different names, separated by commas")
    if key == "subject" and len(names) > 1:
        raise InputError(f"subject={text[:60]}: give one person; the next one is another command")
    return names


def _parse_columns(text: str) -> dict[str, str]:
    """Conditions by name."""
    pairs = [pair.partition("=") for pair in text.split(",")] if text else []
    columns = {name.strip(): value.strip() for name, _, value in pairs}
    taken = {name for name in columns if OWN_COLUMN.fullmatch(name)}
    is_wrong = any(not NAMED.fullmatch(word) for pair in columns.items() for word in pair)
    if taken or is_wrong or len(columns) < len(pairs):
        advice = "give names and values, such as session=1,cover=fur"
        shown = f"{min(taken)} is a column of the file" if taken else advice
        raise InputError(f"columns={text[:60]}: {shown}")
    return columns
