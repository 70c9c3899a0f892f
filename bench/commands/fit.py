"""The command ``bench fit``: one system is trained on all captures and saved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import (
    FIT_OPTIONS,
    START,
    Command,
    Option,
    key_options,
    next_of_packages,
    parse_arguments,
    typed_settings,
    workers_of_packages,
)
from bench.ground.typed import Values, quote_value

if TYPE_CHECKING:
    from bench.running.fit import Fitted

COMMAND = Command(
    START,
    "train one system on all captures and save it as an MLflow model",
    "Prints the address of the model in the store. Use it in mlflow.pyfunc.load_model, mlflow models serve, bench "
    "predict and all commands that take MODEL. Each key has one value.",
    "bench fit data=haart model=svm features=jung54 out=svm\nmlflow models serve -m svm --env-manager local",
    options=(
        *FIT_OPTIONS,
        Option(
            "stopping", "yes", True, "no: skip three extra fits for calibration and early decisions"
        ),
        Option("out", "text", "", "folder for a copy of the model; new or empty"),
    ),
)


def command(arguments: list[str]) -> int:
    """Train one system on all captures and save it."""
    from bench.commands.printing import print_next_commands
    from bench.values.stopping import NO_SAVING

    values = parse_arguments(arguments, key_options("fit"))
    fitted, out = fit_from_values(values), values.get("out")
    print(fitted, *([out] if out else []), sep="\n")
    stopping = fitted.recogniser.stopping
    if stopping is not None and not stopping.saves:
        print(f"{NO_SAVING}: the model classifies whole captures")
    address = quote_value(str(out or fitted.uri))
    if fitted.told:
        print(fitted.told)
    lines, reasons = next_of_packages("fit", address, fitted.recogniser)
    if reasons:
        print(*reasons, sep="\n")
    print_next_commands(f"bench predict {address} new.csv", *lines)
    return 0


def fit_from_values(values: Values) -> Fitted:
    """Fit and save the system of some values."""
    from bench.plan.grid import make_cells
    from bench.running.fit import fit

    given, learner = typed_settings("fit", values), None
    for key, one in workers_of_packages("fit").items():
        if given[key]:
            learner = one(values)
        elif unused := [other for other in values if other.partition(".")[0] in one.keys]:
            raise InputError(f"{key}=no: {unused[0]}= has no effect without; remove one of them")
    cell, *more = make_cells({k: v for k, v in values.items() if k.partition(".")[0] not in given})
    if more:
        raise InputError("bench fit saves one system; give one value of each key")
    return fit(cell, Path(given["out"]) if given["out"] else None, given["stopping"], learner)
