"""What endless streams add: a command, and keys of ``bench fit``."""

from bench.endless import DETECTOR
from bench.options import TRUSTED, Command, Option
from bench.usual import FALSE_ALARMS

WATCH = Option(
    "watch",
    "fit",
    "yes",
    True,
    "no: skip the post-processing for endless streams",
    uses="bench.endless.teaching:Watching",
)
FINDS = Option(
    "detector",
    "fit",
    "text",
    DETECTOR,
    "finds the touches of a stream: {bench.endless.detectors}, or my.py:Mine; detector.NAME= sets a parameter",
)
ALARMS = Option(
    "false_alarms", "fit", "number", FALSE_ALARMS, "false alarms per hour of background accepted in training"
)
IDLE = Option("background", "fit", "text", "", "background of the stream, as of bench watch")
LIVE = Command(
    "ship",
    "classify frames from standard input with a saved model",
    "Reads one frame per line: values in row-major order, separated by commas or blanks, at most 32 characters "
    "each. If the model can watch an endless stream, each news of a touch (reported, changed, ended) prints ms, "
    "news, label and confidence. Otherwise, or with events=no, an empty line ends a capture, and each decision "
    "prints capture, ms, label, confidence and settled. settled is yes once waiting would gain too little. "
    f"MODEL is as for bench predict. {TRUSTED}",
    "sensor | bench live models:/m-0123456789abcdef",
    "MODEL [events=no] [hop_ms=125]",
    module="bench.endless.command",
    options=(
        Option("hop_ms", "live", "number", 125, "classification of captures: milliseconds between decisions"),
        Option("events", "live", "yes", True, "no: classify captures instead of watching an endless stream"),
    ),
)
