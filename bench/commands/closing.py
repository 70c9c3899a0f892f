"""The last lines of commands that run folds: what was found, in a sentence, and what to type next."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

import numpy as np

from bench.commands.printing import best, contexts, say, then
from bench.errors import InputError
from bench.outcomes.advice import FIRST, SECOND, WHAT, is_first
from bench.outcomes.comparable import context_of
from bench.outcomes.scores import captures
from bench.outcomes.stopping import NO_SAVING, saves
from bench.outcomes.store import connect
from bench.plan.arguments import typed
from bench.plan.cells import cells
from bench.work.loop import Outcome
from models import contract

MOST = 3  # contexts that are told of
FIT = ("data", "where", "target", "model", "features", "seed")  # what bench fit asks for


def evaluated(outcomes: Sequence[Outcome]) -> None:
    """Of `bench run`, `bench tune` and `bench choose over=`: the most accurate system, and how to choose."""
    same = {one.run_id: folds for one in outcomes if (folds := _one_label(one))}
    if named := [f"{_system(one)} in {same[one.run_id]}" for one in outcomes if one.run_id in same]:
        more = f" and {len(named) - MOST} more systems" if len(named) > MOST else ""
        say(f"warning: every test capture of a fold gets one and the same label: {'; '.join(named[:MOST])}{more}")
    commands: dict[str, None] = {}
    for members in _contexts(outcomes):
        one = members[0]
        if len(members) == 1:
            found = f"{_system(one)} labels {_share(one)} correctly ({_interval(one)}).{_told(same, one)}"
            commands[typed("run", _on(one) | (SECOND if is_first(_typed(one)) else FIRST))] = None
        else:
            winners = [members[place] for place in best(members)]
            if not winners:
                continue
            found = f"Most accurate of {len(members)}: {' and '.join(map(_system, winners))}, {_share(winners[0])} "
            found += f"({_interval(winners[0])}).{_told(same, *winners)}"
        say(_where(one, outcomes) + found)
        commands[typed("choose", _tracked(one))] = None
    then(*commands)


def streamed(outcomes: Sequence[Outcome]) -> None:
    """Of `bench stream`: what deciding early costs, and how to choose a system that decides in time."""
    commands: dict[str, None] = {}
    for members in _contexts(outcomes):
        first = max(members, key=lambda o: o.metrics.get("adaptive_accuracy", 0.0))
        got = first.metrics
        if "adaptive_accuracy" in got and not saves(got):
            say(
                f"{_where(first, outcomes)}{_system(first)}: {NO_SAVING}; whole captures, {got['mean_ms']:.0f} ms, get "
                f"{100 * got['accuracy']:.1f} %."
            )
        elif "adaptive_accuracy" in got:
            say(
                f"{_where(first, outcomes)}{_system(first)} labels {100 * got['adaptive_accuracy']:.1f} % when it "
                f"decides early, after {got['adaptive_ms']:.0f} ms of touch on average; whole captures, "
                f"{got['mean_ms']:.0f} ms, get {100 * got['accuracy']:.1f} %."
            )
        if _typed(first).get("start", "onset") == "onset":  # others are not chosen among
            soon = {"max_decision": f"{_rounded_up(got['adaptive_ms'])}ms"} if saves(got) else {}
            commands[typed("choose", _tracked(first) | soon)] = None
    then(*(commands or ["bench report"]))


def stressed(outcomes: Sequence[Outcome]) -> None:
    """Of `bench stress`, before its table: who loses least, and to what."""
    for members in _contexts(outcomes):
        lost = {o.run_id: float(np.mean(list(_losses(o).values()))) for o in members if _losses(o)}
        if not lost:
            continue
        ranked = sorted((o for o in members if o.run_id in lost), key=lambda o: lost[o.run_id])
        least, most = ranked[0], ranked[-1]
        worst = max(_losses(least), key=_losses(least).__getitem__)
        said = f"{_system(least)} loses {100 * lost[least.run_id]:.1f} points on average over {len(_losses(least))} "
        said += f"faults, most to {worst.replace('_', ' ')} ({100 * _losses(least)[worst]:.1f})"
        if len(ranked) > 1:
            said += f"; {_system(most)} loses {100 * lost[most.run_id]:.1f}"
        say(f"{_where(least, outcomes)}{said}.")


def hardened(outcomes: Sequence[Outcome]) -> None:
    """Of `bench stress`, after its table: the command that trains a system on what it loses most to."""
    commands: dict[str, None] = {}
    for members in _contexts(outcomes):
        one = min(members, key=lambda o: float(np.mean(list(_losses(o).values()) or [0.0])))
        losses, arguments = _losses(one), _typed(one)
        worst = max(losses, key=losses.__getitem__, default="")
        if not worst or not arguments or "model.faults" in arguments or one.metrics["faults_trained"]:
            continue
        more = {k: v for k, v in arguments.items() if k not in ("faults", "train_subjects")} | {"model.faults": worst}
        try:
            cells(more)
        except InputError:  # a search takes no faults
            continue
        commands[typed("stress", more | {k: v for k, v in arguments.items() if k == "faults"})] = None
    then(*(commands or ["bench report"]))


def exported(outcomes: Sequence[Outcome]) -> None:
    """Of `bench chip`: the most accurate that fits, and how to choose among what was exported."""
    commands: dict[str, None] = {}
    for members in _contexts(outcomes):
        one = max(members, key=lambda o: o.metrics["accuracy"])
        got = one.metrics
        say(
            f"{_where(one, outcomes)}{_system(one)} in C labels {_share(one)} correctly, with "
            f"{got['chip_flash_bytes'] / 1000:.1f} kB of flash and {got['chip_ram_bytes'] / 1000:.1f} kB of RAM for "
            f"touch.c ({got['chip_program_ram_bytes'] / 1000:.1f} kB with main.c, the C library, heap and stack)."
        )
        flash = max(1, _rounded_up(got["chip_flash_bytes"] / 1000))
        commands[typed("choose", _tracked(one) | {"max_flash": f"{flash}kB", "by": "cycles"})] = None
    then(*commands)


def shipped(arguments: Mapping[str, str], command: str, unit: str) -> list[str]:
    """Commands that train the chosen system on all captures, and export it if it has C.

    Args:
        arguments: that made its run; empty where they cannot be typed.
        command: that made it.
        unit: in which it was chosen.
    """
    if not arguments or command not in ("run", "stream", "chip"):  # a search is not trained again
        return ["bench report"]
    asked = {k: v for k, v in arguments.items() if k.split(".")[0] in FIT}
    found = [typed("fit", asked | {"out": "chosen"})]
    try:
        exports = command == "chip" or all(has_c(cell.estimator()) for cell in cells(asked))
    except InputError:  # its file is gone
        exports = False
    if exports:
        bits = {"bits": "8"} if "8 bits" in unit else {}
        found.append(f"{typed('export chosen', {'out': 'chosen_c'} | bits)}")
    return found


def has_c(estimator: contract.System) -> bool:
    """Whether a system can be exported."""
    from bench.chip.tables import check

    try:
        check(estimator)
    except InputError:
        return False
    return True


def _contexts(outcomes: Sequence[Outcome]) -> list[list[Outcome]]:
    return [[outcomes[p] for p in places] for places in contexts(outcomes)[:MOST]]


def _where(one: Outcome, among: Sequence[Outcome]) -> str:
    """What a sentence is about, where there are several contexts."""
    return f"{', '.join(context_of(one.tags))}: " if len(contexts(among)) > 1 else ""


def _system(outcome: Outcome) -> str:
    return outcome.plan.cell.system()


def _one_label(outcome: Outcome) -> str:
    """In how many folds every test capture gets one label, though they are of several classes; empty for none."""
    found = 0
    for result in outcome.results:
        labelled = captures(result.table)
        found += labelled["true"].nunique() > 1 and labelled["predicted"].nunique() == 1
    return f"{found} of {len(outcome.results)} folds" if found else ""


def _told(same: Mapping[str, str], *among: Outcome) -> str:
    """What must be said of systems that are named as found, where they are among the ``same``."""
    named = [
        f"{_system(one)} gives all captures one label in {same[one.run_id]}" for one in among if one.run_id in same
    ]
    return f" But {' and '.join(named)}: it has learned too little there." if named else ""


def _share(outcome: Outcome) -> str:
    kind = "synthetic " if outcome.plan.corpus.synthetic else ""
    return f"{100 * outcome.metrics['accuracy']:.1f} % of {outcome.metrics['captures']:.0f} {kind}captures"


def _interval(outcome: Outcome) -> str:
    got = outcome.metrics
    if "accuracy_low" not in got:
        return "one subject: nobody knows how the next one differs"
    low, high = 100 * got["accuracy_low"], 100 * got["accuracy_high"]
    return f"95 % interval {low:.1f} to {high:.1f} over {got['subjects']:.0f} subjects"


def _losses(outcome: Outcome) -> dict[str, float]:
    return {k.removeprefix("loss."): v for k, v in outcome.metrics.items() if k.startswith("loss.")}


def _typed(outcome: Outcome) -> dict[str, str]:
    return json.loads(outcome.tags.get("touchbench.arguments", "{}"))


def _on(outcome: Outcome) -> dict[str, str]:
    """Arguments for the same captures and protocol."""
    return {k: v for k, v in _typed(outcome).items() if k.split(".")[0] in WHAT}


def _tracked(outcome: Outcome) -> dict[str, str]:
    """The same where runs are sought, which `bench choose` does without the parameters of generated captures."""
    on = {k: v for k, v in _on(outcome).items() if not k.startswith("data.")}
    parts = f"params.`data` = '{on['data']}' and params.`where` != 'all'"
    if "where" not in on and connect().runs(f"tags.`touchbench.kind` = 'cell' and {parts}"):
        on = {"data": on.pop("data"), "where": "all", **on}
    return on


def _rounded_up(number: float) -> int:
    """To two digits."""
    step = 10 ** max(0, math.floor(math.log10(max(number, 1))) - 1)
    return math.ceil(number / step) * step
