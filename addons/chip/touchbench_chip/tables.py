"""Contents of a fitted system's C: sizes, steps, windows, stopping rule, classifiers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import NEGATIVE_SHARE, SATURATED_ONE_IN
from bench.corpora.windows import Step, Windows
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.features.touch import (
    LAGS_S,
    SEGMENT_S,
    SIGNALS,
    SPECTRAL_SIGNALS,
    SPECTRUM_POINTS,
    TouchFeatures,
)
from bench.features.touch_profiles import (
    COVARIANCE_SCALE,
    PROFILE_PAIRS,
    TouchProfiles,
    pair_frames,
)
from bench.models.recipe import Recipe
from bench.models.reflex import Reflex
from bench.models.steps import SETTLED_S, Repair, Scale
from touchbench_chip.classifiers import EXPORTABLE, Decider, convert_classifier, format_float, has_c
from touchbench_chip.skin import SkinContents, convert_design

if TYPE_CHECKING:
    from bench.running.replay import Stopping
    from bench.running.saved import Recogniser

BITS8, BITS16, BITS32 = 2**8, 2**16, 2**32
# Thousands of instructions, counted in QEMU: of a frame of a signal (all its statistics, or only
# fetched), of a term of a spectrum or covariance, of a taxel that is put in order, of a weight.
DESCRIBED, FETCHED, TERM, COVARIED, SPREAD, WEIGHED = 0.36, 0.1, 0.0135, 0.0178, 0.3, 0.014
LONGEST_TOUCH = 2**30  # frames of a system on windows, whose memory does not grow


@dataclass
class CContents:
    """Contents of the exported C of a fitted system.

    Attributes:
        defines: macros of the preprocessor, by name.
        deciders: classifiers by the name of their function: ``decide``, ``decide_early`` for
            captures shorter than a window, and those of an endless stream.
        features: fixed code that computes the features: ``touch``, ``jung28`` or ``convolved``.
        classes: names of the classes.
        arrays: learnt numbers of the features, by name.
        points: operating points of the watcher.
        watch: C of the watcher; None without.
        skin: C of the design of the skin; None without.
    """

    defines: dict[str, str]
    deciders: dict[str, Decider]
    features: str
    classes: list[str]
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    points: tuple[tuple[float, float, float, float], ...] = ()
    watch: Any = None
    skin: SkinContents | None = None


def check_exportable(estimator: Any) -> bool:
    """Refuse an unfitted system that has no C; return whether its C can watch a stream."""
    if isinstance(estimator, Reflex):
        return True
    system, steps = _unwrap_recipe(estimator, "system")
    if not isinstance(system, Pipeline):
        from touchbench_chip import network  # PyTorch, which other systems do without

        network.check_network(system)
        return False
    name, _ = _find_feature_code(system, steps)
    if not has_c(system.steps[-1][1]):
        raise InputError(f"{type(system.steps[-1][1]).__name__} has no C; use {EXPORTABLE}")
    return name == "touch"


def collect_contents(recogniser: Recogniser, bits: int) -> CContents:
    """Collect the contents of a saved system's C, with 32 or 8 bits per learnt weight."""
    estimator: Any = recogniser.estimator
    early_system, early_steps = None, []
    if isinstance(estimator, Reflex):
        early_system, early_steps = _unwrap_recipe(estimator.early_)
        estimator = estimator.whole_
    system, steps = _unwrap_recipe(estimator)
    decider = system.steps[-1][1] if isinstance(system, Pipeline) else system
    if (scales := getattr(decider, "scales_", None)) and scales.changes_tested:
        raise InputError(
            "the model has a scale for each of several corpora, and C has one sensor; fit it on "
            "data= of one and give the others as also="
        )
    arrays: dict[str, np.ndarray] = {}
    if isinstance(system, Pipeline):
        name, windows = _find_feature_code(system, steps)
        width = len(system.steps[0][1].get_feature_names_out())
        longest = LONGEST_TOUCH if name == "touch" else recogniser.longest
        early_windows = next((step for step in early_steps if isinstance(step, Windows)), None)
        sizes = _window_defines(windows, early_windows, recogniser.rate_hz)
        has_profiles = isinstance(system.steps[0][1], TouchProfiles)
        sizes |= _profile_defines(has_profiles, recogniser.rate_hz)
        deciders = {"decide": convert_classifier(system, width, bits)}
        if early_system is not None:
            deciders["decide_early"] = convert_classifier(early_system, width, bits)
    else:
        from touchbench_chip import network  # PyTorch, which other systems do without

        network.check_network(system)
        name, longest = "convolved", LONGEST_TOUCH
        sizes, arrays = network.convert_filters(system, recogniser.grid, bits)
        deciders = {"decide": network.convert_head(system, bits)}
        width = deciders["decide"].arrays["hidden"].shape[1]
    arrays |= {"usual": np.exp(recogniser.usual).astype(np.float32)}  # of a capture as a whole
    defines = _size_defines(recogniser, width, longest)
    defines |= _step_defines(steps, recogniser.rate_hz) | sizes
    defines |= _stopping_defines(recogniser.stopping) | {"WATCH": 0, "STEPPED": 0}
    points: tuple[tuple[float, float, float, float], ...] = ()
    watch = None
    if name == "touch" and (watcher := recogniser.watcher) is not None:
        watch = watcher.in_c(recogniser.classes, recogniser.rate_hz)
        if watch is None:
            raise InputError(
                f"detector={watcher.chosen['detector']} has no C; use frames or threshold in "
                "bench fit detector=, or watch=no"
            )
        step = 0 if any(map(yields_fractions, steps)) else recogniser.step
        defines |= _watch_defines(watch, recogniser, sizes, step)
        points = watcher.points
        arrays |= watch.arrays | {"levels": np.array([level for level, *_ in points], np.float32)}
        for function, part in watch.deciders.items():
            decider = convert_classifier(part, width, bits)
            profiled = recogniser.grid if has_profiles else ()
            costs = _step_costs(recogniser.grid, profiled, watch.part, sizes["SEGMENT"], decider)
            deciders[function] = replace(
                decider, classes=str(len(part.classes_)), defines=decider.defines | costs
            )
    for function, decider in deciders.items():
        prefix = function.upper()
        defines |= {f"{prefix}_{name}": value for name, value in decider.defines.items()}
    skin = convert_design(recogniser)
    if skin:
        defines, arrays = defines | skin.defines, arrays | skin.arrays
    defines = {name: str(value) for name, value in defines.items()}
    return CContents(defines, deciders, name, recogniser.classes, arrays, points, watch, skin)


def _size_defines(recogniser: Recogniser, width: int, longest: int) -> dict[str, Any]:
    rows, cols = recogniser.grid
    return {
        "ROWS": rows,
        "COLS": cols,
        "TAXELS": rows * cols,
        "CLASSES": len(recogniser.classes),
        "FEATURES": width,
        "RATE_HZ": format_float(recogniser.rate_hz),
        "FULL_SCALE": format_float(recogniser.full_scale),
        "NEGATIVE": format_float(NEGATIVE_SHARE * recogniser.full_scale),
        "CHECKED": min(recogniser.longest, 2 * round(recogniser.rate_hz) + 9),  # by make check
        "LONGEST": longest,
    }


def _unwrap_recipe(estimator: Any, attribute: str = "system_") -> tuple[Any, list[Step]]:
    """The system inside a recipe, from its ``attribute``, and the steps of the recipe."""
    if contract.abstention_label(estimator) is not None:
        raise InputError(
            "a system that abstains has no C, which always names a gesture; remove abstains"
        )
    recipe = estimator if isinstance(estimator, Recipe) else None
    system = getattr(recipe, attribute) if recipe else estimator
    if isinstance(system, Reflex):
        raise InputError("reflex with model.scale= or other steps has no C; leave these steps out")
    steps = recipe.prediction_steps() if recipe else []
    if any(isinstance(step, Scale) and step.kind == "log" for step in steps):
        raise InputError("model.scale=log has no C; fit with model.scale=peak or without")
    return system, steps


def _find_feature_code(system: Pipeline, steps: list[Step]) -> tuple[str, Windows | None]:
    """The name of the C that computes the features, and its windows."""
    features = system.steps[0][1]
    windows = next((step for step in steps if isinstance(step, Windows)), None)
    if isinstance(features, TouchFeatures):
        if windows is not None and windows.hop not in (0, windows.seconds / 2):
            raise InputError(
                f"model.hop={windows.hop:g} has no C; leave model.hop= out, which sets it to half "
                "a window"
            )
        if windows is None:
            raise InputError("touch on whole captures has no C; fit with model.window=1")
        return "touch", windows
    if isinstance(features, Jung28) and (features.area, features.peaks) == ("frame", "crossings"):
        if windows is not None:
            raise InputError("jung28 on windows has no C yet; leave model.window= out")
        return "jung28", None
    raise InputError(
        f"{type(features).__name__} has no C; use touch with model.window=, or jung28 on whole "
        "captures"
    )


def _step_defines(steps: list[Step], rate_hz: float) -> dict[str, Any]:
    kinds = {kind for step in steps if isinstance(step, Repair) for kind in step.kinds}
    return {
        "SETTLED": max(2, int(np.ceil(SETTLED_S * rate_hz))),
        "REPAIR_STUCK": int("stuck" in kinds),
        "REPAIR_DEAD": int("dead" in kinds),
        "REPAIR_NOISE": int("noise" in kinds),
        "REPAIR_OFFSET": int("offset" in kinds),
        "SCALE_PEAK": int(any(isinstance(step, Scale) for step in steps)),
    }


def _window_defines(
    windows: Windows | None, early_windows: Windows | None, rate_hz: float
) -> dict[str, Any]:
    """Lengths of windows in frames, and of shorter early ones; each begins amid the previous."""
    if windows is None:
        return {"WINDOW": 0, "EARLY": 0}
    window, hop = windows.window_and_hop(rate_hz)
    early_window, early_hop = early_windows.window_and_hop(rate_hz) if early_windows else (0, 0)
    for frames, step in ((window, hop), (early_window, early_hop)):
        if step != (frames + 1) // 2:
            raise InputError(
                f"windows of {frames} frames every {step} have no C; leave model.hop= out"
            )
    segment = max(2, round(SEGMENT_S * rate_hz))
    lags = ", ".join(str(max(1, round(s * rate_hz))) for s in LAGS_S)
    return {
        "WINDOW": window,
        "RING": window,
        "HOP": hop,
        "EARLY": early_window,
        "EARLY_HOP": early_hop,
        "SEGMENT": segment,
        "MOST_POINTS": max(SPECTRUM_POINTS, min(window, segment)),
        "LAG_FRAMES": f"{{{lags}}}",
    }


def _profile_defines(has_profiles: bool, rate_hz: float) -> dict[str, Any]:
    """Lags and shifts of the covariances of profiles, if there are any."""
    defines: dict[str, Any] = {"PROFILES": int(has_profiles)}
    if has_profiles:
        columns = {"FRAMES": pair_frames(rate_hz), "SHIFTS": [shift for _, shift in PROFILE_PAIRS]}
        defines |= {"PAIRS": len(PROFILE_PAIRS), "COVARIANCE_SCALE": format_float(COVARIANCE_SCALE)}
        for name, values in columns.items():
            defines[f"PAIR_{name}"] = f"{{{', '.join(map(str, values))}}}"
    return defines


def yields_fractions(step: Step) -> bool:
    """Return True if a step can yield readings between those of the sensor."""
    return isinstance(step, Scale) or (isinstance(step, Repair) and step.kinds != ("offset",))


def _watch_defines(
    watch: Any, recogniser: Recogniser, sizes: dict[str, Any], step: float
) -> dict[str, Any]:
    """Constants of a watcher, whose frames share the ring of signals with captures.

    Readings are multiples of ``step``, so that their sums are exact in few bits; 0 if they are not.
    """
    steps = recogniser.full_scale / step if step else np.inf
    longest = max(watch.part, sizes["HOP"], sizes["EARLY_HOP"])
    ring = max(sizes["WINDOW"], watch.frames)
    settled = int(np.ceil(SETTLED_S * recogniser.rate_hz))
    defines: dict[str, Any] = {
        "RING": ring,
        "MOST_POINTS": max(SPECTRUM_POINTS, min(ring, sizes["SEGMENT"])),
        "WATCH": 1,
        "TURN": ring * -(-max(ring, settled) // ring),
        "SATURATED": -(-recogniser.grid[0] * recogniser.grid[1] // SATURATED_ONE_IN),
        "LEVEL": format_float(watch.level),
        "MOST_LOST": int(recogniser.rate_hz),
        "STEPPED": int(longest * steps**2 < BITS32),
        "STEPS": format_float(min(steps, BITS16)),
        "SUM": "uint16_t" if longest * steps < BITS16 else "uint32_t",
        "MOST": "uint8_t" if steps < BITS8 else "uint16_t",
    }
    for _, group in watch.constants:
        for name, value in group.items():
            assert name not in defines, f"two constants of the watch are called {name}"
            defines[name] = format_float(value) if isinstance(value, float) else value
    return defines


def _step_costs(
    grid: tuple[int, int], profiled: tuple[int, ...], part: int, segment: int, decider: Decider
) -> dict[str, str]:
    """Estimate the steps to a decision, in thousands of instructions: features, classifier.

    Args:
        grid: rows and columns.
        profiled: lines of each profile that has covariances.
        part: most frames that features describe.
        segment: frames of a segment of spectra.
        decider: the classifier.
    """
    length = min(part, segment)
    segments = 1 + (part - length) // max(1, length // 2)
    terms = segments * length * (max(length, SPECTRUM_POINTS) // 2)
    visits_all = "nodes" not in decider.arrays  # of a tree, a path
    weights = sum(values.size for values in decider.arrays.values()) * visits_all
    spectra = [FETCHED * part + TERM * terms] * len(SPECTRAL_SIGNALS)
    steps = [DESCRIBED * part] * len(SIGNALS) + spectra
    steps += [SPREAD * grid[0] * grid[1]] * 3
    for lines in profiled:  # a third in each step
        steps += [COVARIED * len(PROFILE_PAIRS) * part * lines / 3] * 3
    steps += [WEIGHED * weights]
    costs = [max(1, round(step)) for step in steps]
    return {"COSTS": f"{{{', '.join(map(str, costs))}}}", "COST": str(sum(costs))}


def _stopping_defines(stopping: Stopping | None) -> dict[str, Any]:
    if stopping is None:
        return {"STOPPING": 0, "CALIBRATED": 0}
    heat = stopping.calibration
    defines: dict[str, Any] = {"STOPPING": int(stopping.saves)}
    if stopping.saves:
        defines["THRESHOLD"] = format_float(stopping.threshold)
        defines["WAITING"] = "{" + ", ".join(map(format_float, stopping.waiting.weights)) + "}"
    return defines | {
        "CALIBRATED": 1,
        "FIRST_MS": format_float(heat.first_ms),
        "LAST_MS": format_float(heat.last_ms),
        "FIRST_HEAT": format_float(heat.first),
        "LAST_HEAT": format_float(heat.last),
    }
