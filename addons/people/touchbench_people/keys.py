"""The command of this package, without anything heavy."""

from bench.grammar.options import OF_FILE, SHIP, TRUST_NOTE, Command, Option

ADAPT = Command(
    SHIP,
    "adapt a saved model to one person",
    "FILE has captures of one person in the format of bench data import table. With a column "
    "gesture, the model learns from the labels. Without it, the model adapts to differences "
    "between this person and the training subjects. MODEL does not change. reflex, lda, networks "
    "(their last layer) and model=adaptable can adapt. With labels, each capture is left out in "
    "turn: nothing is written, and the exit code is 1, if fewer of them are labelled right than "
    "before. Of a folder of bench build, it writes C again. bench run protocol=personal measures "
    f"the gain for new people. {TRUST_NOTE}",
    "bench adapt rec anna.csv out=rec_anna\nbench adapt robot anna.csv out=robot_anna",
    "MODEL FILE out=FOLDER [rate_hz=HZ] [skin=recorded] [anyway=yes]",
    module="touchbench_people.commands",
    options=(
        Option("out", "text", "", "folder for the adapted model; new or empty"),
        Option("rate_hz", "number", None, "frame rate of FILE in Hz; must equal the model's"),
        OF_FILE,
        Option("anyway", "yes", False, "yes: write it even if it is worse for this person"),
    ),
)
