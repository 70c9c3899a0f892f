"""The command line as data: every command and every key, with its type, default and help.

Parsing, ``--help``, completion and the checks of the Python API read these two tables. Nothing heavy is imported, so
that help and completion come at once.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

from bench.costs import COSTS
from bench.registry import names

WIDTH = 100  # columns of help
SMALL = "model=lda features=touch model.window=1.0 model.repair=stuck+dead"  # a small system, accurate on real touch
FAULTS = "dead_taxels stuck_taxels dead_lines gain_drift offset_drift saturation noise fewer_bits dropped_frames "
FAULTS += "lower_rate time_jitter late_start early_end shift rotation smaller_grid cover"


@dataclass(frozen=True)
class Option:
    """A key of some commands.

    Attributes:
        key: key before the ``=``; one with a dot is a parameter that many models take.
        commands: commands that take it; ``data-show`` is ``bench data show``.
        type: ``text``, ``number`` (above 0), ``count`` (a whole number), ``yes`` (or no) or ``amount`` (with a unit).
        default: value if it is not given.
        help: text of the help; ``{models}`` stands for the names of a room.
        values: allowed values, if they can be listed.
        joint: separator of several values.
    """

    key: str
    commands: str
    type: str
    default: object
    help: str
    values: tuple[str, ...] = ()
    joint: str = ","


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        group: heading in the overview.
        summary: line in the overview.
        text: a paragraph.
        examples: lines that can be typed.
        usage: arguments behind its name; a line for each form.
        module: module of ``bench.commands`` that has a function of its name; empty if module and function share the
            name.
    """

    group: str
    summary: str
    text: str
    examples: str = ""
    usage: str = "[key=value ...]"
    module: str = ""


FOLDS = "run tune stress stream chip choose check"
CHOICE = "choose report"
OPTIONS = (
    Option("data", f"{FOLDS} fit extract", "text", "synth", "synth (generated) or an imported corpus, see bench data"),
    Option("where", f"{FOLDS} fit extract", "text", "", "captures to use, such as where=\"variant == 'rough'\""),
    Option("target", f"{FOLDS} fit", "text", "gesture", "columns that make the class, such as gesture+variant"),
    Option("protocol", FOLDS, "text", "loso", "{protocols}"),
    Option("model", f"{FOLDS} fit audit submit", "text", "svm", "{models}; a name with a year is a published system"),
    Option("features", f"{FOLDS} fit audit submit extract", "text", "jung54", "{features}; for models that take some"),
    Option("model.window", "run", "number", None, "seconds: a model of whole captures classifies windows instead"),
    Option("model.repair", "run", "text", "", "fills broken taxels", ("stuck", "dead", "offset"), "+"),
    Option("model.scale", "run", "text", "", "divides by the largest reading so far, or takes logs", ("peak", "log")),
    Option("model.faults", "run", "text", "", "trains on damaged copies, too: all, or faults of bench stress", (), "+"),
    Option("model.turns", "run", "count", 0, "copies of each training capture, mirrored or turned"),
    Option("model.person", "run", "text", "", "adapts to a person without labels", ("centre", "scale", "pool"), "+"),
    Option("model.device", "run", "text", "cpu", "where networks are trained", ("cpu", "cuda")),
    Option("seed", f"{FOLDS} fit audit submit", "count", 0, "of models, features; protocol.seed= draws other splits"),
    Option("jobs", FOLDS, "count", None, "worker processes; default one per core"),
    Option("cluster", FOLDS, "text", "", "dask scheduler whose workers do the folds: tcp://HOST:8786 or its file"),
    Option("trials", "tune", "count", 50, "combinations to try in each fold; a grid of lists is tried in full"),
    Option("budget", "tune", "number", None, "seconds after which a fold begins no new combination"),
    Option("inner", "tune choose", "text", "3", "groups of training subjects that judge, or loso"),
    Option("by", "choose", "text", "flash", "the cost to keep low", tuple(COSTS)),
    Option("max_flash", CHOICE, "amount", None, "budget of flash, such as 256kB or 256KiB"),
    Option("max_ram", CHOICE, "amount", None, "budget of RAM, such as 32kB"),
    Option("max_predict", CHOICE, "amount", None, "budget of computing time of a label on this machine, such as 2ms"),
    Option("max_decision", CHOICE, "amount", None, "budget of touch until the decision, such as 1s"),
    Option("max_cycles", CHOICE, "amount", None, "budget of instructions of the costliest frame, such as 600k"),
    Option("clock", "choose", "text", "", "of the chip, such as 64MHz; max_decision= then includes measured cycles"),
    Option("margin", "choose", "number", None, "points that do not matter: a t-test instead of one standard error"),
    Option("unit", "choose", "text", "capture", "what accuracy counts", ("capture", "window")),
    Option("batch", "choose submit", "yes", False, "yes: also systems whose labels depend on other test captures"),
    Option("shots", "choose", "count", None, "labelled captures of a new person, with protocol=personal or transfer"),
    Option("over", "choose", "text", "", "run model= with the smallest value of this parameter, or of features"),
    Option("faults", "stress", "text", "all", "faults to test under, or none", (*FAULTS.split(), "none")),
    Option("train_subjects", "stress", "count", None, "learning curve: also fit on these numbers of training subjects"),
    Option("out", "stress", "text", "stress", "folder of tables and figures"),
    Option("hop_ms", "stream", "number", None, "ms between decisions; default: when 1.41 times as much was seen"),
    Option("start", "stream", "text", "onset", "middle skips the first half of each capture", ("onset", "middle")),
    Option("source", "stream", "text", "", "- decides on frames from standard input"),
    Option("out", "stream", "text", "report", "folder of streaming.csv, stopping.csv and figures"),
    Option("bits", "chip export", "text", "32", "of a stored weight; with 8, support vectors have 16", ("32", "8")),
    Option("stopping", "fit", "yes", True, "no: skip three more fits, which calibrate and learn when to decide early"),
    Option("out", "fit", "text", "", "also save it as this folder, which must be new or empty"),
    Option("out", "predict", "text", "", "write a CSV file that is safe for spreadsheets, instead of printing"),
    Option("out", "adapt", "text", "", "folder of the adapted system, new or empty"),
    Option("rate_hz", "adapt predict", "number", None, "frames a second of FILE; must match the model's"),
    Option("out", "export", "text", "", "folder of the C files, new or empty"),
    Option("baseline", "check", "text", "reports/baseline.json", "the file to compare with"),
    Option("update", "check", "yes", False, "true: write the baseline anew; keys of bench run add systems to it"),
    Option("run", "check", "yes", True, "false: run nothing, compare the newest tracked runs"),
    Option("error", "check", "number", 1, "percent, error rate of accuracy and labels for all systems together"),
    Option("slower", "check", "number", 2, "times the baseline's computing time, relative to a reference workload"),
    Option("junit", "check", "text", "", "file for a CI server, such as check.xml"),
    Option("out", "extract", "text", "", "file that ends in .parquet or .csv"),
    Option("name", "data-import", "text", "", "import under this name, in place of an earlier corpus of this name"),
    Option("grid", "data-import", "text", "", "of a table or recording: rows and columns of the skin, such as 8x8"),
    Option("rate_hz", "data-import", "number", None, "of a table or recording: frames a second"),
    Option("full_scale", "data-import", "number", 1023, "of a table or recording: the largest reading"),
    Option("where", "data-show", "text", "", "captures to show"),
    Option("target", "data-show", "text", "gesture", "columns whose classes are counted besides"),
    Option("capture", "data-show", "count", None, "the capture to animate, from 0; default one of each gesture"),
    Option("out", "data-show", "text", "look", "folder of figures, an animation and index.html with all of it"),
    Option("format", "data-export", "text", "cost", "that of CoST.csv", ("cost",)),
    Option("out", "report", "text", "report", "folder of the page"),
    Option("task", "submit", "text", "", "haart-loso-v1, haart-early-v1 or another task of docs/leaderboard.md"),
    Option("who", "submit", "text", "", 'whose result it is, such as who="A. Name, Lab"'),
    Option("run", "submit", "text", "", "instead of model=: a run by its id, such as one of bench tune"),
    Option("out", "submit", "text", "", "folder, new or empty"),
    Option("rerun", "leaderboard", "text", "", "repeat the command of this submission instead, and verify its labels"),
    Option("out", "leaderboard", "text", "leaderboard.html", "the page"),
    Option("out", "demo", "text", "demo", "folder of everything, with a store of its own"),
    Option("port", "ui", "text", "5000", "of the server"),
)
COMMANDS = {
    "demo": Command(
        "start here",
        "see the way to a verdict in two minutes, on generated captures",
        "Runs five systems on generated captures, replays the two most accurate, stresses the best one with two "
        "faults, writes the page and chooses. Synthetic: it says nothing about people. Prints each command before it "
        "runs it. An interrupted demo goes on where it stopped.",
    ),
    "run": Command(
        "start here",
        "run recognisers under a protocol and track them",
        "Runs every combination of the given values; a comma lists several. A dotted key sets a parameter of that "
        "part. Each combination is one run in MLflow with a child run per fold. An interrupted command goes on where "
        "it stopped.",
        "bench run protocol=loso model=cnn85\n"
        f"bench run data=haart {SMALL}\n"
        "bench run data=haart protocol=challenge,loso model=bayes,svm,rf,xgb features=jung28,jung54\n"
        "bench run data=cost model=svm model.C=8,32,128 model.gamma=0.125\n"
        "bench run data=synth data.subjects=12 data.repetitions=2",
    ),
    "choose": Command(
        "start here",
        "find the cheapest system that is as good as the best",
        "Finds, among tracked runs on the same captures, the cheapest system that loses at most one standard error of "
        "the paired difference over subjects to the most accurate one. If nothing fits the budgets, it prints which "
        "budget binds and the least that any system needs; exit code 1. Runs with failed folds or of an older corpus "
        "are left out and counted. kB is 1000, KiB 1024 bytes; sizes are without code, except for runs of bench chip, "
        "which also count cycles. over= runs systems instead: each fold chooses the value on left-out training "
        "subjects, from model.X= or an eighth, a quarter, a half and all of the default.",
        "bench choose data=haart protocol=loso max_flash=256kB max_ram=32kB\n"
        "bench choose data=haart protocol=loso model=cnn85 over=frames",
    ),
    "report": Command(
        "start here",
        "the verdict, all runs and published numbers on one page",
        "Writes index.html, which loads nothing: the verdict of bench choose within the budgets, charts of accuracy "
        "against each cost, all runs, published numbers beside ours, figures, paired statistics, and the command "
        "behind every row. Beside it are comparison.md, comparison.tex (booktabs), CSV tables, and figures as PNG and "
        "SVG.",
        "bench report max_flash=64kB max_decision=500ms",
    ),
    "data": Command(
        "your captures",
        "list, import, look at, verify and export corpora",
        "Alone, it lists the corpora with counts, digest, source and licence. import reads the Corpus of Social Touch, "
        "HAART (zip or folder) or a table: a CSV or parquet file with the columns subject, gesture, frame, conditions "
        "and channels, or .npz with frames, offsets, subject and gesture. A column synthetic marks generated captures. "
        "recording reads continuous touch: a CSV or parquet file with a row per frame, a column label (empty or None "
        "where nobody touches), channels, and optional columns recording and subject. "
        "show prints counts, gaps, durations, pressure, broken taxels and equal captures. verify reads every stored "
        "file again; exit code 1 if one was changed. show and export take parameters of synth, such as subjects=4.",
        "bench data import cost CoST.csv\n"
        'bench data import haart "HAART DataSet.zip"\n'
        "bench data import table my.csv name=arm grid=10x10 rate_hz=54 full_scale=1023\n"
        "bench data import recording day.csv name=day grid=10x10 rate_hz=54\n"
        "bench data export synth out.csv subjects=31 repetitions=6",
        "\nimport cost|haart|table|recording FILE [key=value ...]\nshow NAME [key=value ...]\nverify NAME\n"
        "export NAME FILE",
    ),
    "extract": Command(
        "your captures",
        "write a table of features",
        "Writes the features of every capture, with its subject, gesture and conditions.",
        "bench extract data=synth features=jung54 out=features.parquet",
        "data=NAME features=NAME out=FILE [where=CONDITION]",
    ),
    "systems": Command(
        "compare",
        "list published numbers and the commands that repeat them",
        "Lists every published number with the command that repeats it here, or why there is none.",
        usage="",
    ),
    "audit": Command(
        "compare",
        "verify that a system of your own keeps the rules",
        "Verifies on generated captures that a system predicts without labels and one capture at a time, repeats with "
        "equal seeds, learns nothing from test captures or from an earlier fit, takes another grid and rate, and can "
        "be copied, saved and loaded. Stores nothing. Exit code 1 if a check failed. It finds mistakes, not fraud.",
        "bench audit model=my.py:Mine\nbench audit model=lda,svm features=touch",
    ),
    "tune": Command(
        "compare",
        "search the parameters of recognisers inside each training part",
        "Like bench run, but searches each model's parameters on inner folds of whole subjects inside every training "
        "part. model.C=8,32,128 lists values; without lists, it searches the ranges that the model declares. Prints "
        "and stores the choice of each fold and every combination. An interrupted search goes on where it stopped.",
        "bench tune data=haart protocol=loso model=svm features=jung54 trials=50\n"
        "bench tune data=haart protocol=challenge model=rf,xgb features=ta273",
    ),
    "stress": Command(
        "compare",
        "find where recognisers fail: faults of the sensor, subjects, conditions",
        "Fits every fold once, tests it on captures as they are and under every fault at five severities, and reports "
        "subjects, classes, conditions and faults where a system falls significantly below its own accuracy. Several "
        "seeds also show how many captures change label. An interrupted command goes on where it stopped.",
        "bench stress data=haart protocol=loso model=svm,rf features=jung54\n"
        "bench stress data=haart protocol=loso model=rf seed=0,1,2 faults=noise,shift train_subjects=2,4,8",
    ),
    "stream": Command(
        "compare",
        "replay captures as a robot sees them, or decide on frames from standard input",
        "Replays captures: accuracy against milliseconds of touch, time per decision, and adaptive stopping, which "
        "decides as soon as waiting is expected to gain too little, as learned on training subjects. source=- reads a "
        "line per frame: its values in row-major order, with commas or blanks between them, at most 32 characters "
        "each; an empty line ends a capture. It prints a line per decision: capture, ms, label, confidence and "
        "settled, which is yes from where waiting gains too little. MODEL is a model that bench fit saved.",
        "bench stream data=haart protocol=loso model=svm,rf features=jung54\n"
        "bench stream data=haart model=svm start=onset,middle hop_ms=125\n"
        "sensor | bench stream source=- model=models:/m-0123456789abcdef",
        "[key=value ...]\nsource=- model=MODEL [hop_ms=125]",
    ),
    "chip": Command(
        "compare",
        "measure what systems answer and take as C on a microcontroller",
        "Every fold fits, exports as bench export does, labels the test captures in C and in Python, links the C for a "
        "Cortex-M4F with 256 KiB of flash and 32 KiB of RAM, and counts instructions in QEMU: the mean of a frame, and "
        "the costliest frame with its label. library RAM is the state of touch.c; program RAM is the whole program "
        "with 4096 bytes for heap and stack. Needs cc, make, arm-none-eabi-gcc and qemu-system-arm (Debian: gcc make "
        "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm).",
        "bench chip data=haart protocol=loso model=reflex bits=32,8\n"
        "bench choose data=haart protocol=loso max_flash=64kB max_ram=32kB max_cycles=1M",
    ),
    "ui": Command(
        "compare",
        "open MLflow's page on the runs",
        "Serves MLflow's own page on the store of this folder, or on MLFLOW_TRACKING_URI, on this machine only, and "
        "prints the address of the table of runs. Ctrl-C ends it.",
        module="report",
    ),
    "fit": Command(
        "ship",
        "train one system on all captures and save it as an MLflow model",
        "Prints the address of the model in the store. mlflow.pyfunc.load_model, mlflow models serve, bench predict, "
        "bench export and bench stream source=- take it. Each key has one value.",
        "bench fit data=haart model=svm features=jung54 out=svm\nmlflow models serve -m svm --env-manager local",
    ),
    "predict": Command(
        "ship",
        "label the captures of a file with a saved model",
        "FILE is CSV, parquet or .npz in the format of bench data import table; subject and gesture may be missing, "
        "channels may not. Prints capture, label, confidence and the probability of each class. MODEL is models:/..., "
        "runs:/.../model of the store of this folder, or a folder. A model is code: loading one runs it, so name only "
        "models saved by you or someone you trust.",
        "bench predict models:/m-0123456789abcdef new.csv out=labels.csv",
        "MODEL FILE [key=value ...]",
        "fit",
    ),
    "adapt": Command(
        "ship",
        "adapt a saved model to one person",
        "FILE holds some captures of one person, in the format of bench data import table. With a column gesture the "
        "system learns from them; without one, only how this person differs from those of training. MODEL stays as it "
        "is. reflex, lda, networks (their last layer) and models with model.person= can adapt; bench run "
        "protocol=personal measures the gain.",
        "bench fit data=haart model=reflex out=rec\nbench adapt rec anna.csv out=rec_anna",
        "MODEL FILE out=FOLDER [key=value ...]",
        "fit",
    ),
    "export": Command(
        "ship",
        "write a saved model as C99 for a microcontroller",
        "Writes touch.h, touch.c and tables.h, which need no heap and no library but math.h, with a Makefile: make and "
        "make check build for this machine, make chip for a Cortex-M4F (FLASH=256K RAM=32K); make flash and make count "
        "print bytes, instructions and stack. reflex has C; so have lda, softmax, bayes, svm, tree, rf, et and xgb on "
        "touch with model.window=, or on jung28; and of networks hughes2017_cnn. A model is code: loading one runs it, "
        "so name only models saved by you or someone you trust.",
        "bench fit data=haart model=reflex out=rec\nbench export rec out=rec_c bits=8\nmake -C rec_c check",
        "MODEL out=FOLDER [key=value ...]",
    ),
    "submit": Command(
        "publish",
        "write a stored run as an answer to a frozen task",
        "Writes predictions.parquet (a row per capture, no frames) and submission.json (where they come from). Runs "
        "nothing: it takes the stored run with these values, and refuses one whose data, subset, protocol or unit are "
        "not those of the task. Tasks: haart-loso-v1, haart-challenge-v1, haart-personal-v1 and cost-loso-v1 of bench "
        "run, haart-early-v1 of bench stream, haart-faults-v1 of bench stress.",
        "bench run data=haart protocol=loso model=svm features=jung54\n"
        'bench submit task=haart-loso-v1 model=svm features=jung54 who="A. Name, Lab" out=submissions/my-svm',
        "task=NAME who=NAME out=FOLDER model=NAME [key=value ...]",
        "leaderboard",
    ),
    "leaderboard": Command(
        "publish",
        "rescore submissions into one page",
        "Computes every score anew from submitted predictions and writes one page that loads nothing: a table for each "
        "frozen task, with the results that come with touchbench. FOLDER is a submission or holds some; an invalid one "
        "is left out with a line, exit code 1. CoST must be imported for its tasks. rerun= needs the corpus of the "
        "task here; if all labels are equal, leaderboard-verified.json in the working folder marks the submission.",
        "bench leaderboard submissions out=leaderboard.html\nbench leaderboard rerun=my-svm",
        "[FOLDER ...] [key=value ...]",
    ),
    "check": Command(
        "more",
        "compare with a stored baseline, a gate for CI",
        "Prints a line for each system of the baseline: same, worse, better, changed (labels), slower, larger, or not "
        "run. Runs what the current code has not run yet. Exit code 1 if one is not the same: better counts too, as a "
        "leak makes a system better. A paired bootstrap over subjects judges accuracy; 0.2 % of the labels may change, "
        "and sizes may grow by 10 %.",
        "bench check update=true data=haart model=svm,rf features=jung54\nbench check junit=check.xml slower=3",
    ),
    "completion": Command(
        "more",
        "let the shell complete commands and names",
        "Prints a script that lets the shell complete commands, keys and names at TAB.",
        'eval "$(bench completion bash)"                                # in ~/.bashrc\n'
        'eval "$(bench completion zsh)"                                 # in ~/.zshrc\n'
        "bench completion fish > ~/.config/fish/completions/bench.fish",
        "bash|zsh|fish",
    ),
}


def options(command: str) -> dict[str, Option]:
    """The keys of a command by name; those of all its actions for one that has some."""
    rows = [o for o in OPTIONS if any(c == command or c.startswith(f"{command}-") for c in o.commands.split())]
    return {option.key: option for option in rows}


def keys(command: str) -> set[str]:
    """Keys that a command takes, without parameters of parts, which have a dot."""
    return {key for key in options(command) if "." not in key}


def overview() -> str:
    """All commands, those to begin with first."""
    lines = ["bench: which recogniser of touch gestures should I ship?"]
    for group in dict.fromkeys(command.group for command in COMMANDS.values()):
        members = [(name, command) for name, command in COMMANDS.items() if command.group == group]
        lines += ["", f"{group}:", *(f"  bench {name:12}{command.summary}" for name, command in members)]
    return "\n".join([*lines, "", "bench COMMAND --help prints the options of each."])


def help_of(name: str) -> str:
    """The help of a command: usage, a paragraph, its own keys, those that it shares with ``bench run``, examples."""
    command, table = COMMANDS[name], options(name)
    shared = [key for key, option in table.items() if name != "run" and "run" in option.commands.split()]
    rows = [_row(option) for key, option in table.items() if key not in shared]
    if shared:
        rows.append(f"  {' '.join(f'{key}=' for key in shared)}   as for bench run")
    usage = "\n".join(f"bench {name} {form}".rstrip() for form in command.usage.split("\n"))
    paragraph, examples = (
        textwrap.fill(command.text, WIDTH, break_on_hyphens=False),
        textwrap.indent(command.examples, "  "),
    )
    return "\n\n".join(filter(None, [usage, paragraph, "\n".join(rows), examples])) + "\n"


def _row(option: Option) -> str:
    """A key with its help, values and default."""
    text = option.help
    for room in ("protocols", "models", "features"):
        if f"{{{room}}}" in text:
            text = text.replace(f"{{{room}}}", ", ".join(names(room)))
    if len(option.values) > 1:
        text += f": {(', ' if option.joint == ',' else option.joint).join(option.values)}"
    if option.type != "yes" and option.default not in (None, "", 0):
        text += f"; default {option.default}"
    return textwrap.fill(
        text, WIDTH, break_on_hyphens=False, initial_indent=f"  {option.key + '=':16}", subsequent_indent=" " * 18
    )
