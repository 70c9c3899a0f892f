"""What the leaderboard adds to touchbench: as entry points ``touchbench.<group>`` of a package would."""

from bench.options import Command, Option

ADDS = {
    "commands": {"submit": "bench.board.room:SUBMIT", "leaderboard": "bench.board.room:LEADERBOARD"},
    "references": {"touchbench": "bench.board.reference_rows:Shipped"},
}
SUBMIT = Command(
    "publish",
    "write a stored run as a submission to a frozen task",
    "Writes predictions.parquet (one row per capture or event, no frames) and submission.json (origin of the "
    "labels). Runs nothing: it uses the stored run with these values. Data, subset, protocol and unit must equal "
    "the task's. "
    "Tasks of bench run are haart-loso-v1, haart-challenge-v1, haart-personal-v1, cuddlebot-loso-v1 and "
    "cost-loso-v1. haart-early-v1 is a task of bench stream, haart-faults-v1 of bench stress, haart-watch-v1 of "
    "bench watch.",
    "bench run data=haart protocol=loso model=svm features=jung54\n"
    'bench submit task=haart-loso-v1 model=svm features=jung54 who="A. Name, Lab" out=submissions/my-svm',
    "task=NAME who=NAME out=FOLDER model=NAME [key=value ...]",
    "bench.board.commands",
    "model features seed batch",
    (
        Option("task", "submit", "text", "", "haart-loso-v1, haart-early-v1 or another task of docs/notes/tasks.md"),
        Option("who", "submit", "text", "", 'author of the result, such as who="A. Name, Lab"'),
        Option("run", "submit", "text", "", "run id instead of model=, such as a run of bench tune"),
        Option("out", "submit", "text", "", "folder for the submission; new or empty"),
    ),
)
LEADERBOARD = Command(
    "publish",
    "score submissions again and write one page",
    "Computes every score again from the submitted predictions. Writes one page with a table per frozen task; "
    "reference results of touchbench are included. FOLDER is a submission or contains submissions. Invalid "
    "submissions are left out and named; exit code 1. Tasks on CoST need the imported corpus. rerun= needs the "
    "corpus of the task. If all labels are equal, leaderboard-verified.json in the working folder marks the "
    "submission.",
    "bench leaderboard submissions out=leaderboard.html\nbench leaderboard rerun=my-svm",
    "[FOLDER ...] [key=value ...]",
    "bench.board.commands",
    options=(
        Option(
            "rerun", "leaderboard", "text", "", "submission whose command is repeated and whose labels are verified"
        ),
        Option("out", "leaderboard", "text", "leaderboard.html", "file of the page"),
    ),
)
