"""The fast form of convolution, batch norm, ReLU and pooling equals the layers: outputs, gradients and statistics."""

import copy

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from models.volumes import volumes
from models.zhou2016 import Zhou2016CNN2D, Zhou2016CNN3D, Zhou2016GMLSTM, Zhou2016LRCN

HALVES = st.tuples(*[st.integers(1, 2)] * 3)
KERNELS = st.tuples(*[st.sampled_from([1, 3, 5])] * 3)


def stack(shape, kernels, poolings, channels):
    layers, before = [], channels[0]
    for kernel, pooling, filters in zip(kernels, poolings, channels[1:], strict=True):
        cut = tuple(min(p, n) for p, n in zip(pooling, shape, strict=True))
        layers += [nn.Conv3d(before, filters, kernel, padding=tuple(k // 2 for k in kernel)), nn.BatchNorm3d(filters)]
        layers += [nn.ReLU(), nn.MaxPool3d(cut)]
        nn.init.normal_(layers[-3].weight)  # negative scales, too
        nn.init.normal_(layers[-3].bias)
        shape, before = tuple(n // p for n, p in zip(shape, cut, strict=True)), filters
    return nn.Sequential(*layers)


def same(net, x):
    """Compare outputs, gradients and running statistics of both forms in training, then outputs in evaluation."""
    other = copy.deepcopy(net)
    inputs = [x.clone().requires_grad_(), x.clone().requires_grad_()]
    outputs = [net(inputs[0]), volumes(list(other), inputs[1])]
    torch.testing.assert_close(*outputs)
    weight = torch.rand_like(outputs[0])
    for output in outputs:
        (output * weight).sum().backward()
    torch.testing.assert_close(inputs[0].grad, inputs[1].grad)
    for (name, a), b in zip(net.named_parameters(), other.parameters(), strict=True):
        torch.testing.assert_close(a.grad, torch.zeros_like(a) if b.grad is None else b.grad, msg=name)
    for (name, a), b in zip(net.named_buffers(), other.buffers(), strict=True):
        torch.testing.assert_close(a, b, msg=name)
    torch.testing.assert_close(net.eval()(x), volumes(list(other.eval()), x))


@given(
    st.tuples(st.integers(1, 7), st.integers(1, 6), st.integers(1, 6)),
    st.tuples(KERNELS, KERNELS),
    st.tuples(HALVES, HALVES),
    st.integers(1, 2),
    st.integers(0, 10_000),
)
def test_a_stack_equals_its_fast_form(shape, kernels, poolings, channels, seed):
    torch.manual_seed(seed)
    same(stack(shape, kernels, poolings, (channels, 3, 4)).double(), torch.rand(5, channels, *shape).double())


def test_gradients_of_ties_go_where_the_library_sends_them():
    torch.manual_seed(0)
    net = nn.Sequential(nn.Conv3d(2, 2, 1), nn.BatchNorm3d(2), nn.ReLU(), nn.MaxPool3d((2, 2, 2))).double()
    with torch.no_grad():
        net[0].weight.copy_(torch.eye(2).view(2, 2, 1, 1, 1))
        net[1].weight.copy_(torch.tensor([1.0, -1.0]))
    same(net, torch.randint(0, 2, (3, 2, 5, 4, 4)).double())


@pytest.mark.parametrize("system", [Zhou2016CNN3D, Zhou2016CNN2D, Zhou2016LRCN, Zhou2016GMLSTM])
def test_networks_equal_their_fast_form(system):
    torch.manual_seed(0)
    model = system(frames=24, average=2)
    net = model.network(5, 4, 3).double().eval()
    x = torch.rand(6, 24, 5, 4).double()
    net(x)
    torch.testing.assert_close(model.forward(net, x), net(x))
    net.train()
    torch.manual_seed(1)  # of the dropout
    expected = net(x)
    torch.manual_seed(1)
    torch.testing.assert_close(model.forward(net, x), expected)
