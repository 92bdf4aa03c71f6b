import torch

from gaussian_enhancer.infer.weights import build_design, count_parameters, design_of
from gaussian_enhancer.network.baselines.identity import Identity
from support.networks import views


def test_returns_the_render():
    seen, network = views(5, 3, batch=2), build_design(design_of(Identity()))
    assert torch.equal(network(seen), seen.render)
    assert count_parameters(network) == 0
