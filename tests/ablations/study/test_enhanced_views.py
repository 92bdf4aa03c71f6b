"""Views of a run, enhanced by several methods: metrics are those of the images, and equal preparations are shared."""

from dataclasses import replace

import pytest
import torch

from ablations.study.enhanced_views import enhanced_views
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import AUTO
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.metrics.pair import measure_pair
from gaussian_enhancer.scene.renders import read_run
from support.networks import small_sif


def brighter(shift: float, config: ReferenceConfig) -> SetEnhancer:
    """An enhancer that adds about half of a number."""
    network = small_sif()
    with torch.no_grad():
        network.decode.head.bias[:12] = shift
    return SetEnhancer(network, config, precision="float32")


@pytest.fixture
def enhancers() -> dict[str, SetEnhancer]:
    """Two methods whose references are prepared alike, and one that sees fewer."""
    configs = {"same": ReferenceConfig(), "brighter": ReferenceConfig(), "fewer": ReferenceConfig(references=1)}
    return {name: brighter(0.2 * (name == "brighter"), config) for name, config in configs.items()}


def test_images_are_the_enhancers_and_metrics_the_images(plane_run, enhancers):
    rendered = read_run(plane_run)
    found = list(enhanced_views(rendered, enhancers))
    assert [one.view.name for one in found] == [view.name for view in rendered.targets]
    for name, enhancer in enhancers.items():
        for one, made in zip(found, enhancer(rendered), strict=True):
            result = one.results[name]
            torch.testing.assert_close(result.image, made.image)
            assert result.measured == measure_pair(result.image, one.photo)
    for one in found:
        assert set(one.gains("same").values()) == {0.0}
        assert (
            one.gains("brighter")["psnr"] == one.results["brighter"].measured.metrics["psnr"] - one.raw.metrics["psnr"]
        )
        assert one.gains("brighter")["psnr"] < 0


def test_references_are_aligned_once_for_methods_that_prepare_them_alike(plane_run, enhancers, monkeypatch):
    align, aligned = ReferenceConfig.align, []

    def counted(self, target, view, pool: ReferencePool, candidates=None):
        aligned.append((view.name, self.references))
        return align(self, target, view, pool, candidates)

    monkeypatch.setattr(ReferenceConfig, "align", counted)
    (one,) = enhanced_views(read_run(plane_run), enhancers, every=100)
    assert aligned == [(one.view.name, 3), (one.view.name, 1)]
    assert one.results["same"].aligned is one.results["brighter"].aligned


def test_rules_leave_out_what_the_job_enhance_leaves_out(plane_run, enhancers):
    """References that a coarse look does not choose, and plain background."""
    rendered, rules = read_run(plane_run), replace(AUTO, small=0, margin=8)
    width = 64
    background = torch.tensor(rendered.background)[:, None, None]

    def half_empty(view):
        image = view.read().clone()
        image[:, :, width // 2 :] = background
        return replace(view, read=lambda: image)

    for views in (rendered, replace(rendered, targets=tuple(map(half_empty, rendered.targets)))):
        planner = Planner(rules, enhancers["fewer"].reference_config, views)
        expected = list(enhancers["fewer"](views, planner))
        found = list(enhanced_views(views, {"fewer": enhancers["fewer"]}, rules=rules))
        assert [one.results["fewer"].aligned.names for one in found] == [one.references for one in expected]
        for one, made in zip(found, expected, strict=True):
            assert torch.equal(one.results["fewer"].image, made.image)
        assert {plan.regions is None for plan in planner.plans.values()} == {views is rendered}


def test_a_view_without_a_photo_is_refused(plane_run, enhancers):
    rendered = read_run(plane_run)
    blind = replace(rendered, targets=(replace(rendered.targets[0], read_photo=None),))
    with pytest.raises(InputError, match="no photo to compare with"):
        list(enhanced_views(blind, enhancers))
