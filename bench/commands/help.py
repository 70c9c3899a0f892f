"""The commands: where each begins, what it is for, and its help text; completion reads the keys there.

Nothing is imported, so that help and completion come at once.
"""

from __future__ import annotations

SMALL = "model=lda features=touch model.window=1.0 model.repair=stuck+dead"  # a small system, accurate on real touch
RUN = """\
bench run [key=value ...]

Runs every combination of the given values; a comma lists several. A dotted key sets a parameter of that part. Each
combination is one run in MLflow with a child run per fold. An interrupted command goes on where it stopped.

  data=       {data}, or an imported corpus (see: bench data); default synth
  where=      captures to use, a condition on their columns: where="variant == 'rough'"
  target=     columns that make the class to predict, such as variant or gesture+variant; default gesture
  protocol=   {protocols}; default loso
  model=      {models}; default svm
              (a name with a year is a whole published system, see: bench systems)
  features=   {features};
              default jung54, for the models that take features
  model.window=  seconds: any model that decides once per capture decides on windows instead (model.hop= apart)
  model.repair=  stuck+dead (also offset): broken taxels filled from their neighbours
  model.scale=   peak: captures divided by the largest reading so far; log: logarithms of readings
  model.faults=  all, or names joined by + (see: bench stress --help): trained on damaged copies, too (model.copies=3)
  model.turns=   so many copies of each training capture, mirrored or turned as on a skin that was mounted otherwise
  seed=       of models and feature sets that have one; default 0. protocol.seed= draws other splits
  jobs=       worker processes; default one per core
  cluster=    do the folds on workers of dask instead: tcp://HOST:8786, or the file of its scheduler (docs/cluster.md)

  bench run protocol=loso model=cnn85
  bench run data=haart model=lda features=touch model.window=1.0 model.repair=stuck+dead
  bench run data=haart protocol=challenge,loso model=bayes,svm,rf,xgb features=jung28,jung54
  bench run data=cost model=svm model.C=8,32,128 model.gamma=0.125
  bench run data=synth data.subjects=12 data.repetitions=2
  bench run data=haart model=svm,rf,xgb features=jung28,jung54 cluster=tcp://host:8786
"""
TUNE = """\
bench tune [key=value ...]

Like bench run, but searches each model's parameters on inner folds of whole subjects inside every training part. Prints
and stores the choice in each fold, with every combination tried and the front of accuracy against prediction time
(combinations that no other beats in both). An interrupted search goes on where it stopped.

  model.X=    values to try, such as model.C=8,32,128; default the ranges that the model declares
  trials=     combinations to try in each fold; default 50, or all of a grid of lists
  budget=     seconds after which a fold begins no new combination
  inner=      groups of training subjects that judge, or loso; default 3
  data= where= target= protocol= model= features= seed= jobs= cluster=   as for bench run

  bench tune data=haart protocol=loso model=svm features=jung54 trials=50
  bench tune data=haart protocol=challenge model=rf,xgb features=ta273 budget=60
"""
CHOOSE = """\
bench choose [key=value ...]

Finds, among tracked runs on the same captures, the cheapest system that loses at most one standard error of the paired
difference over subjects to the most accurate one. Says why, and what each budget costs in points. If nothing fits, it
says which budget binds and the least that any system needs. Exit code 1 then. Runs with failed folds, and runs on an
older version of a corpus, are left out and counted.

  by=           cost to keep low: flash (default), ram, predict, decision (touch that a decision needs) or cycles
  max_flash=    budgets, such as max_flash=256kB max_ram=32kB (kB 1000, KiB 1024 bytes; counted without code, or linked
                for what bench chip has exported)
  max_predict=  computing time of one label on this machine, such as max_predict=2ms
  max_decision= touch until the decision, such as max_decision=1s; computing time on this machine is not part of it
  clock=        of the target, such as clock=64MHz: the decision of what bench chip has exported then includes its
                measured cycles at this clock, one cycle per instruction
  max_cycles=   instructions of the costliest frame with its label, such as max_cycles=600k, of what bench chip has
                exported. The clock of the chip divided by the frames of a second is the most it could do: leave room
                for instructions that take more than a cycle, and for all else that it does
  margin=       points of accuracy that do not matter: a one-sided paired t-test (p < 0.05) replaces the SE
  unit=         capture (default), or window: percent of single windows, of the systems that decide on such
  batch=        yes: also systems whose predictions depend on the captures predicted together
  shots=        among runs of protocol=personal (or transfer) of which so many captures of a new person are known;
                protocol.draws=, protocol.source= and the like choose among them
  data= where= target= protocol= model= features=   choose among the runs

  over=X        instead: run model= with the smallest X that suffices by the same rule, beside the unchanged system;
                every fold chooses it on left-out training subjects. X is a numeric parameter (values: model.X=10,20,
                else an eighth, a quarter, a half and all of the default), or features (2 to 32 of them, or all)
  inner=        groups of training subjects that judge, or loso; default 3
  seed= jobs= cluster=   as for bench run, with over=

  bench choose data=haart protocol=loso
  bench choose data=haart protocol=loso max_flash=256kB max_ram=32kB
  bench choose data=haart protocol=loso model=cnn85 over=frames
  bench choose data=haart protocol=loso model=svm features=jung54 over=features
"""
STRESS = """\
bench stress [key=value ...]

Fits every fold once, tests it on captures as they are and under every fault at five severities, and reports where each
method fails: subjects, classes, conditions, faults and pairs of them where it falls significantly below its own
accuracy, the severity that costs half of its margin over chance, and how the order of the methods changes. Several
seeds also show how many captures change label. All goes into MLflow; an interrupted command goes on where it stopped.

  faults=          dead_taxels, stuck_taxels, dead_lines, gain_drift, offset_drift, saturation, noise, fewer_bits,
                   dropped_frames, lower_rate, time_jitter, late_start, early_end, shift, rotation, smaller_grid, cover;
                   default all; none for the learning curve alone
  train_subjects=  also fit on these numbers of training subjects, for a learning curve; default none
  out=             folder for the tables and figures; default stress
  data= where= target= protocol= model= features= seed= jobs= cluster=   as for bench run

  bench stress data=haart protocol=loso model=svm,rf features=jung54
  bench stress data=haart protocol=loso model=rf seed=0,1,2 faults=noise,shift train_subjects=2,4,8
"""
STREAM = """\
bench stream [key=value ...]

Replays captures as a robot sees them: accuracy against milliseconds of touch, time per decision, and adaptive stopping,
which decides as soon as waiting is expected to gain too little, as learned on training subjects. Each combination is
one run in MLflow with a child run per fold; an interrupted command goes on where it stopped.

  hop_ms=     milliseconds between decisions; default: decide each time 1.41 times as much is seen, from 62.5 ms on
  start=      onset, or middle, which skips the first half of each capture; default onset
  out=        folder of streaming.csv, stopping.csv and streaming.png, .svg; default report
  data= where= target= protocol= model= features= seed= jobs= cluster=   as for bench run

  bench stream data=haart protocol=loso model=svm,rf features=jung54
  bench stream data=haart model=svm start=onset,middle hop_ms=125

bench stream source=- model=MODEL [hop_ms=125] [window_ms=]

Decides on frames from standard input: a line per frame, its values in row-major order; a line of blanks, or of nothing,
ends a capture. Values are decimal numbers (7, 0.25, 1e3), all with a comma between them or all with blanks (spaces,
tabs); at most 32 characters a value. The C of bench export reads the same.

Prints a line per decision: capture, ms, label, confidence, and settled, which is yes from where training subjects have
shown that waiting for more of the capture gains too little (- if bench fit found no such moment). MODEL is a model that
bench fit saved. Keeps and sees only the last window_ms, by default the length of the longest training capture.

  sensor | bench stream source=- model=models:/m-0123456789abcdef
"""
FIT = """\
bench fit [key=value ...]

Trains one system on all captures and saves it as an MLflow model, which mlflow.pyfunc.load_model, mlflow models serve,
bench predict and bench stream source=- accept. Prints its address in the store. Three more fits that leave subjects out
teach how sure the system may be (its probabilities are calibrated) and when it can decide early; both go with it.

  out=        also save it as this folder, which must be new or empty
  stopping=   no leaves those fits out: probabilities stay as they are; default yes
  data= where= target= model= features= seed=   as for bench run, one value each

  bench fit data=haart model=svm features=jung54 out=svm
  mlflow models serve -m svm --env-manager local
"""
ADAPT = """\
bench adapt MODEL FILE out=FOLDER [labels=no] [rate_hz=]

Adapts a saved system to one person, in well under a second: FILE holds some of their captures, in the format of bench
data import table. With a column gesture the system learns from them, else (or with labels=no) only how this person
differs from those of training. Channels ch1, ch2, ... are read by their numbers, and none may be missing or extra.
Saves the adapted system as a folder, which bench predict and bench stream source=- accept; MODEL stays as it is.
reflex, lda, networks (their last layer) and what was fitted with model.person= can adapt. What it is worth: bench run
protocol=personal.

  bench fit data=haart model=reflex out=rec
  bench adapt rec anna.csv out=rec_anna
"""
EXPORT = """\
bench export MODEL out=FOLDER [bits=32|8]

Writes a saved system as C99 that needs no heap and no library but math.h: touch.h (touch_init, touch_push and
touch_label), touch.c, and tables.h with what was learnt. A Makefile builds it for this machine, where main.c decides on
frames from standard input as bench stream source=- does, as long as a capture is no longer than those in training
(make, make check), and for a Cortex-M4F with 256 KiB of flash and 32 KiB of RAM (make chip; FLASH=512K RAM=64K for
another; it says how many bytes are missing where the program does not fit). make flash prints the bytes of touch.c
alone, make count its instructions and stack. What the model has learned about when to decide goes along, and so does a
person whom it was adapted to.

A model is code: loading one runs it, so name only models saved by you or someone you trust.

reflex has C; so have lda, softmax, bayes, svm, tree, rf, et and xgb on touch with model.window=, or on jung28; and
of networks hughes2017_cnn.

  bits=       8 stores weights and leaves in 8 bits, support vectors in 16; default 32
  out=        a folder that is new or empty

  bench fit data=haart model=reflex out=rec
  bench export rec out=rec_c bits=8
  make -C rec_c check
  sensor | rec_c/touch
"""
CHIP = """\
bench chip [key=value ...]

What systems answer as C, and what they take of a microcontroller: every fold fits, exports as bench export does, lets
the C label the test captures beside Python, links it for a Cortex-M4F with 256 KiB of flash and 32 KiB of RAM (bytes;
as large as if it had learned when to decide), and counts instructions in QEMU: of a frame, mean, and of the costliest
frame with its label. Each system and number of
bits is one run in MLflow; bench choose and bench report read them.

library RAM is the state of touch.c, without the program's own stack and buffers; stack B is the most stack that a frame
and its label take. program RAM is the whole program that make chip links: touch.c, main.c, the C library, and 4096
bytes for heap and stack.

Needs cc, make, arm-none-eabi-gcc and qemu-system-arm (Debian: gcc make gcc-arm-none-eabi libnewlib-arm-none-eabi
qemu-system-arm).

  bits=       32, 8 or both: of a learnt weight; default 32
  data= where= target= protocol= model= features= seed= jobs= cluster=   as for bench run

  bench chip data=haart protocol=loso model=reflex bits=32,8
  bench choose data=haart protocol=loso max_flash=64kB max_ram=32kB max_cycles=1M
"""
PREDICT = """\
bench predict MODEL FILE [out=labels.csv] [rate_hz=]

Labels the captures of a CSV, parquet or .npz file in the format of bench data import table; subject and gesture may be
missing. Channels ch1, ch2, ... are read by their numbers, and none may be missing or extra. A column capture names
captures; else they are counted from 1. Prints capture, label, confidence and the probability of each class; in the file
out=, made for people, a name that a spreadsheet would take for a formula is led by an apostrophe. rate_hz=, if given,
must match the rate of the model's training captures.

MODEL is models:/..., runs:/.../model of the store of this folder, or a folder. A model is code: loading one runs it, so
name only models saved by you or someone you trust.

  bench predict models:/m-0123456789abcdef new.csv out=labels.csv
"""
CHECK = """\
bench check [key=value ...]

Compares systems with a stored baseline, one line for each: same, worse, better, changed (labels), slower, larger, or
not run. Runs systems of the baseline that the current code has not run yet. Exit code 1 if one is not the same: better
counts too, as a leak makes a system better.

  baseline=   the file; default reports/baseline.json
  update=true write it anew, and show the changes. Keys of bench run add systems to it:
              update=true data=arm model=svm,rf
  error=      percent, error rate of accuracy and labels for all systems together; default 1. A paired bootstrap judges
              accuracy, over subjects, or over captures where subjects are too few
  changes=    percent of labels that may change in a system that must repeat them (it has no seed; or the same seed,
              processor, versions and threads); default 0.2, for rounding; 100 asks for accuracy alone
  slower=     times the baseline's computing time, as a multiple of a reference workload timed in the same fold;
              default 2. Size may grow by 10 %
  junit=      file to write for a CI server, such as check.xml
  run=false   run nothing, take the newest complete tracked runs
  jobs= cluster=   as for bench run

  bench check update=true data=haart model=svm,rf features=jung54
  bench check
  bench check baseline=reports/baseline.json junit=check.xml slower=3
"""
AUDIT = """\
bench audit model=my.py:Mine [key=value ...]

Verifies that a system keeps the rules that its accuracy does not show: it predicts without labels and one capture at a
time, repeats with equal seeds, learns nothing from test captures or from an earlier fit, takes another grid and rate,
and can be copied, saved and loaded. Prints a table of passed, failed or not applicable with one sentence each. It uses
generated captures and stores nothing; a fast model takes a few seconds. Exit code 1 if a check failed. It finds
mistakes, not fraud.

  model= features= seed=   as for bench run, with parameters such as model.C=8; a comma audits several

  bench audit model=my.py:Mine
  bench audit model=lda,svm features=touch
"""
SYSTEMS = """\
bench systems

Every published number with the command that repeats it here, or why there is none.
"""
EXTRACT = """\
bench extract data=NAME features=NAME out=FILE [where=CONDITION]

Writes the features of every capture, with its subject, gesture and conditions, as .parquet or .csv.
"""
DATA = """\
bench data                                      the corpora here, with counts, digest, source and licence
bench data import cost CoST.csv                 the Corpus of Social Touch as published
bench data import haart "HAART DataSet.zip"     the HAART release, zip or folder
bench data import table my.csv name=arm grid=10x10 rate_hz=54 full_scale=1023
                                                any long CSV or parquet (subject, gesture, frame, conditions, channels)
                                                or .npz (frames, offsets, subject, gesture); a column synthetic, true
                                                or false, marks generated captures. A name that is taken is replaced
bench data show haart [where=CONDITION] [target=COLUMN] [out=look] [capture=N]
                                                what it holds: counts and gaps, durations, pressure, broken or odd
                                                taxels, captures that are the same. Writes into out= the mean pressure
                                                of each gesture, film strips, an animation (of one capture of each
                                                gesture, or of capture N, counted from 0) and index.html with all of it.
                                                target= counts the classes of another column besides
bench data show synth data.subjects=4           generated captures, with any parameter of data=synth
bench data verify arm                           whether every stored file is as it was imported; exit code 1 if not
bench data export synth out.csv format=cost subjects=31 repetitions=6
                                                any corpus with CoST's columns, in the format of CoST.csv; generated
                                                captures have a column synthetic besides. Prints how to import it
"""
REPORT = """\
bench report [out=report] [max_flash=64kB] [max_ram=32kB] [max_predict=5ms] [max_decision=500ms] [max_cycles=1M]

Writes what is tracked, with the papers' numbers, into the folder out=:

  index.html      one page that loads nothing: the verdict of bench choose within the budgets, a chart of accuracy
                  against each cost, all runs, what was found in a sentence each, every published number beside ours,
                  figures, paired statistics, the papers' tables recomputed, and the command behind every row
  comparison.md   the same as markdown
  comparison.tex  a LaTeX table for each corpus, subset, protocol and unit, with booktabs
  *.csv           comparison (all runs), published, recomputed, statistics, provenance
  figures/        every figure as PNG and SVG
"""
SUBMIT = """\
bench submit task=NAME who=NAME out=FOLDER model=... [features=...] [seed=] [run=ID]

Writes what a finished run said as a folder that answers a frozen task: predictions.parquet (a row per capture, no
frames) and submission.json (where they come from). Runs nothing: it takes the run that is stored, and refuses one whose
data, subset, protocol or unit are not those of the task.

  task=       haart-loso-v1, haart-challenge-v1, haart-personal-v1, cost-loso-v1: of bench run;
              haart-early-v1: of bench stream; haart-faults-v1: of bench stress
  who=        whose result it is; shown on the leaderboard
  out=        a folder that is new or empty
  model= features= seed=   as the run was made, with its parameters (model.C=8)
  run=        instead: a run by its id, such as one of bench tune
  batch=yes   submit also a run whose labels depend on other test captures; the leaderboard shows it

  bench run data=haart protocol=loso model=svm features=jung54
  bench submit task=haart-loso-v1 model=svm features=jung54 who="A. Name, Lab" out=submissions/my-svm
"""
LEADERBOARD = """\
bench leaderboard [FOLDER ...] [out=leaderboard.html] [rerun=NAME]

Computes every score anew from submitted predictions and writes one page that loads nothing: a table for each frozen
task, with the results that come with touchbench. FOLDER is a submission or holds some. A submission that is not what
docs/leaderboard.md says is left out with a line; exit code 1 then. HAART need not be here, CoST must be imported.

  rerun=      instead of the page: repeat the command of this submission, a folder in submissions or in FOLDER. If all
              labels are equal, leaderboard-verified.json in the working folder marks it as verified; else exit code 1.
              The corpus of the task must be imported, and a file such as my.py must be in the working folder.

  bench leaderboard
  bench leaderboard submissions out=leaderboard.html
  bench leaderboard rerun=my-svm
"""
GALLERY = """\
bench gallery [out=gallery]

Draws every kind of figure from generated captures: runs a few systems in a store inside the folder out=, then
bench stress, bench stream and bench report. Takes some minutes; an interrupted command goes on where it stopped.
"""
DEMO = """\
bench demo [out=demo]

The way to a verdict in under two minutes, on generated captures (synthetic: they say nothing about people): runs five
systems, replays the two best, stresses the best with two faults, draws the page and chooses. Prints each command before
it runs it, and at the end the address of the page and the commands for captures of your own. All goes into the folder
out=, with a store of its own; an interrupted command goes on where it stopped.
"""
UI = """\
bench ui [port=5000]

Serves MLflow's own page on the store of this folder, or on MLFLOW_TRACKING_URI, on this machine only, and prints the
address of the table of runs there, with accuracy, interval and sizes in view, once it answers. Ctrl-C ends it.
"""
COMPLETION = """\
bench completion bash|zsh|fish

Prints a script that lets the shell complete commands, keys and names (models, features, protocols, corpora that are
here, faults) at TAB.

  eval "$(bench completion bash)"                                      in ~/.bashrc
  eval "$(bench completion zsh)"                                       in ~/.zshrc
  bench completion fish > ~/.config/fish/completions/bench.fish
"""
COMMANDS = {
    "run": ("bench.commands.run:run", "run recognisers under a protocol and track them", RUN),
    "tune": ("bench.commands.tune:tune", "search the parameters of recognisers inside each training part", TUNE),
    "choose": ("bench.commands.choose:choose", "find the cheapest system that is as good as the best", CHOOSE),
    "stress": (
        "bench.commands.stress:stress",
        "find where recognisers fail: faults of the sensor, subjects, conditions",
        STRESS,
    ),
    "stream": (
        "bench.commands.stream:stream",
        "replay captures as a robot sees them, or decide on frames from standard input",
        STREAM,
    ),
    "fit": ("bench.commands.fit:fit", "train one system on all captures and save it as an MLflow model", FIT),
    "adapt": ("bench.commands.fit:adapt", "adapt a saved model to one person", ADAPT),
    "export": ("bench.commands.export:export", "write a saved model as C99 for a microcontroller", EXPORT),
    "chip": ("bench.commands.chip:chip", "measure what systems answer and take as C on a microcontroller", CHIP),
    "predict": ("bench.commands.fit:predict", "label the captures of a file with a saved model", PREDICT),
    "check": ("bench.commands.check:check", "compare with a stored baseline, a gate for CI", CHECK),
    "audit": ("bench.commands.audit:audit", "verify that a system of your own keeps the rules", AUDIT),
    "systems": ("bench.commands.systems:systems", "list published numbers and the commands that repeat them", SYSTEMS),
    "extract": ("bench.commands.extract:extract", "write a table of features", EXTRACT),
    "data": ("bench.commands.data:data", "list, import, look at, verify and export corpora", DATA),
    "submit": ("bench.commands.leaderboard:submit", "write a stored run as an answer to a frozen task", SUBMIT),
    "leaderboard": ("bench.commands.leaderboard:leaderboard", "rescore submissions into one page", LEADERBOARD),
    "report": ("bench.commands.report:report", "the verdict, all runs and published numbers on one page", REPORT),
    "gallery": ("bench.commands.gallery:gallery", "draw every kind of figure, from generated captures", GALLERY),
    "demo": ("bench.commands.demo:demo", "see the way to a verdict in two minutes, on generated captures", DEMO),
    "ui": ("bench.commands.report:ui", "open MLflow's page on the runs", UI),
    "completion": ("bench.commands.completion:completion", "let the shell complete commands and names", COMPLETION),
}
GROUPS = {  # of the overview; a command that is in none stands under "more"
    "start here": ("demo", "run", "choose", "report"),
    "your captures": ("data", "extract"),
    "compare": ("systems", "audit", "tune", "stress", "stream", "chip", "ui"),
    "ship": ("fit", "predict", "adapt", "export"),
    "publish": ("submit", "leaderboard"),
}
