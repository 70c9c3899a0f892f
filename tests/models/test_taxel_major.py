"""The taxel-major order gives what the network itself gives: outputs and gradients."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from models.nets.cnn85 import CNN85
from models.nets.taxel_major import pool, taxel_major


@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 3), st.integers(0, 2), st.integers(0, 10_000))
def test_a_stack_equals_its_taxel_major_form(rows, cols, kernel, padding, seed):
    torch.manual_seed(seed)
    if min(rows, cols) + 2 * padding < kernel:
        return
    net = nn.Sequential(
        nn.Conv2d(3, 4, kernel, padding=padding),
        nn.ReLU(),
        nn.MaxPool2d(2, ceil_mode=True),
        nn.Conv2d(4, 5, 2, padding=1),
        nn.ReLU(),
        nn.Flatten(),
        nn.LazyLinear(2),
    ).double()
    x = torch.rand(6, 3, rows, cols, dtype=torch.float64, requires_grad=True)
    expected = net(x)
    expected.square().sum().backward()
    gradients = [p.grad.clone() for p in net.parameters()] + [x.grad.clone()]
    net.zero_grad()
    x.grad = None
    found = taxel_major(net, x)
    found.square().sum().backward()
    torch.testing.assert_close(found, expected)
    for a, b in zip([p.grad for p in net.parameters()] + [x.grad], gradients, strict=True):
        torch.testing.assert_close(a, b)


def test_cnn85_equals_its_taxel_major_form():
    torch.manual_seed(0)
    net = CNN85().network(8, 8, 14).double()
    x = torch.rand(5, 85, 8, 8, dtype=torch.float64)
    torch.testing.assert_close(taxel_major(net, x), net(x))


def test_gradient_of_a_tie_goes_to_the_first():
    grid = torch.ones(2, 3, 1, 1, requires_grad=True)
    pool(grid).sum().backward()
    assert grid.grad[..., 0, 0].tolist() == [[1, 0, 1], [0, 0, 0]]


def test_a_layer_without_such_a_form_is_named():
    with pytest.raises(TypeError, match="BatchNorm2d"):
        taxel_major(nn.Sequential(nn.BatchNorm2d(1), nn.Flatten()), torch.zeros(1, 1, 2, 2))
