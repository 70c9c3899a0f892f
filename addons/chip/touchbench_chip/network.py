"""The network of Hughes et al. 2017 as tables; the outputs of its filters are the features."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from bench.contract import System
from bench.errors import InputError
from bench.models.nets.hughes2017 import Hughes2017CNN
from bench.models.quantised import quantise_rows
from touchbench_chip.classifiers import EXPORTABLE, SINGLE, Decider


def check_network(system: System) -> None:
    """Refuse any other system."""
    if type(system) is not Hughes2017CNN:
        raise InputError(f"{type(system).__name__} has no C; use hughes2017_cnn, {EXPORTABLE}")


def convert_filters(
    system: Hughes2017CNN, grid: tuple[int, int], bits: int
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Sizes by name, and the weights of both layers of filters.

    Pools take the maximum of two times, and of two rows and columns if there are two. Biases and
    steps have 32 bits.
    """
    net: Any = system.net_
    first, pool1, _, second, pool2 = net[:5]
    window, hop = system.design_[1:3]
    frames, *kernel1 = first.kernel_size
    maps = [(n - k + 1) // p for n, k, p in zip(grid, kernel1, pool1.kernel_size[1:], strict=True)]
    times = (window - frames + 1) // 2  # of pooled maps in a window
    # sums that no pool of the second layer reaches are not computed
    sums = [
        (n - k + 1) // p * p
        for n, k, p in zip((times, *maps), second.kernel_size, pool2.kernel_size, strict=True)
    ]
    used = 2 * (sums[0] + second.kernel_size[0] - 1)  # times of the first layer in a window
    defines = {
        "CONVOLVED": 1,
        "WINDOW": window,
        "HOP": hop,
        "OPEN": (window - frames) // hop + 1,  # windows that are kept at a time
        "USED": used,
        "FILTERS1": first.out_channels,
        **_name_sizes("KERNEL1", first.kernel_size),
        **_name_sizes("POOL1", pool1.kernel_size),
        "MAP_COLS": maps[1],
        "MAP": maps[0] * maps[1],
        "FILTERS2": second.out_channels,
        **_name_sizes("KERNEL2", second.kernel_size),
        **_name_sizes("POOL2", pool2.kernel_size),
        **_name_sizes("SUM", sums),
    }
    return defines, _layer_tables("filters1", first, bits) | _layer_tables("filters2", second, bits)


def convert_head(system: Hughes2017CNN, bits: int) -> Decider:
    """Convert the two layers of units after the filters."""
    net: Any = system.net_
    hidden, last = (part for part in net if isinstance(part, torch.nn.Linear))
    body = """    layer({hidden}, {hidden_step}, {hidden_bias}, {UNITS}, FEATURES, t->features, \
t->units);
    for (int i = 0; i < {UNITS}; i++)
        t->units[i] = fmaxf(t->units[i], 0);
    layer({last}, {last_step}, {last_bias}, {CLASSES}, {UNITS}, t->units, proba);
    softmax(proba, {CLASSES});
"""
    units = hidden.out_features
    arrays = _layer_tables("hidden", hidden, bits) | _layer_tables("last", last, bits)
    return Decider(arrays, body, "two layers of units", {"units": units}, {"UNITS": str(units)})


def _name_sizes(name: str, sizes: tuple[int, ...] | list[int]) -> dict[str, int]:
    return {f"{name}_{side}": n for side, n in zip(("FRAMES", "ROWS", "COLS"), sizes, strict=True)}


def _layer_tables(name: str, module: Any, bits: int) -> dict[str, np.ndarray]:
    weights, bias = (p.detach().cpu().numpy() for p in (module.weight, module.bias))
    integers, step = quantise_rows(weights.reshape(len(weights), -1), bits)
    return {name: integers, f"{name}_step": step, f"{name}_bias": bias.astype(SINGLE)}
