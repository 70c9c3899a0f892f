"""The last layer of a network, trained again with some captures of a person."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax

if TYPE_CHECKING:
    from torch import nn

    from bench.models.nets.training import Samples
    from bench.models.nets.window import WindowNet

STIFFNESS = 0.3  # of the old weights
MAX_ITERATIONS = 200


def relearn_layer(
    old: np.ndarray, inputs: np.ndarray, codes: np.ndarray, captures: np.ndarray
) -> np.ndarray:
    """Weights of a linear layer that also fit some captures of a person [classes, inputs + 1].

    They minimise the cross-entropy of the captures, a mean over the rows of each, plus the squared
    distance from the old weights times half of `STIFFNESS` times the mean square length of a row.

    Args:
        old: weights, and the intercept as the last column [classes, inputs + 1].
        inputs: inputs of the layer [rows, inputs].
        codes: class of each row.
        captures: capture of each row, numbered from 0.
    """
    inputs = np.column_stack([inputs, np.ones(len(inputs))]).astype(np.float64)
    row_weight = (1 / np.bincount(captures)[captures])[:, None]
    target = np.eye(len(old))[codes]
    stiffness = STIFFNESS * np.mean((inputs**2).sum(axis=1))

    def loss_and_gradient(flat: np.ndarray) -> tuple[float, np.ndarray]:
        change = flat.reshape(old.shape) - old
        logits = inputs @ (change + old).T
        error = (softmax(logits, axis=1) - target) * row_weight
        cross_entropy = -(target * log_softmax(logits, axis=1) * row_weight).sum()
        loss = cross_entropy + stiffness / 2 * (change**2).sum()
        return loss, (error.T @ inputs + stiffness * change).ravel()

    start = old.astype(np.float64).ravel()
    options = {"maxiter": MAX_ITERATIONS}
    found = minimize(loss_and_gradient, start, jac=True, method="L-BFGS-B", options=options)
    return found.x.reshape(old.shape)


def relearn_network(system: WindowNet, samples: Samples, target: np.ndarray) -> nn.Module:
    """Copy the network of a fitted system, and train its last linear layer with `relearn_layer`.

    Args:
        system: fitted; it does not change.
        samples: pieces of the person's captures.
        target: class of each capture [captures].
    """
    import torch
    from torch import nn

    net = deepcopy(system.net_).eval()
    layer = [module for module in net.modules() if isinstance(module, nn.Linear)][-1]
    inputs = _layer_inputs(system, net, layer, samples)
    capture = samples.capture[np.repeat(np.arange(len(samples)), samples.steps)]
    weights = [layer.weight.detach().cpu().numpy(), layer.bias.detach().cpu().numpy()]
    new = relearn_layer(np.column_stack(weights), inputs, target[capture], capture)
    with torch.no_grad():
        layer.weight.copy_(torch.from_numpy(new[:, :-1]))
        layer.bias.copy_(torch.from_numpy(new[:, -1]))
    return net


def _layer_inputs(
    system: WindowNet, net: nn.Module, layer: nn.Linear, samples: Samples
) -> np.ndarray:
    """Inputs of a layer for every decision, float64 [decisions, inputs]."""
    import torch

    from bench.models.nets.training import to_device

    inputs: list[torch.Tensor] = []
    hook = layer.register_forward_pre_hook(
        lambda module, args: inputs.append(args[0].flatten(0, -2).float().cpu())
    )
    device = next(net.parameters()).device
    try:
        with torch.inference_mode():
            for first in range(0, len(samples), system.batch):
                rows = np.arange(first, min(first + system.batch, len(samples)))
                system.compute_logits(net, to_device(samples.make_batch(rows), device))
    finally:
        hook.remove()
    return torch.cat(inputs).numpy().astype(np.float64)
