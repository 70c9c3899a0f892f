"""The last layer of a network, relearnt for one person from the output of the layers before."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import numpy as np
import torch
from torch import nn

from bench.models.nets.training import Samples, moved
from touchbench_people.adaptation import relearnt as of_layer


def relearnt(
    net: nn.Module,
    samples: Samples,
    target: np.ndarray,
    batch: int,
    forward: Callable[[nn.Module, object], object],
) -> nn.Module:
    """A network whose last linear layer has learnt some captures of a person, too (`adaptation.relearnt`).

    Args:
        net: fitted; it stays as it is.
        samples: pieces of the captures.
        target: class of each capture [captures].
        batch: samples at a time.
        forward: forward pass of its system on a batch.
    """
    adapted = deepcopy(net).eval()
    layer = [module for module in adapted.modules() if isinstance(module, nn.Linear)][-1]
    inputs, row = _inputs(adapted, layer, samples, batch, forward)
    capture = samples.capture[row]
    old = np.column_stack(
        [parameter.detach().cpu().numpy() for parameter in (layer.weight, layer.bias)]
    )
    new = of_layer(old, inputs, target[capture], capture)
    with torch.no_grad():
        layer.weight.copy_(torch.from_numpy(new[:, :-1]))
        layer.bias.copy_(torch.from_numpy(new[:, -1]))
    return adapted


def _inputs(
    net: nn.Module,
    layer: nn.Linear,
    samples: Samples,
    batch: int,
    forward: Callable[[nn.Module, object], object],
) -> tuple[np.ndarray, np.ndarray]:
    """What the layer is given for every decision, float64 [decisions, inputs], and of which sample each is."""
    seen: list[torch.Tensor] = []
    hook = layer.register_forward_pre_hook(
        lambda module, args: seen.append(args[0].flatten(0, -2).float().cpu())
    )
    device = next(net.parameters()).device
    try:
        with torch.inference_mode():
            for first in range(0, len(samples), batch):
                forward(
                    net,
                    moved(
                        samples.batch(np.arange(first, min(first + batch, len(samples)))), device
                    ),
                )
    finally:
        hook.remove()
    return torch.cat(seen).numpy().astype(np.float64), np.repeat(
        np.arange(len(samples)), samples.steps
    )
