"""The command ``bench fit``: train one system on all captures and save it."""

from __future__ import annotations

from pathlib import Path

from bench.commands.printing import print_next_commands
from bench.errors import InputError
from bench.grammar.options import implementations_of_packages, next_of_packages, typed_settings
from bench.ground.typed import Values, quote_value
from bench.plan.grid import make_cells
from bench.running.fit import Fitted, fit
from bench.values.stopping import NO_SAVING


def command(values: Values) -> int:
    """Train one system on all captures, save it, and print where it is."""
    fitted, out = fit_from_values(values), values.get("out")
    print(fitted, *([out] if out else []), sep="\n")
    stopping = fitted.recogniser.stopping
    if stopping is not None and not stopping.saves:
        print(f"{NO_SAVING}: the model classifies whole captures")
    if fitted.note:
        print(fitted.note)
    address = quote_value(str(out or fitted.uri))
    lines, reasons = next_of_packages("fit", address, fitted.recogniser)
    if reasons:
        print(*reasons, sep="\n")
    print_next_commands(f"bench predict {address} new.csv", *lines)
    return 0


def fit_from_values(values: Values) -> Fitted:
    """Train and save the system of typed values."""
    settings, learner = typed_settings("fit", values), None
    for key, make_learner in implementations_of_packages("fit").items():
        if settings[key]:
            learner = make_learner(values)
        elif unused := [k for k in values if k.partition(".")[0] in make_learner.keys]:
            raise InputError(f"{key}=no: {unused[0]}= has no effect without; remove one of them")
    cells = make_cells({k: v for k, v in values.items() if k.partition(".")[0] not in settings})
    if len(cells) > 1:
        raise InputError("bench fit saves one system; give one value of each key")
    out = Path(settings["out"]) if settings["out"] else None
    return fit(cells[0], out, settings["stopping"], learner)
