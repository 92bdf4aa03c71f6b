"""Two enhancements of a view, averaged: which references each has, and where there is one alone."""

from dataclasses import replace

import pytest
import torch
from test_change_confidence import SMALL, judging, views

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.ensemble import SHARE, mean_change, without_last_reference
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.super_resolution import limit_finer_scales
from gaussian_enhancer.infer.weights import Pretrained
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.network.ssif_sr import SSIFSR
from support.networks import trained

OPTIONS = {"precision": "float32", "confidence": judging(0.5, 0.25)}
CONFIG = ReferenceConfig(Reprojected())


def test_the_mean_change_is_taken_beyond_it_and_stays_an_image():
    render = torch.tensor([0.2, 0.5, 0.9])[None, :, None, None].expand(1, 3, 4, 4)
    found = mean_change(render, render + 0.1, render + 0.3)
    expected = (render + SHARE * 0.2).clamp(0, 1)
    torch.testing.assert_close(found, expected)
    assert float(found[:, 2].max()) == 1.0


def test_the_least_useful_reference_is_left_out_of_everything():
    seen = replace(views(32, 48), fine_references=torch.rand(1, 3, 3, 128, 192))
    fewer = without_last_reference(seen)
    for name in ("references", "visibility", "reference_renders", "fine_references"):
        assert torch.equal(getattr(fewer, name), getattr(seen, name)[:, :2]), name
    assert fewer.render is seen.render
    assert without_last_reference(replace(seen, reference_renders=None)).reference_renders is None


def test_the_enhancer_averages_the_changes_with_and_without_the_last_reference():
    seen, network = views(), trained()
    single = SetEnhancer(network, CONFIG, **OPTIONS)
    both = [single.enhance(one) for one in (seen, without_last_reference(seen))]
    assert float((both[0] - both[1]).abs().max()) > 1e-3
    found = SetEnhancer(network, CONFIG, ensemble=True, **OPTIONS).enhance(seen)
    torch.testing.assert_close(found, mean_change(seen.render, *both), rtol=0, atol=2e-6)


@pytest.mark.parametrize("lacking", ["references", "confidence"])
def test_there_is_one_enhancement_without_a_confidence_or_a_third_reference(lacking):
    seen, options = views(), dict(OPTIONS)
    if lacking == "references":
        seen = without_last_reference(seen)
    else:
        options["confidence"] = None
    single, double = (SetEnhancer(trained(), CONFIG, ensemble=on, **options).enhance(seen) for on in (False, True))
    assert torch.equal(single, double)


def test_super_resolution_averages_its_first_network_alone():
    seen = replace(views(32, 48), fine_references=torch.rand(1, 3, 3, 128, 192))
    cascade = Cascade(trained(SSIFLR, **SMALL), trained(SSIFSR, **SMALL))
    first = SetEnhancer(cascade.first, CONFIG, ensemble=True, **OPTIONS).enhance(replace(seen, fine_references=None))
    found = SetEnhancer(cascade, CONFIG, ensemble=True, **OPTIONS).enhance(seen)
    with torch.inference_mode():
        finer = limit_finer_scales(cascade.second(replace(seen, render=first)), first, seen)
    torch.testing.assert_close(found, finer.clamp(0, 1), rtol=0, atol=1e-5)


def test_it_is_on_unless_it_is_switched_off():
    pretrained = Pretrained(trained(), CONFIG, {}, judging(0.5))
    for options, ensemble in (({}, True), ({"ensemble": False}, False), ({"confidence": False}, False)):
        assert EnhancementOptions(**options).enhancer(pretrained, CONFIG).ensemble is ensemble
