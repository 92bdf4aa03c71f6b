import dataclasses
import json

import pytest
import torch
import torch.nn.functional as F
from test_ssif_sr import fine_views

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import build_design, design_of, load_weights, save_weights
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.colour_clamping import clamp_to_references
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.network.ssif_sr import SSIFSR
from support.networks import trained

SMALL = {"widths": (8, 8, 8), "blocks": (1, 1, 1)}


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (17, 24)])
@pytest.mark.parametrize(("references", "fine"), [(0, True), (2, True), (2, False)])
def test_untrained_returns_the_enlarged_render_bit_for_bit(size, references, fine):
    seen = fine_views(*size, references=references, fine=fine)
    network = Cascade(SSIFLR(**SMALL), SSIFSR(**SMALL))
    assert torch.equal(network(seen), F.interpolate(seen.render, scale_factor=4, mode="bicubic", align_corners=False))
    sides = [tuple(image.shape[-2:]) for image in network.stages(seen)]
    assert sides == [size, *((n * size[0], n * size[1]) for n in (1, 2, 4))]


def test_the_second_sees_what_the_first_makes_within_the_evidence():
    seen, first, second = fine_views(), trained(SSIFLR, **SMALL), trained(SSIFSR, **SMALL)
    bare = first(dataclasses.replace(seen, fine_references=None))
    kept = clamp_to_references(bare, seen, 3, clamp_unseen=True)
    assert not torch.equal(kept, bare)
    for colour_clamping, image in ((3, kept), (0, bare)):
        network = Cascade(first, second, colour_clamping)
        torch.testing.assert_close(network.stages(seen)[0], image)
        torch.testing.assert_close(network(seen), second(dataclasses.replace(seen, render=image)))


def test_images_stay_in_single_precision_between_the_networks(monkeypatch):
    """So that rounding does not decide on which side of a limit a colour lies."""
    received = []

    def spied(image, *arguments, **options):
        received.append(image.dtype)
        return clamp_to_references(image, *arguments, **options)

    monkeypatch.setattr("gaussian_enhancer.network.cascade.clamp_to_references", spied)
    network, seen = Cascade(trained(SSIFLR, **SMALL), trained(SSIFSR, **SMALL)), fine_views()
    exact = network(seen)
    half = network.half()(seen.map_images(lambda image, _: image.half()))
    assert received == [torch.float32, torch.float32]
    assert half.dtype == torch.float16
    torch.testing.assert_close(half.float(), exact, rtol=0, atol=1e-2)


def test_gradients_reach_both():
    network = Cascade(trained(SSIFLR, **SMALL), trained(SSIFSR, **SMALL))
    network(fine_views()).square().mean().backward()
    for part in (network.first, network.second):
        assert sum(float(p.grad.abs().sum()) for p in part.parameters() if p.grad is not None) > 0


def test_survives_its_file(tmp_path):
    network = trained(Cascade, SSIFLR(**SMALL), SSIFSR(**SMALL), colour_clamping=5).half().float()
    path = tmp_path / "both.safetensors"
    save_weights(path, network, ReferenceConfig(fine=True), {"name": "both"})
    loaded = load_weights(path).network
    assert isinstance(loaded, Cascade)
    assert loaded.colour_clamping == 5
    torch.testing.assert_close(loaded(fine_views()), network(fine_views()))


def test_refuses_what_does_not_follow_one_upon_the_other():
    with pytest.raises(InputError, match="enlarge 4 and 4 times"):
        Cascade(SSIFSR(**SMALL), SSIFSR(**SMALL))
    with pytest.raises(InputError, match="window"):
        Cascade(SSIFLR(**SMALL), SSIFSR(**SMALL), colour_clamping=2)
    design = json.loads(json.dumps(design_of(Cascade(SSIFLR(**SMALL), SSIFSR(**SMALL)))))
    assert design_of(build_design(design)) == design
    design["second"] = dict(design)
    with pytest.raises(ValueError, match="several networks"):
        build_design(design)
