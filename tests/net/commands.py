"""Commands on the store of `tests.net.build` whose output and files are golden, and mistakes."""

from tests.net.build import PEOPLE, RATE, SYNTH, TABLE, THREE

ON = ["data=people", "where=all", "target=gesture", "protocol=loso"]
SCENES = {
    "robot.toml": """
by = "ram"
unlisted = "ignored"
[reactions]
calm = ["stroke", "rub"]
alert = ["pat", "tap"]
[costs]
silence = 0.5
alert = { calm = 3 }
[budget]
flash = "64kB"
board = "nano33ble"
share = 0.5
[faults]
names = ["noise", "dead_taxels"]
severity = 3
loss = 60
worst = 80
[people]
worst_person = 5
worst_tenth = 5
""",
    "grids.toml": """
data = "people"
features = "jung28"
[stored]
model = ["tree", "bayes"]
[seeds]
model = "rf"
"model.trees" = 5
seed = [0, 1]
""",
    "new.toml": 'margin = 10\n[reactions]\ncalm = ["stroke", "rub"]\n',
}
LDA = [*SYNTH[:-1], "model=lda", "features=touch", "model.window=0.5"]
TREE = ["model=tree", "features=jung28"]
STEPS = {  # each list in a copy of the store
    "choose": [
        ["choose"],
        ["choose", *ON],
        ["choose", *ON, "why=yes"],
        ["choose", *ON, "max_flash=5kB", "max_ram=40kB", "by=ram"],
        ["choose", *ON, "max_flash=1B", "max_ram=1kB", "max_decision=9s", "why=yes"],
        ["choose", *ON, "model=tree,bayes,lda", "margin=5"],
        ["choose", *ON, "unit=window"],
        ["choose", *ON, "batch=yes", "features=jung28"],
        ["choose", *ON, "by=fault_loss", "max_worst_fault=60"],
        ["choose", *ON, "by=fault_loss", "why=yes"],
        ["choose", *ON, "by=worst_person", "min_worst_tenth=30"],
        ["choose", "target=gesture+variant"],
        ["choose", "data=synth"],
        ["choose", *ON, "model=svm"],
    ],
    "choose_scenes": [
        ["choose", *ON, "scene=robot.toml"],
        ["choose", *ON, "scene=robot.toml", "why=yes"],
        ["choose", *ON, "scene=new.toml", "why=yes"],
        ["choose", "data=synth", "scene=toy"],
    ],
    "groups": [
        ["choose", "groups=yes", *ON],
        ["choose", "groups=yes", "data=synth"],
        ["choose", "groups=yes", *ON, *TREE],
        ["choose", "groups=yes", *ON, "batch=yes"],
    ],
    "report": [
        ["report", "max_flash=64kB", "min_worst_person=10", "paper=accuracy,macro_f1,flash"]
    ],
    "audit": [["audit", "model=mine.py:Batch"]],
    "check": [
        ["check", "update=yes", *PEOPLE, "model=tree,bayes", "features=jung28", "baseline=b.json"],
        ["check", "update=yes", *SYNTH, *TREE, "baseline=b.json"],
        ["check", "stored=yes", "baseline=b.json", "slower=99", "junit=check.xml"],
    ],
    "data": [
        ["data"],
        ["data", "show", "people", "where=subject != '4'", "target=variant"],
        [
            "data",
            "export",
            "synth",
            "o.csv",
            "subjects=1",
            "repetitions=1",
            "variants=normal",
            *RATE,
        ],
        ["data", "import", "table", "o.csv", "name=mine", *TABLE],
        ["data", "verify", "people"],
    ],
    "fit": [["fit", *LDA, "stopping=no", "out=rec"], ["predict", "rec", "three.csv", "out=p.csv"]],
}
STRESS = ["conditions", "faults", "half_margins", "learning", "slices"]
FILES = {  # golden files of what commands write, by the step that writes them
    "report": [
        "report/comparison.csv",
        "report/pairs.csv",
        "report/provenance.csv",
        "report/ranking.csv",
    ]
    + ["report/statistics.csv", "report/comparison.md", "report/comparison.tex"]
    + [
        "report/index.html",
        "report/streaming.csv",
        "report/stopping.csv",
        "report/paper.csv",
        "report/paper.tex",
        *(f"report/{name}.csv" for name in STRESS),
    ],
    "data": ["look/index.html"],
    "check": ["check.xml"],
    "fit": ["p.csv"],
}
LINES = {  # of scene files, each a mistake, by its name
    "a": "colour = 3",
    "b": "[budget]\nflash = 64",
    "c": '[budget]\nboard = "nano34ble"',
    "d": "[budget]\nshare = 0.5",
    "e": '[faults]\nnames = ["nois"]',
    "f": "[faults]\nseverity = 9",
    "i": "[people]\nworst_person = 101",
    "j": '[reactions]\ncalm = ["rub"]\nalert = ["rub"]',
    "k": "[costs]\ncalm = 3",
    "l": '[reactions]\ncalm = ["rub"]\n[costs]\ncalm = { calm = 3 }',
    "m": 'unlisted = "no"',
    "n": "budget = 3",
    "o": "by = ",
    "p": '[reactions]\ncalm = ["purr"]',
    "r": "[costs]\nsilence = -1",
}
WRONG = [  # commands that are refused
    ["rum"],
    ["run", "modle=svm"],
    ["run", "--model", "svm"],
    ["run", "svm"],
    ["run", "model=svn"],
    ["run", "model=nowhere.py:Mine"],
    ["run", "model=mine.py:Mine"],
    ["run", "features=jung55"],
    ["run", "data=nowhere"],
    ["run", "protocol=losso"],
    ["run", "nowhere.toml"],
    ["run", "grids.toml", "seed=1"],
    ["run", "robot.toml"],
    ["run", *PEOPLE, "dry=maybe"],
    ["run", *PEOPLE, "model.c=3"],
    ["run", *PEOPLE, "model.C=-1"],
    ["run", *PEOPLE, "where=variant=='loud'"],
    ["run", *PEOPLE, "target=mood"],
    ["run", "data=people", "jobs=0"],
    ["run", *PEOPLE, "jobs=2"],
    ["run", *PEOPLE, "seed=x"],
    ["run", *PEOPLE, "protocol=challenge", "protocol.seed=-1"],
    ["run", *PEOPLE, "model.repair=hope"],
    ["tune", *PEOPLE, "model=lda", "model.window=x"],
    ["tune", *PEOPLE, *TREE, "model.level=1,9", "trials=0"],
    ["tune", *PEOPLE, *TREE, "inner=0"],
    ["stress", *PEOPLE, *TREE, "faults=nois"],
    ["stress", *PEOPLE, *TREE, "train_subjects=0"],
    ["stress", *PEOPLE, *TREE, "train_subjects=9", "faults=none"],
    ["run", *PEOPLE, *TREE, "after=each", "hop_ms=-1"],
    ["run", *PEOPLE, *TREE, "after=each", "start=end"],
    ["choose", "max_flash=64"],
    ["choose", "by=price"],
    ["choose", "unit=frame"],
    ["choose", "margin=0"],
    ["choose", "jobs=2"],
    ["choose", "max_flsh=64kB"],
    ["choose", "data=people", "shots=1"],
    ["choose", *ON, "unit=window", "by=fault_loss"],
    ["tune", *PEOPLE, *TREE, "smallest=depth"],
    ["tune", *PEOPLE, *TREE, "smallest=level", "trials=5"],
    ["choose", "scene=nowhere.toml"],
    *(["choose", *ON, f"scene={name}.toml"] for name in LINES),
    ["report", "paper=f1"],
    ["report", "paper=flash"],
    ["report", "data=peple"],
    ["report", "model.C=8"],
    ["check", "error=0"],
    ["check", "stored=yes", "update=yes"],
    ["check", *PEOPLE, "baseline=b.json"],
    ["audit", "model=svm,nobody"],
    ["data", "sow"],
    ["data", "import", "table", "nowhere.csv", "name=x", "grid=8x8", "rate_hz=45"],
    ["data", "import", "table", "people.csv", "name=x", "grid=8x9", "rate_hz=45"],
    ["data", "import", "table", "people.csv", "name=x"],
    ["fit", *THREE[:1], "model=svm,rf"],
    ["runs", "delete=yes"],
    ["runs", "data=people", "delete=yes"],
    ["runs", "model=svm"],
    ["predict", "nowhere", "three.csv"],
]
