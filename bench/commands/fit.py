"""The commands ``bench fit``, ``bench predict`` and ``bench adapt``: a system is saved, used and adapted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bench.arguments import parse, parse_words, settings
from bench.commands.printing import then, unwritable
from bench.corpora.read.table import read_unlabelled
from bench.errors import InputError
from bench.options import keys, used
from bench.plan.cells import cells
from bench.scratch import new_folder, replacing
from bench.table import write_sheet
from bench.words import Values, quoted
from bench.work.stopping import NO_SAVING

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.work.fit import Fitted
    from bench.work.saved import Recogniser


def fit(arguments: list[str]) -> int:
    """Train one system on all captures and save it.

    Raises:
        InputError: something in the arguments or the data cannot be used.
    """
    fitted, out = trained(parse(arguments, keys("fit")))
    print(fitted, *([out] if out else []), sep="\n")
    stopping = fitted.recogniser.stopping
    if stopping is not None and not stopping.saves:
        print(f"{NO_SAVING}: the model classifies whole captures")
    address = quoted(str(out or fitted.uri))
    watcher = fitted.recogniser.watcher
    if fitted.detector:
        print(fitted.detector)
    without = watcher is not None and watcher.in_c(fitted.recogniser.classes, fitted.recogniser.rate_hz) is None
    then(f"bench predict {address} new.csv", *([] if without else [f"bench export {address} out=in_c"]))
    return 0


def trained(values: Values) -> tuple[Fitted, Path | None]:
    """Fit and save the system of some values; also return the folder of ``out=``.

    Raises:
        InputError: something in the values or the data cannot be used, or they name several systems.
    """
    from bench.corpora.library import holds_recordings
    from bench.work.fit import fit

    given, watching = settings("fit", values), None
    for key, learner in used("fit").items():
        if given[key]:
            watching = learner(values)
        elif unused := [other for other in values if other.partition(".")[0] in learner.keys]:
            raise InputError(f"{key}=no: nothing watches, so {unused[0]}= has no effect; remove one of them")
    cell, *more = cells({k: v for k, v in values.items() if k.partition(".")[0] not in given})
    if more:
        raise InputError("bench fit saves one system; give one value of each key")
    out = Path(given["out"]) if given["out"] else None
    if holds_recordings(cell.data):
        cell = cell.of_recordings()
    return fit(cell, out, given["stopping"], watching), out


def predict(arguments: list[str]) -> int:
    """Label the captures of a file.

    Raises:
        InputError: something in the arguments or the file cannot be used.
    """
    model, recogniser, corpus, values = _read("predict", arguments)
    table = recogniser.label(corpus)
    table.insert(0, "capture", corpus.captures["capture"])
    if "out" not in values:
        print(table.to_csv(index=False, float_format="%.6g"), end="")
        return 0
    out = Path(values["out"])
    with unwritable(out), replacing(out) as beside:
        write_sheet(table, beside, "%.6g")
    counts = ", ".join(f"{count} {label}" for label, count in table["label"].value_counts().items())
    print(f"{out}: {len(table)} captures classified: {counts}")
    then(f"sensor | bench live {quoted(model)}")
    return 0


def adapt(arguments: list[str]) -> int:
    """Adapt a saved system to the captures of one person in a file, and save it.

    Raises:
        InputError: something in the arguments or the file cannot be used, or the system cannot adapt.
    """
    from bench.work.fit import save_adapted

    model, recogniser, corpus, values = _read("adapt", arguments)
    if "out" not in values:
        raise InputError("bench adapt needs out=, the folder for the adapted model")
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


def _read(command: str, arguments: list[str]) -> tuple[str, Recogniser, Corpus, dict[str, str]]:
    """The model that a command names and itself, the captures, and the options.

    Raises:
        InputError: something in the arguments or the file cannot be used.
    """
    words, values = parse_words(arguments, keys(command), 2)
    if len(words) < 2:
        raise InputError(f"give a model and a file: bench {command} MODEL FILE; see bench {command} --help")
    from bench.work.saved import load

    rate = settings(command, values)["rate_hz"]
    recogniser = load(words[0])
    if rate is not None:
        recogniser.check_rate(rate)
    corpus = read_unlabelled(Path(words[1]), recogniser.rate_hz, recogniser.grid, recogniser.full_scale)
    return words[0], recogniser, corpus, values
