"""The command ``bench build``, without anything heavy."""

from bench.grammar.options import DATA, JOBS, SKIN, START, TRUST_NOTE, WHERE, Command, Option
from touchbench_chip.command import PREFIX_OPTION

FORMATS = ("table", "cuddlebot", "haart", "cost", "recording")
BUILD = Command(
    START,
    "build C with a certificate from recordings of a skin",
    "Imports FILE, or uses data=. Compares a few systems that have C on people left out, cheap "
    "ones first: on touches in streams, as of bench watch. Chooses the cheapest within one "
    "standard error of the best, within the budgets of scene and board. Trains it on all captures "
    "and writes C, examples, tests and a certificate. The certificate names what a new person may "
    "expect of touch_watch. An interrupted command continues where it stopped. check FOLDER runs "
    "streams and captures of other people through the C; exit code 1 if they contradict the "
    "certificate. "
    f"{TRUST_NOTE}",
    "bench build mine.csv grid=6x6 rate_hz=50 scene=companion board=stm32f411 out=robot\n"
    "bench build data=haart max_flash=64kB seconds=600 out=robot\n"
    "bench build check robot data=newpeople",
    "\n[FILE] out=FOLDER [key=value ...]\ncheck FOLDER data=NAME [where=CONDITION]",
    module="touchbench_builder.build",
    options=(
        DATA,
        WHERE,
        SKIN,
        JOBS,
        Option("format", "text", "table", "format of FILE, as of bench data import", FORMATS),
        Option("name", "text", "", "name of the corpus that FILE becomes; default its own name"),
        Option("grid", "text", "", "FILE: rows and columns of the skin, such as 8x8"),
        Option("rate_hz", "number", None, "FILE: frame rate in Hz"),
        Option("full_scale", "number", None, "FILE: largest possible reading"),
        Option(
            "faults",
            "text",
            "auto",
            "faults to train against, such as noise+gain_drift, or none; auto: noise scaled to the "
            "sensor's own, if people lose less than a point by it without faults",
        ),
        Option("scene", "text", "", "TOML file with a robot's needs, or companion, toy or handle"),
        Option("board", "text", "", "board whose flash and RAM are budgets, such as nano33ble"),
        Option("max_flash", "amount", None, "largest flash with code, such as 64kB"),
        Option("max_ram", "amount", None, "largest RAM of state, stack and a frame, such as 32kB"),
        Option(
            "max_cycles", "amount", None, "most instructions for the costliest frame, such as 600k"
        ),
        Option(
            "seconds",
            "number",
            600,
            "time for all; as many systems are compared as it allows, one at least",
        ),
        Option(
            "watch",
            "yes",
            True,
            "no: judge captures that your program cuts; the C finds no touches in a stream",
        ),
        PREFIX_OPTION,
        Option("out", "text", "", "folder for the C; new or empty"),
        Option("replace", "yes", False, "yes: replace an earlier build at out="),
    ),
)
