"""The command ``bench fit``: one system is trained on all captures and saved, or a saved one adapted to a person."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.option import Option
from bench.options import (
    DATA,
    FEATURES,
    MODEL,
    SEED,
    START,
    TARGET,
    WHERE,
    Command,
    following,
    keys,
    parse,
    parse_words,
    settings,
    used,
)
from bench.words import Values, quoted

if TYPE_CHECKING:
    from bench.work.fit import Fitted

COMMAND = Command(
    START,
    "train one system on all captures and save it as an MLflow model",
    "Prints the address of the model in the store. Use it in mlflow.pyfunc.load_model, mlflow models serve, bench "
    "predict and all commands that take MODEL. Each key has one value. With MODEL FILE, "
    "adapts a saved model to one person, whose captures FILE has in the format of bench data import table. With a "
    "column gesture, the model learns from the labels. Without it, the model adapts to differences between this person "
    "and the training subjects. MODEL does not change. reflex, lda, networks (their last layer) and models with "
    "model.person= can adapt; bench run protocol=personal measures the gain.",
    "bench fit data=haart model=svm features=jung54 out=svm\nmlflow models serve -m svm --env-manager local\n"
    "bench fit svm anna.csv out=svm_anna",
    usage="[key=value ...]\nMODEL FILE out=FOLDER [rate_hz=HZ]",
    options=(
        DATA,
        WHERE,
        TARGET,
        MODEL,
        FEATURES,
        SEED,
        Option("stopping", "yes", True, "no: skip three extra fits for calibration and early decisions"),
        Option("out", "text", "", "folder for a copy of the model, or for the adapted one; new or empty"),
        Option("rate_hz", "number", None, "frame rate of FILE in Hz; must equal the model's"),
    ),
)


def command(arguments: list[str]) -> int:
    """Train one system on all captures and save it, or adapt a saved one to a person."""
    from bench.commands.printing import then
    from bench.work.stopping import NO_SAVING

    if arguments and "=" not in arguments[0]:
        return adapted(*parse_words(arguments, keys("fit"), 2))
    values = parse(arguments, keys("fit"))
    fitted, out = trained(values), values.get("out")
    print(fitted, *([out] if out else []), sep="\n")
    stopping = fitted.recogniser.stopping
    if stopping is not None and not stopping.saves:
        print(f"{NO_SAVING}: the model classifies whole captures")
    address = quoted(str(out or fitted.uri))
    if fitted.told:
        print(fitted.told)
    then(f"bench predict {address} new.csv", *following("fit", address))
    return 0


def trained(values: Values) -> Fitted:
    """Fit and save the system of some values."""
    from bench.plan.cells import cells
    from bench.work.fit import fit

    given, learner = settings("fit", values), None
    for key, one in used("fit").items():
        if given[key]:
            learner = one(values)
        elif unused := [other for other in values if other.partition(".")[0] in one.keys]:
            raise InputError(f"{key}=no: {unused[0]}= has no effect without; remove one of them")
    cell, *more = cells({k: v for k, v in values.items() if k.partition(".")[0] not in given})
    if more:
        raise InputError("bench fit saves one system; give one value of each key")
    return fit(cell, Path(given["out"]) if given["out"] else None, given["stopping"], learner)


def adapted(words: list[str], values: dict[str, str]) -> int:
    """Adapt a saved system to the captures of one person in a file, and save it."""
    from bench.commands.predict import read
    from bench.commands.printing import then
    from bench.scratch import new_folder
    from bench.work.fit import save_adapted

    if wrong := [key for key in values if key not in ("out", "rate_hz")]:
        raise InputError(f"{wrong[0]}= trains a system, and bench fit MODEL FILE adapts one; leave it out")
    model, recogniser, corpus = read("fit", words, values)
    if "out" not in values:
        raise InputError("bench fit MODEL FILE needs out=, the folder for the adapted model")
    out = new_folder(Path(values["out"]))
    if len(people := set(corpus.captures.get("subject", []))) > 1:
        raise InputError(
            f"the file has captures of {len(people)} subjects; a model adapts to one, so give captures of one subject"
        )
    labels = corpus.captures["gesture"].to_numpy() if "gesture" in corpus.captures else None
    seconds = save_adapted(model, recogniser, corpus, labels, out)
    how = "without labels" if labels is None else "with labels"
    print(f"{out}: adapted to {len(corpus)} captures {how} in {seconds:.2f} s")
    then(f"bench predict {quoted(str(out))} new.csv")
    return 0
