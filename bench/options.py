"""The command line as data: every command and every key, with its type, default and help.

Parsing, ``--help`` and the checks of the Python API read these two tables; keys of runs come from circumstances and
studies. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from bench.measures import budgets, costs
from bench.option import Option as Option
from bench.registry import classes, imported, names
from bench.usual import FALSE_ALARMS
from bench.words import DEFAULTS, SMALL, WIDTH


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        group: heading in the overview.
        summary: line in the overview.
        text: a paragraph.
        examples: lines that can be typed.
        usage: arguments behind its name; a line for each form.
        module: module that has a function of its name; empty for the one of its name in ``bench.commands``.
        shares: keys of other commands that it takes, too.
        options: its own keys, where ``bench.commands`` does not have it.
        makes: of a command that makes runs, key of the circumstance or study that it shows; ``run`` for captures.
        keys: its options of circumstances; empty for all, or those of its study.
        given: options that it gives where they are not typed.
        out: folder of ``out=``, with its help; empty if it writes nothing.
    """

    group: str
    summary: str
    text: str
    examples: str = ""
    usage: str = "[key=value ...]"
    module: str = ""
    shares: str = ""
    options: tuple[Option, ...] = ()
    makes: str = ""
    keys: tuple[str, ...] = ()
    given: Mapping[str, str] = field(default_factory=dict)
    out: tuple[str, str] = ("", "")


MAKERS = "run makers"  # bench run, and other commands of kinds and circumstances (`makers`)
WORK = f"{MAKERS} tune check"
FOLDS = f"{WORK} choose groups report"  # commands with the keys of a run
CHOICE = "choose report"
OPTIONS = (
    Option(
        "data",
        f"{FOLDS} fit",
        "text",
        DEFAULTS["data"],
        "synth (generated captures) or an imported corpus, several joined by +",
    ),
    Option(
        "where",
        f"{FOLDS} fit",
        "text",
        DEFAULTS["where"],
        "captures to use, such as where=\"variant == 'rough'\"",
    ),
    Option(
        "target", f"{FOLDS} fit", "text", DEFAULTS["target"], "columns that define the class, such as gesture+variant"
    ),
    Option("protocol", FOLDS, "text", DEFAULTS["protocol"], "{protocols}"),
    Option(
        "model",
        f"{FOLDS} fit audit",
        "text",
        DEFAULTS["model"],
        "{models}; names with a year are published systems",
    ),
    Option(
        "features",
        f"{FOLDS} fit audit",
        "text",
        DEFAULTS["features"],
        "{features}; not used by all models",
    ),
    Option("model.window", "run", "number", None, "seconds per window; a model of whole captures then uses windows"),
    Option("model.repair", "run", "text", "", "sensor damage to correct", ("stuck", "dead", "offset"), "+"),
    Option("model.scale", "run", "text", "", "divide by the largest reading so far, or take logs", ("peak", "log")),
    Option("model.faults", "run", "text", "", "also train on damaged copies: all, or faults of bench stress", (), "+"),
    Option("model.turns", "run", "count", 0, "number of mirrored or rotated copies of each training capture"),
    Option("model.person", "run", "text", "", "adapt to a person without labels", ("centre", "scale", "pool"), "+"),
    Option("model.device", "run", "text", "cpu", "device that trains networks", ("cpu", "cuda")),
    Option(
        "seed",
        f"{WORK} fit audit",
        "count",
        int(DEFAULTS["seed"]),
        "seed of models and feature sets; splits: protocol.seed=",
    ),
    Option("jobs", WORK, "count", None, "number of worker processes; default one per core"),
    Option("trials", "tune", "count", 50, "combinations to try in each fold; a grid of lists is tried completely"),
    Option("seconds", "tune", "number", None, "seconds after which a fold starts no new combination"),
    Option("smallest", "tune", "text", "", "parameter of model= to make as small as possible, or features"),
    Option("inner", "tune", "text", "3", "inner folds: number of groups of training subjects, or loso"),
    Option("run", CHOICE, "text", "", "ids of stored runs, as comparison.csv lists them"),
    Option("latest", CHOICE, "yes", False, "yes: only the newest parameters of each model and feature set"),
    Option("scene", "choose", "text", "", "TOML file with a robot's needs, or companion, toy or handle"),
    Option("by", "choose", "text", "flash", "cost to minimise"),  # its values: `bench.measures.costs`
    Option(
        "margin",
        "choose",
        "number",
        None,
        "accepted loss in points; a one-sided paired t-test replaces the standard error",
    ),
    Option("unit", "choose", "text", "capture", "unit of accuracy", ("capture", "window")),
    Option("batch", "choose groups", "yes", False, "yes: also systems whose labels depend on other test captures"),
    Option("shots", "choose", "count", None, "labelled captures of a new person, with protocol=personal or transfer"),
    Option("why", "choose", "yes", False, "yes: also print what the choice depends on, and what is left out"),
    Option("out", "groups", "text", "groups", "folder for groups.csv and the figure"),
    Option("stopping", "fit", "yes", True, "no: skip three extra fits for calibration and early decisions"),
    Option("out", "fit", "text", "", "folder for a copy of the model; new or empty"),
    Option("out", "predict", "text", "", "CSV file that is safe in spreadsheets; default: print the table"),
    Option("out", "adapt", "text", "", "folder for the adapted model; new or empty"),
    Option("rate_hz", "adapt predict", "number", None, "frame rate of FILE in Hz; must equal the model's"),
    Option("baseline", "check", "text", "reports/baseline.json", "baseline file"),
    Option("update", "check", "yes", False, "yes: write the baseline again; keys of bench run add systems"),
    Option("stored", "check", "yes", False, "yes: run nothing, compare the newest stored runs"),
    Option("error", "check", "number", 1, "error rate in percent of all tests of accuracy and labels together"),
    Option("slower", "check", "number", 2, "largest factor of computing time, relative to a reference workload"),
    Option("junit", "check", "text", "", "JUnit file for a CI server, such as check.xml"),
    Option("name", "data-import", "text", "", "name of the corpus; an earlier corpus of this name is replaced"),
    Option("grid", "data-import", "text", "", "table or recording: rows and columns of the skin, such as 8x8"),
    Option("rate_hz", "data-import", "number", None, "table or recording: frame rate in Hz"),
    Option("full_scale", "data-import", "number", 1023, "table or recording: largest possible reading"),
    Option("where", "data-show", "text", DEFAULTS["where"], "captures, or whole recordings, to show"),
    Option("target", "data-show", "text", DEFAULTS["target"], "columns whose classes are also counted"),
    Option("capture", "data-show", "count", None, "capture to animate, from 0; default one per gesture"),
    Option("out", "data-show", "text", "look", "folder for figures, an animation and index.html, which shows them"),
    Option("format", "data-export", "text", "cost", "file format, that of CoST.csv", ("cost",)),
    Option("out", "report", "text", "report", "folder for the page"),
    Option(
        "paper",
        "report",
        "text",
        "accuracy",
        "columns of paper.tex and paper.csv: accuracy and macro_f1 under each protocol; fit, predict and flash",
    ),
    Option("against", "report", "text", "", "system that p values compare with; default the best of your own"),
    Option("port", "ui", "text", "5000", "port of the server"),
)
TRUSTED = "Loading a model runs its code: use only models that you or someone you trust saved."
RUNS = {  # commands that make runs of captures
    "run": Command(
        "start here",
        "evaluate systems under a protocol and store the runs",
        "Evaluates every combination of the given values; commas separate values. A dotted key sets a "
        "parameter of that part. Each combination is one MLflow run with a child run per fold. under=, after=, "
        "form= and train_subjects= let each fitted system label the test captures again: under faults, after "
        "some of the touch, in C, or fitted on fewer subjects. An interrupted command continues where it "
        "stopped.",
        "bench run protocol=loso model=cnn85\n"
        f"bench run data=haart {SMALL}\n"
        "bench run data=haart protocol=challenge,loso model=bayes,svm,rf,xgb features=jung28,jung54\n"
        "bench run data=cost model=svm model.C=8,32,128 model.gamma=0.125\n"
        "bench run data=haart model=lda features=touch under=noise,dead_taxels after=250ms,1s form=c\n"
        "bench run data=synth data.subjects=12 data.repetitions=2",
        makes="run",
    ),
    "stream": Command(
        "compare",
        "replay captures in time: accuracy against milliseconds of touch",
        "Replays captures and measures accuracy against milliseconds of touch, and computing time per "
        "decision. Adaptive stopping decides as soon as the expected gain from waiting is small, as learned on "
        "training subjects. It is bench run with after=each stopping=yes.",
        "bench stream data=haart protocol=loso model=svm,rf features=jung54\n"
        "bench stream data=haart model=svm start=onset,middle hop_ms=125",
        makes="after",
        keys=("hop_ms", "start"),
        given={"after": "each", "stopping": "yes"},
        out=("report", "folder for streaming.csv, stopping.csv and figures"),
    ),
    "stress": Command(
        "compare",
        "find faults, subjects and conditions under which systems fail",
        "Trains every fold once and tests it on clean captures and under every fault at five severities. Lists "
        "subjects, classes, conditions and faults whose accuracy is significantly below that of the system. "
        "With several seeds, it also counts captures whose label changes. It is bench run with under= and "
        "train_subjects=. An interrupted command continues where it stopped.",
        "bench stress data=haart protocol=loso model=svm,rf features=jung54\n"
        "bench stress data=haart protocol=loso model=rf seed=0,1,2 faults=noise,shift train_subjects=2,4,8",
        makes="under",
        keys=("under", "train_subjects"),
        given={"faults": "all"},
        out=("stress", "folder for tables and figures"),
    ),
}
OTHERS = {  # commands that make no runs of a kind
    "choose": Command(
        "start here",
        "find the cheapest system within one standard error of the best",
        "Finds, among stored runs on the same captures, the cheapest system within one standard error of the most "
        "accurate one. This is the standard error of the paired difference over subjects. If no system fits the "
        "budgets, it prints the lowest cost for each budget; exit code 1. why=yes prints all reasons. Runs with failed "
        "folds, and older runs on other captures, are left out. 1 kB is 1000 bytes, 1 KiB is 1024. Sizes exclude code, "
        "except where a run linked the system in C, which also counts instructions. max_false_alarms= and max_latency= "
        "compare runs on recordings instead, by the share of touches whose label is correct at the end.",
        "bench choose data=haart protocol=loso max_flash=256kB max_ram=32kB\n"
        f"bench choose data=haart protocol=loso max_false_alarms={FALSE_ALARMS:g} max_latency=1s",
    ),
    "report": Command(
        "start here",
        "write the verdict, all runs and published numbers to one page",
        "Writes index.html, which loads no other file. It shows the verdict of bench choose within the budgets, "
        "accuracy against each cost, all runs with their commands, published numbers, figures and paired statistics. "
        "The folder also has comparison.md, comparison.tex (booktabs), CSV tables, and figures as SVG. "
        "paper.tex and paper.csv have systems as rows and protocols side by side. The keys of bench run, run= and "
        "latest=yes select the stored runs.",
        "bench report max_flash=64kB max_decision=500ms\n"
        "bench report data=haart protocol=loso,challenge,kfold latest=yes paper=accuracy,flash",
    ),
    "data": Command(
        "start here",
        "list, import, show, verify and export corpora",
        "Without an action, lists the corpora with counts, digest, source and licence. import reads the Corpus of "
        "Social Touch, HAART (zip or folder), CuddleBot (folder or archive) or a table. align=, frames= and crop= "
        "change captures of any format. A CSV or parquet table has the columns subject, gesture, "
        "frame, conditions and channels. A .npz table has frames, offsets, subject and gesture. A column synthetic "
        "marks generated captures. A recording is continuous touch: a CSV or parquet file with one row per frame. It "
        "has channels and a column label (empty or None without touch, ? where it is doubtful); columns recording and "
        "subject are optional. "
        "show prints counts, gaps, durations, pressure, broken taxels, seams and equal captures. verify reads every "
        "stored file again; exit code 1 if one has changed. show and export take parameters of synth, such as "
        "subjects=4.",
        "bench data import cost CoST.csv\n"
        'bench data import haart "HAART DataSet.zip" align=yes\n'
        "bench data import table my.csv name=arm grid=10x10 rate_hz=54 full_scale=1023\n"
        "bench data import recording day.csv name=day grid=10x10 rate_hz=54\n"
        "bench data export synth out.csv subjects=31 repetitions=6",
        "\nimport cost|cuddlebot|haart|table|recording FILE [key=value ...]\nshow NAME [key=value ...]\nverify NAME\n"
        "export NAME FILE",
    ),
    "audit": Command(
        "compare",
        "verify that your own system keeps the rules",
        "Verifies on generated captures that a system predicts without labels and one capture at a time. Equal seeds "
        "must give equal results, and test captures and earlier fits must change nothing. The system must accept "
        "another grid and frame rate, and it must be possible to copy, save and load it. Nothing is stored. Exit code "
        "1 if a check failed. The audit finds mistakes, not fraud.",
        "bench audit model=my.py:Mine\nbench audit model=lda,svm features=touch",
    ),
    "tune": Command(
        "compare",
        "search the parameters of systems inside each training part",
        "Like bench run, but searches the parameters of each model in every training part, on inner folds of whole "
        "subjects. model.C=8,32,128 lists values; without lists, it searches the ranges that the model declares. "
        "Prints and stores the chosen values of each fold and every combination. smallest=X chooses the smallest value "
        "of the parameter X within one standard error of the best one, and runs the unchanged system beside it. It "
        "tries the values of model.X=, or an eighth, a quarter, a half and all of the default. An interrupted search "
        "continues where it stopped.",
        "bench tune data=haart protocol=loso model=svm features=jung54 trials=50\n"
        "bench tune data=haart protocol=challenge model=rf,xgb features=ta273\n"
        "bench tune data=haart protocol=loso model=cnn85 smallest=frames",
    ),
    "groups": Command(
        "compare",
        "find groups of gestures that can be told apart",
        "Merges gestures into fewer and fewer groups, the most confused groups first, and prints the accuracy with "
        "each number of groups. It uses stored predictions: of model= and features=, or else of the most accurate "
        "system. The groups of each subject are chosen on the other subjects. Prints the table [reactions] of a scene "
        "file for 90, 95 and 99 % accuracy. Writes groups.csv and a dendrogram as SVG.",
        "bench groups data=haart protocol=loso\nbench groups data=haart protocol=loso model=svm features=jung54",
    ),
    "ui": Command(
        "compare",
        "open MLflow's page of the runs",
        "Starts MLflow's server on this machine only, for the store of this folder or MLFLOW_TRACKING_URI. Prints the "
        "address of the table of runs, and draws the figures of new runs. Ctrl-C stops the server.",
        module="bench.commands.report",
    ),
    "fit": Command(
        "start here",
        "train one system on all captures and save it as an MLflow model",
        "Prints the address of the model in the store. Use it in mlflow.pyfunc.load_model, mlflow models serve, bench "
        "predict and all commands that take MODEL. Each key has one value.",
        "bench fit data=haart model=svm features=jung54 out=svm\nmlflow models serve -m svm --env-manager local",
    ),
    "predict": Command(
        "ship",
        "classify the captures of a file with a saved model",
        "FILE is CSV, parquet or .npz in the format of bench data import table; subject and gesture are optional. "
        "Prints capture, label, confidence and the probability of each class. MODEL is models:/..., runs:/.../model "
        f"of the store of this folder, or a folder. {TRUSTED}",
        "bench predict models:/m-0123456789abcdef new.csv out=labels.csv",
        "MODEL FILE [key=value ...]",
        "bench.commands.fit",
    ),
    "adapt": Command(
        "ship",
        "adapt a saved model to one person",
        "FILE contains captures of one person, in the format of bench data import table. With a column gesture, the "
        "model learns from the labels. Without it, the model adapts to differences between this person and the "
        "training subjects. MODEL does not change. reflex, lda, networks (their last layer) and models with "
        "model.person= can adapt; bench run protocol=personal measures the gain.",
        "bench fit data=haart model=reflex out=rec\nbench adapt rec anna.csv out=rec_anna",
        "MODEL FILE out=FOLDER [key=value ...]",
        "bench.commands.fit",
    ),
    "check": Command(
        "more",
        "compare runs with a stored baseline, a gate for CI",
        "Prints one line per system of the baseline: same, worse, better, changed (labels), slower, larger, or not "
        "run. Runs everything that the current code has not run yet. Exit code 1 if a system is not the same. better "
        "also counts, because a leak makes a system better. A paired bootstrap over subjects tests accuracy. 0.2 % of "
        "the labels may change, and sizes may grow by 10 %. Keys of bench run select systems of the baseline.",
        "bench check update=yes data=haart model=svm,rf features=jung54\nbench check junit=check.xml slower=3",
    ),
}


def makers() -> dict[str, Command]:
    """The commands that make runs, by name: of captures, then those of packages."""
    return RUNS | {name: one for name, one in classes("commands").items() if getattr(one, "makes", "")}


def measured(command: Command) -> Iterator[Option]:
    """The options of circumstances, or of a study, in a command; by the names of this command."""
    every = classes("circumstances").values()
    mine = [c for c in every if c.key == command.makes and c.study] or [c for c in every if not c.study]
    fields = {name: one for c in mine for name, one in c.fields().items()}
    for key in command.keys or fields:
        option, alias = fields[key]
        name = alias if alias and command.makes != "run" else key
        yield replace(option, key=name, default=command.given.get(name, option.default))
    if command.out[0]:
        yield Option("out", "", "text", *command.out)


def commands() -> dict[str, Command]:
    """All commands by name, in the order of the overview."""
    made = makers()
    first = {name: command for name, command in made.items() if command.group == "start here"}
    before = [*OTHERS][: [*OTHERS].index("groups")]
    last = {name: command for name, command in OTHERS.items() if command.group == "more"}
    others = {name: command for name, command in OTHERS.items() if name not in last}
    main = {**first, **{name: OTHERS[name] for name in before}, **made, **others}
    added = {name: c for name, c in classes("commands").items() if isinstance(c, Command) and name not in main}
    return {**main, **added, **last}


def added_keys(command: str = "") -> dict[str, Option]:
    """The keys that packages add to a command, or to any, by name."""
    every = {one.key: one for one in classes("commands").values() if isinstance(one, Option)}
    return {name: one for name, one in every.items() if not command or command in one.commands.split()}


def used(command: str) -> dict[str, Any]:
    """What does the work of the keys that packages add to a command, by key."""
    return {name: imported(one.uses) for name, one in added_keys(command).items() if one.uses}


def options(command: str) -> dict[str, Option]:
    """The keys of a command by name; those of all its actions for one that has some."""
    maker = makers().get(command)
    if not maker and command not in OTHERS and isinstance(added := classes("commands").get(command), Command):
        shared = (option for option in OPTIONS if option.key in added.shares.split())
        return {option.key: option for option in (*shared, *added.options)}
    names = {command, "makers"} if maker else {command}
    rows = [o for o in _every(command) if any(c in names or c.startswith(f"{command}-") for c in o.commands.split())]
    return {option.key: option for option in (*rows, *(measured(maker) if maker else ()))}


def _every(command: str) -> Iterator[Option]:
    """All options; rooms and packages add theirs at the end. A command with budgets has them behind ``by``.

    Others do without the costs of installed packages, so that their help comes even where one cannot be loaded.
    """
    for option in (*OPTIONS, *added_keys().values()):
        if option.key != "by":
            yield option
            continue
        if command not in CHOICE.split():
            continue
        yield replace(option, values=tuple(costs()))
        for key, cost in budgets().items():
            yield Option(key, "choose" if cost.runs == "recordings" else CHOICE, "amount", None, cost.help)


def keys(command: str) -> set[str]:
    """Keys that a command takes, without parameters of parts, which have a dot."""
    return {key for key in options(command) if "." not in key}


def rooms() -> dict[str, str]:
    """The rooms of parts, by the key that names them."""
    made = (option for maker in makers().values() for option in measured(maker))
    return {option.key: option.room for option in (*OPTIONS, *added_keys().values(), *made) if option.room}


def overview() -> str:
    """The commands to begin with, each with its summary, and the names of the others."""
    groups: dict[str, list[str]] = {}
    every = commands()
    for name, command in every.items():
        groups.setdefault(command.group, []).append(name)
    (first, members), *others = groups.items()
    lines = ["bench: which recogniser of touch gestures should I ship?", "", f"{first}:"]
    lines += [f"  bench {name:10}{every[name].summary}" for name in members]
    lines += ["", "other commands:"]
    lines += [f"  {group:16}{', '.join(names)}" for group, names in others]
    return "\n".join([*lines, "", "bench COMMAND --help explains a command and lists its options."])


def help_of(name: str) -> str:
    """The help of a command: usage, a paragraph, its own keys, those that it shares with ``bench run``, examples."""
    command, table = commands()[name], options(name)
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
    if option.room:
        text = text.replace(f"{{{option.room}}}", ", ".join(names(option.room)))
    if len(option.values) > 1:
        text += f": {(', ' if option.joint == ',' else option.joint).join(option.values)}"
    if option.type != "yes" and option.default not in (None, "", 0, ()):
        text += f"; default {option.default:g}" if option.type == "number" else f"; default {option.default}"
    return textwrap.fill(
        text, WIDTH, break_on_hyphens=False, initial_indent=f"  {option.key + '= ':16}", subsequent_indent=" " * 18
    )
