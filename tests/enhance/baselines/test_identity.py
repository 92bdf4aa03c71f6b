import torch
from test_sif import views

from gaussian_enhancer.enhance.baselines.identity import Identity
from gaussian_enhancer.enhance.weights import build_design, count_parameters, design_of


def test_returns_the_render():
    seen, network = views(5, 3, batch=2), build_design(design_of(Identity()))
    assert torch.equal(network(seen), seen.render)
    assert count_parameters(network) == 0
