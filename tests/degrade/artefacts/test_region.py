import torch

from gaussian_enhancer.degrade.artefacts.region import blend_in_region
from gaussian_enhancer.degrade.artefacts.view import View


def test_full_weight_gives_the_degraded_view_whatever_the_depths():
    image, far = torch.zeros(1, 3, 1, 2), torch.tensor([[[[1e10, 5.0]]]])
    view, near = View(image, far), View(image + 0.5, torch.full((1, 1, 1, 2), 2.0))
    blended = blend_in_region(view, near, torch.ones(1, 1, 1, 2))
    assert torch.equal(blended.depth, near.depth)
    assert torch.equal(blended.image, near.image)
    assert torch.equal(blend_in_region(view, near, torch.zeros(1, 1, 1, 2)).depth, far)
