"""The last layer of a network, learnt anew for one person from what the layers before make of their captures."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax
from torch import nn

from models.training import Samples, moved

STIFF = 3.0  # captures that what was learnt of all people counts; docs/people.md
ROUNDS = 200


def relearnt(net: nn.Module, samples: Samples, target: np.ndarray, batch: int, stiff: float = STIFF) -> nn.Module:
    """A network whose last linear layer has learnt some captures of a person, too.

    The layer minimises the cross-entropy of their captures, a mean over the decisions on each, while its weights stay
    near those that it had: the squared distance costs ``stiff`` / 2 times the mean square length of its input.

    Args:
        net: fitted; it stays as it is.
        samples: what the captures are cut into.
        target: class of each capture [captures].
        batch: samples at a time.
        stiff: how much the old weights count.
    """
    found = deepcopy(net).eval()
    layer = [module for module in found.modules() if isinstance(module, nn.Linear)][-1]
    given, row = _inputs(found, layer, samples, batch)
    given = np.column_stack([given, np.ones(len(given))])
    old = np.column_stack([parameter.detach().cpu().numpy() for parameter in (layer.weight, layer.bias)])
    capture = samples.capture[row]
    share = 1 / np.bincount(capture, minlength=len(target))[capture]
    wanted = np.eye(len(old))[target[capture]]
    price = stiff * np.mean((given**2).sum(axis=1))

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        moved_by = flat.reshape(old.shape) - old
        logits = given @ (moved_by + old).T
        wrong = (softmax(logits, axis=1) - wanted) * share[:, None]
        cost = -(wanted * log_softmax(logits, axis=1) * share[:, None]).sum() + price / 2 * (moved_by**2).sum()
        return cost, (wrong.T @ given + price * moved_by).ravel()

    new = minimize(loss, old.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ROUNDS}).x.reshape(old.shape)
    with torch.no_grad():
        layer.weight.copy_(torch.from_numpy(new[:, :-1]))
        layer.bias.copy_(torch.from_numpy(new[:, -1]))
    return found


def _inputs(net: nn.Module, layer: nn.Linear, samples: Samples, batch: int) -> tuple[np.ndarray, np.ndarray]:
    """What the layer is given for every decision, float64 [decisions, inputs], and of which sample each is."""
    seen: list[torch.Tensor] = []
    hook = layer.register_forward_pre_hook(lambda module, args: seen.append(args[0].flatten(0, -2).cpu()))
    device = next(net.parameters()).device
    try:
        with torch.inference_mode():
            for first in range(0, len(samples), batch):
                net(moved(samples.batch(np.arange(first, min(first + batch, len(samples)))), device))
    finally:
        hook.remove()
    return torch.cat(seen).numpy().astype(np.float64), np.repeat(np.arange(len(samples)), samples.steps)
