"""What users may type: each command with its keys and its help. Nothing heavy is imported here.

The function of a command stands in the file of its name.
"""

from __future__ import annotations

from bench.corpora.fault_names import ALL_FAULTS, FAULT_NAMES, MORE_FAULT_NAMES, NO_FAULT
from bench.grammar.options import (
    BATCH,
    COMPARE,
    DRY,
    FEATURES,
    FIT_OPTIONS,
    MODEL,
    MORE,
    OF_FILE,
    RUN_OPTIONS,
    SEED,
    SHIP,
    START,
    STORED_OPTIONS,
    TRUST_NOTE,
    Command,
)
from bench.ground.typed import DEFAULTS, SMALL_SYSTEM, Option

STEP_OPTIONS = (  # of any model
    Option(
        "model.window", "number", None, "seconds per window, also for a model of whole captures"
    ),
    Option(
        "model.repair",
        "text",
        "",
        "sensor damage to correct",
        ("stuck", "dead", "offset", "noise"),
        "+",
    ),
    Option(
        "model.scale",
        "text",
        "",
        "divide by the largest reading so far, or take logs",
        ("peak", "log"),
    ),
    Option(
        "model.faults",
        "text",
        "",
        "also train on damaged copies: all, or faults of bench stress",
        joint="+",
    ),
    Option(
        "model.turns", "count", 0, "number of mirrored or rotated copies of each training capture"
    ),
    Option("model.device", "text", "cpu", "device that trains networks", ("cpu", "cuda")),
)
RUN = Command(
    START,
    "evaluate systems under a protocol and store the runs",
    "Evaluates every combination of the given values; commas separate values. A dotted key sets a "
    "parameter of that part. Each combination is one MLflow run. under=, after= and "
    "train_subjects= test each fitted system again: under faults, after some of the touch, or "
    "fitted on fewer subjects. An interrupted command continues where it stopped. A TOML file "
    "names several grids: each table has keys of the command line, and lists for several values. "
    "Keys above the first table hold for all.",
    "bench run protocol=loso model=cnn85\n"
    f"bench run data=haart {SMALL_SYSTEM}\n"
    "bench run data=haart protocol=challenge,loso model=bayes,svm,rf,xgb features=jung28,jung54\n"
    "bench run data=cost model=svm model.C=8,32,128 model.gamma=0.125\n"
    "bench run data=haart model=lda features=touch under=noise,dead_taxels after=250ms,1s\n"
    "bench run data=synth data.subjects=12 data.repetitions=2\n"
    "bench run paper.toml dry=yes",
    "[FILE.toml] [key=value ...]",
    makes="run",
    options=STEP_OPTIONS,
)
STRESS = Command(
    COMPARE,
    "find faults, subjects and conditions under which systems fail",
    "Trains every fold once and tests it on clean captures and under every fault at five "
    "severities. Then bench report lists subjects, classes, conditions and faults whose accuracy "
    "is significantly below that of the system. With several seeds, it also counts captures whose "
    "label changes. bench stress is bench run with under= and train_subjects=. An interrupted "
    "command continues where it stopped.",
    "bench stress data=haart protocol=loso model=svm,rf features=jung54\n"
    "bench stress data=haart protocol=loso model=rf seed=0,1,2 faults=noise,shift "
    "train_subjects=2,4,8",
    makes="under",
    options=(
        Option(
            "faults",
            "text",
            ALL_FAULTS,
            "faults that damage the test captures, or all",
            (*FAULT_NAMES, *MORE_FAULT_NAMES, NO_FAULT),
        ),
        Option("train_subjects", "text", "", "numbers of training subjects for a learning curve"),
    ),
)
CHOOSE = Command(
    START,
    "find the cheapest system within one standard error of the best",
    "Finds, among stored runs on the same captures, the cheapest system within one standard error "
    "of the most accurate one. This is the standard error of the paired difference over subjects. "
    "If no system fits the budgets, it prints the lowest cost for each budget; exit code 1. "
    "why=yes prints all reasons. Runs with failed folds, and older runs on other captures, are "
    "left out. 1 kB is 1000 bytes, 1 KiB is 1024. Sizes exclude code, except where a run linked "
    "the system in C, which also counts instructions. groups=yes merges gestures into fewer and "
    "fewer groups, the most confused first, and prints the accuracy with each number of groups; "
    "those of each subject are chosen on the other subjects.",
    "bench choose data=haart protocol=loso max_flash=256kB max_ram=32kB",
    options=(
        *STORED_OPTIONS,
        Option("scene", "text", "", "TOML file with a robot's needs, or companion, toy or handle"),
        Option("by", "text", "flash", "cost to minimise"),  # of `command_options`
        Option(
            "margin",
            "number",
            None,
            "accepted loss in points; a one-sided paired t-test replaces the standard error",
        ),
        Option("unit", "text", "capture", "unit of accuracy", ("capture", "window")),
        BATCH,
        Option(
            "why", "yes", False, "yes: also print what the choice depends on, and what is left out"
        ),
        Option(
            "groups",
            "yes",
            False,
            "yes: print instead which gestures the most accurate system can tell apart",
        ),
    ),
    budgets="all",
)
REPORT = Command(
    START,
    "write the verdict, all runs and published numbers to one page",
    "Writes index.html, which loads no other file. It shows the verdict of bench choose within the "
    "budgets, accuracy against each cost, all runs with their commands, published numbers, figures "
    "and paired statistics. The folder also has comparison.md, comparison.tex (booktabs), CSV "
    "tables, and figures as SVG. paper.tex and paper.csv have systems as rows and protocols side "
    "by side. The keys of bench run, run= and latest=yes select the stored runs. bundle= also "
    "writes a zip file with the page, its tables, the commands, the predictions and the digests of "
    "the corpora. from= makes the page again from this file, without the store and without the "
    "corpus.",
    "bench report max_flash=64kB max_decision=500ms\n"
    "bench report data=haart protocol=loso,challenge,kfold latest=yes paper=accuracy,flash\n"
    "bench report data=haart bundle=paper.zip\n"
    "bench report from=paper.zip",
    options=(
        *STORED_OPTIONS,
        Option("out", "text", "report", "folder for the page"),
        Option(
            "paper",
            "text",
            "accuracy",
            "columns of paper.tex and paper.csv: accuracy, interval, p, published, macro_f1 and "
            "seed_sd (SD over seeds) under each protocol; fit, predict and flash",
        ),
        Option(
            "history",
            "yes",
            False,
            "yes: also accuracy, size and time of each system over git revisions, and steps",
        ),
        Option(
            "against", "text", "", "system that p values compare with; default the best of your own"
        ),
        Option(
            "published",
            "text",
            "",
            "CSV file of published numbers of your own, with the columns system, data, protocol, "
            "accuracy (percent) and reference; also where, target, unit and sd",
        ),
        Option("bundle", "text", "", "zip file for the report and everything behind it"),
        Option(
            "from",
            "text",
            "",
            "bundle to read instead of the store, with the options that it was made with",
        ),
    ),
    budgets="captures",
)
IMPORT_OPTIONS = (  # the format has others
    Option("name", "text", "", "name of the corpus; an earlier corpus of this name is replaced"),
    Option("grid", "text", "", "table: rows and columns of the skin, such as 8x8"),
    Option("rate_hz", "number", None, "table: frame rate in Hz"),
    Option("full_scale", "number", 1023, "table: largest possible reading"),
)
GET_OPTIONS = (
    Option("accept", "yes", False, "get: yes accepts the licence of the corpus"),
    Option("address", "text", "", "get: another place of the file, such as a mirror"),
)
SHOW_OPTIONS = (
    Option("where", "text", DEFAULTS["where"], "captures to show"),
    Option("target", "text", DEFAULTS["target"], "columns whose classes are also counted"),
    Option("out", "text", "look", "folder for figures and index.html, which shows them"),
)
EXPORT_OPTIONS = (
    Option(
        "format",
        "text",
        "",
        "file format: that of CoST.csv, or a table of any skin",
        ("cost", "table"),
    ),
)
DATA = Command(
    START,
    "download, list, import, show, verify and export corpora",
    "Without an action, lists the corpora with counts, digest, source and licence. get downloads a "
    "published corpus, verifies and imports it; without a name, it lists what can be had. It takes "
    "the keys of import, too. import reads "
    "the Corpus of Social Touch, HAART (zip or folder), CuddleBot (folder or archive) or a table. "
    "align=, frames= and crop= change captures of any format. A CSV or parquet table has the "
    "columns subject, gesture, frame, conditions and channels. A .npz table has frames, offsets, "
    "subject and gesture. A column synthetic marks generated captures. show prints counts, gaps, "
    "durations, pressure, broken taxels, seams and equal captures. verify reads every stored file "
    "again; exit code 1 if one has changed. show and export take parameters of synth, such as "
    "subjects=4.",
    "bench data get haart\n"
    "bench data import cost CoST.csv\n"
    'bench data import haart "HAART DataSet.zip" align=yes\n'
    "bench data import table my.csv name=arm grid=10x10 rate_hz=54 full_scale=1023\n"
    "bench data export synth out.csv subjects=31 repetitions=6",
    "\nget [NAME] [key=value ...]\nimport cost|cuddlebot|haart|table FILE [key=value ...]\n"
    "show NAME [key=value ...]\nverify NAME\nexport NAME FILE",
    takes_words=True,
    options=(*GET_OPTIONS, *IMPORT_OPTIONS, *SHOW_OPTIONS, *EXPORT_OPTIONS),
)
FIT = Command(
    START,
    "train one system on all captures and save it as an MLflow model",
    "Prints the address of the model in the store. Use it in mlflow.pyfunc.load_model, mlflow "
    "models serve, bench predict and all commands that take MODEL. Each key has one value.",
    "bench fit data=haart model=svm features=jung54 out=svm\n"
    "mlflow models serve -m svm --env-manager local",
    options=(
        *FIT_OPTIONS,
        Option(
            "stopping", "yes", True, "no: skip three extra fits for calibration and early decisions"
        ),
        Option("out", "text", "", "folder for a copy of the model; new or empty"),
    ),
)
COMPARE_SYSTEMS = Command(
    COMPARE,
    "compare two systems on the same captures: files of predictions or stored runs",
    "A and B are each a CSV or parquet file, or the run id or name of a stored system as bench "
    "runs prints it. A file has the columns id, subject, truth and prediction. Several rows of an "
    "id vote. Captures are matched by id. The id in stored runs is the place of the capture in the "
    "corpus, from 0. Prints the paired difference over subjects with its interval and test. It "
    "also prints the smallest difference that these subjects can show, each gesture, and the "
    "captures that only one system classifies correctly. The keys of bench run, run= and "
    "latest=yes select the stored runs.",
    "bench compare mine.csv theirs.parquet\n"
    'bench compare 3f2a9c01 "svm · touch" data=haart protocol=loso',
    "A B [key=value ...]",
    takes_words=True,
    options=(
        *STORED_OPTIONS,
        Option("out", "text", "", "CSV file for all captures with the predictions of both systems"),
    ),
)
TUNE = Command(
    COMPARE,
    "search the parameters of systems inside each training part",
    "Like bench run, but searches the parameters of each model in every training part, on inner "
    "folds of whole subjects. model.C=8,32,128 lists values; without lists, it searches the ranges "
    "that the model declares. Prints and stores the chosen values of each fold and every "
    "combination. smallest=X chooses the smallest value of the parameter X within one standard "
    "error of the best one, and runs the unchanged system beside it. It tries the values of "
    "model.X=, or an eighth, a quarter, a half and all of the default. An interrupted search "
    "continues where it stopped.",
    "bench tune data=haart protocol=loso model=svm features=jung54 trials=50\n"
    "bench tune data=haart protocol=challenge model=rf,xgb features=ta273\n"
    "bench tune data=haart protocol=loso model=cnn85 smallest=frames",
    options=(
        *RUN_OPTIONS,
        DRY,
        Option(
            "trials",
            "count",
            50,
            "combinations to try in each fold; a grid of lists is tried completely",
        ),
        Option("seconds", "number", None, "seconds after which a fold starts no new combination"),
        Option(
            "smallest", "text", "", "parameter of model= to make as small as possible, or features"
        ),
        Option("inner", "text", "3", "inner folds: number of groups of training subjects, or loso"),
    ),
)
SKIN_DESIGNS = Command(
    COMPARE,
    "search the smallest skin that a system needs: taxels, rate and bits",
    "Trains one system on each design of the skin. Prints the Pareto front of accuracy and the "
    "cost by=. Prints the cheapest design within one standard error of the recorded skin, and what "
    "each property alone costs. It also chooses a design for each person on other people, and "
    "prints the accuracy on the person left out. skin.grid=, skin.rate_hz=, skin.bits= and the "
    "other keys of skin= list designs; without them, it tries usual grids, rates and bits. "
    "Of more than 8 designs, the better half stays in each of three rounds, which test on further "
    "pairs of people. Every evaluation is a stored run, so an interrupted search continues where "
    "it stopped.",
    "bench skin data=haart model=lda features=touch model.window=1\n"
    "bench skin data=haart model=lda features=touch skin.grid=8x8,4x4,2x2 skin.bits=0,6 "
    "skin.curve=log by=wires",
    options=(
        *RUN_OPTIONS,
        Option("by", "text", "values_per_s", "cost to minimise"),
        Option(
            "wired",
            "count",
            0,
            "print instead which taxels of skin.grid= to wire, so many, chosen one after the other",
        ),
        Option("out", "text", "skin", "folder for the figures"),
    ),
)
AUDIT = Command(
    COMPARE,
    "verify that your own system keeps the rules",
    "Verifies on generated captures that a system predicts without labels and one capture at a "
    "time. Equal seeds must give equal results, and test captures and earlier fits must change "
    "nothing. The system must accept another grid and frame rate, and it must be possible to copy, "
    "save and load it. With data=, two more checks find a system that reads the files of a corpus. "
    "Nothing is stored. Exit code 1 if a check failed. The audit finds mistakes, not fraud.",
    "bench audit model=my.py:Mine\nbench audit model=lda,svm features=touch",
    options=(
        MODEL,
        FEATURES,
        SEED,
        Option(
            "data",
            "text",
            "",
            "also audit on this imported corpus, with exchanged labels and people",
        ),
    ),
)
UI = Command(
    COMPARE,
    "open MLflow's page of the runs",
    "Starts MLflow's server on this machine only, for the store of this folder or "
    "MLFLOW_TRACKING_URI. Prints the address of the table of runs, and draws the figures of new "
    "runs. Ctrl-C stops the server.",
    options=(Option("port", "text", "5000", "port of the server"),),
)
PREDICT = Command(
    SHIP,
    "classify the captures of a file with a saved model",
    "FILE is CSV, parquet or .npz in the format of bench data import table; subject and gesture "
    "are optional. Prints capture, label, confidence, whether the capture is unlike all training "
    "captures, and the probability of each class. MODEL is models:/..., runs:/.../model of the "
    f"store of this folder, or a folder. {TRUST_NOTE}",
    "bench predict models:/m-0123456789abcdef new.csv out=labels.csv",
    "MODEL FILE [key=value ...]",
    takes_words=True,
    options=(
        Option(
            "out", "text", "", "CSV file that is safe in spreadsheets; default: print the table"
        ),
        Option("rate_hz", "number", None, "frame rate of FILE in Hz; must equal the model's"),
        OF_FILE,
    ),
)
RUNS = Command(
    COMPARE,
    "list stored runs, name their system, or delete them",
    "Lists the stored runs, the newest first, with those that failed or were interrupted. The keys "
    "of bench run, run= and latest=yes select among them. delete=yes deletes the selected runs "
    "after a question. Without a terminal, it needs yes=yes. MLflow keeps deleted runs until "
    "mlflow gc; docs/store.md says how to restore them.",
    "bench runs data=haart protocol=loso\nbench runs model=my.py:Mine name=Ours\n"
    "bench runs model=cnn85 delete=yes\n"
    "bench runs run=3f2a9c01 delete=yes",
    options=(
        *STORED_OPTIONS,
        Option("name", "text", "", "short name of the system of the selected runs, for all tables"),
        Option("delete", "yes", False, "yes: delete the selected runs"),
        Option("yes", "yes", False, "yes: delete without a question"),
    ),
)
CHECK = Command(
    MORE,
    "compare runs with a stored baseline, a gate for CI",
    "Prints one line per system of the baseline: same, worse, better, changed (labels), slower, "
    "larger, or not run. Runs everything that the current code has not run yet. Exit code 1 if a "
    "system is not the same. better also counts, because a leak makes a system better. A paired "
    "bootstrap over subjects tests accuracy. 0.2 % of the labels may change, and sizes may grow by "
    "10 %. Keys of bench run select systems of the baseline.",
    "bench check update=yes data=haart model=svm,rf features=jung54\n"
    "bench check junit=check.xml slower=3",
    takes_words=True,
    options=(
        *RUN_OPTIONS,
        Option("baseline", "text", "reports/baseline.json", "baseline file"),
        Option(
            "update", "yes", False, "yes: write the baseline again; keys of bench run add systems"
        ),
        Option("stored", "yes", False, "yes: run nothing, compare the newest stored runs"),
        Option(
            "error",
            "number",
            1,
            "error rate in percent of all tests of accuracy and labels together",
        ),
        Option(
            "slower",
            "number",
            2,
            "largest factor of computing time, relative to a reference workload",
        ),
        Option("junit", "text", "", "JUnit file for a CI server, such as check.xml"),
    ),
)
