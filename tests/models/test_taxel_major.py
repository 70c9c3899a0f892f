"""The taxel-major order gives what the network itself gives: outputs and gradients."""

import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from torch import nn

from bench.models.nets.taxel_major import max_pool, run_taxel_major


@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.integers(1, 3),
    st.integers(0, 2),
    st.integers(0, 10_000),
)
def test_a_stack_equals_its_taxel_major_form(rows, cols, kernel, padding, seed):
    assume(min(rows, cols) + 2 * padding >= kernel)
    torch.manual_seed(seed)
    net = nn.Sequential(
        nn.Conv2d(3, 4, kernel, padding=padding),
        nn.ReLU(),
        nn.MaxPool2d(2, ceil_mode=True),
        nn.Conv2d(4, 5, 2, padding=1),
        nn.ReLU(),
        nn.MaxPool2d(2, ceil_mode=True),
        nn.Flatten(),
        nn.LazyLinear(2),
    ).double()
    x = torch.rand(6, 3, rows, cols, dtype=torch.float64, requires_grad=True)
    outputs = net(x), run_taxel_major(net, x)
    torch.testing.assert_close(*outputs)
    torch.testing.assert_close(
        *(torch.autograd.grad(y.square().sum(), [*net.parameters(), x]) for y in outputs)
    )


def test_gradient_of_a_tie_goes_to_the_first():
    grid = torch.ones(2, 3, 1, 1, requires_grad=True)
    max_pool(grid).sum().backward()
    assert grid.grad[..., 0, 0].tolist() == [[1, 0, 1], [0, 0, 0]]
