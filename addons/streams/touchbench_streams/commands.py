"""Commands ``watch`` and ``live``, and keys of ``bench fit``, for endless streams."""

from __future__ import annotations

from bench.errors import InputError
from bench.grammar.options import (
    TRUST_NOTE,
    Command,
    Option,
    key_options,
    parse_words,
    typed_settings,
)
from bench.ground.typed import SMALL_SYSTEM
from touchbench_streams import DETECTOR, FALSE_ALARMS
from touchbench_streams.sensor import SENSOR_OPTIONS, Sensor

WATCH = Option(
    "watch",
    "yes",
    True,
    "no: skip the post-processing for endless streams",
    uses="touchbench_streams.teaching:Watching",
)
FINDS = Option(
    "detector",
    "text",
    DETECTOR,
    "finds the touches of a stream: {touchbench_streams.detectors}, or my.py:Mine; "
    "detector.NAME= sets a parameter",
)
ALARMS = Option(
    "false_alarms",
    "number",
    FALSE_ALARMS,
    "false alarms per hour of background accepted in training",
)
IDLE = Option("background", "text", "", "background of the stream, as for bench watch")
WATCHES = Command(
    "compare",
    "find touches in continuous recordings: false alarms, misses, latency",
    "Each fold trains on captures, and learns when to report a touch from recordings of training "
    "subjects. It then watches the recordings of the test subjects. data=synth and imported "
    "recordings are used as they are. From other corpora, one recording per subject is composed: "
    "excerpts of 2 to 6 s of each capture, with 3 to 10 s of background between them. Prints "
    "touches found, correct gestures when first reported and at the end, false alarms per hour of "
    "background, latency and reports per touch. Refused frames are counted if there are any. "
    "under= repeats this with faults of the test sensors.",
    f"bench watch data=haart protocol=loso {SMALL_SYSTEM}\n"
    "bench watch data=haart model=reflex false_alarms=2\n"
    "bench watch data=haart model=lda features=touch detector=frames,threshold "
    "under=noise,vibration,drift",
    makes="watch",
)
LIVE = Command(
    "ship",
    "classify frames of a sensor with a saved model",
    "Reads frames from a serial port, the network or standard input: one per line, values in "
    "row-major order, separated by commas or blanks, at most 32 characters each. If the model can "
    "watch an endless stream, it prints a line (ms, news, label, confidence) when a touch is "
    "reported, changed or ended. Otherwise, or with events=no, an empty line ends a capture, and "
    "each decision prints capture, ms, label, confidence and settled. settled is yes once waiting "
    "would gain too little. MODEL is as for bench predict. "
    f"{TRUST_NOTE}",
    "sensor | bench live models:/m-0123456789abcdef\nbench live robot port=/dev/ttyACM0 show=yes",
    "MODEL [events=no] [hop_ms=125]",
    module="touchbench_streams.commands",
    follows={"predict": "sensor | bench live {}"},
    options=(
        *SENSOR_OPTIONS,
        Option("show", "yes", False, "yes: also the label and a map of pressure on the screen"),
        Option(
            "hop_ms", "number", 125, "classification of captures: milliseconds between decisions"
        ),
        Option(
            "events", "yes", True, "no: classify captures instead of watching an endless stream"
        ),
    ),
)


def live(arguments: list[str]) -> int:
    """Run ``bench live``: classify frames from standard input until it ends."""
    words, values = parse_words(arguments, key_options("live"), 1)
    if not words:
        raise InputError("give the address or folder that bench fit printed: bench live MODEL")
    from touchbench_streams.live import run_stream

    settings = typed_settings("live", values)
    sensor = Sensor(*(settings[option.key] for option in SENSOR_OPTIONS))
    hop_ms = float(settings["hop_ms"])
    return run_stream(words[0], hop_ms, settings["events"], settings["show"], sensor)
