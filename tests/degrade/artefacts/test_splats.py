import math

import pytest
import torch

from gaussian_enhancer.degrade.artefacts import splats as module
from gaussian_enhancer.degrade.artefacts.splats import (
    SplatLayer,
    colour_at,
    composite,
    covered_colour,
    depth_at,
    depth_quantile,
)
from gaussian_enhancer.degrade.artefacts.view import View


def some_view(height=9, width=12, batch=2, planes=True, seed=0):
    generator = torch.Generator().manual_seed(seed)
    image, depth, alpha = torch.rand(batch, 5, height, width, generator=generator, dtype=torch.float64).split(
        (3, 1, 1), 1
    )
    depth = torch.where(depth < 0.2, 0.0, 1 + depth)
    return View(image, depth, alpha) if planes else View(image)


def some_splats(height=9, width=12, batch=2, count=6, seed=1):
    generator = torch.Generator().manual_seed(seed)
    chance = torch.rand(batch, 10, count, generator=generator, dtype=torch.float64)
    centre = chance[:, 0:2].mT * torch.tensor([width, height], dtype=torch.float64)
    return SplatLayer(
        centre, 2 * chance[:, 2:4].mT - 0.5, 3 * chance[:, 4], chance[:, 5], chance[:, 6:9].mT, 0.6 + chance[:, 9]
    )


def reference(view, splats, power, extent=module.EXTENT):
    """The same picture by loops over samples, pixels and splats."""
    image, depth, alpha = view.image.clone(), view.depth.clone(), view.alpha.clone()
    for b in range(len(view)):
        order = sorted(range(splats.depth.shape[1]), key=lambda k, b=b: float(splats.depth[b, k]))
        for row in range(image.shape[2]):
            for column in range(image.shape[3]):
                through, colour, far, surface = (
                    1.0,
                    torch.zeros(3, dtype=torch.float64),
                    0.0,
                    float(depth[b, 0, row, column]),
                )
                for k in order:
                    x, y = (torch.tensor([column + 0.5, row + 0.5], dtype=torch.float64) - splats.centre[b, k]).tolist()
                    angle, z = float(splats.angle[b, k]), float(splats.depth[b, k])
                    first = (math.cos(angle) * x + math.sin(angle) * y) / math.exp(splats.log_sigma[b, k, 0])
                    second = (math.cos(angle) * y - math.sin(angle) * x) / math.exp(splats.log_sigma[b, k, 1])
                    falling = math.exp(-0.5 * math.hypot(first, second) ** power)
                    share = min(max((1 - z / surface) / module.SOFTNESS, 0), 1) if surface > 0 else 1
                    weight = (
                        float(splats.opacity[b, k]) * share * through * (falling > math.exp(-0.5 * extent**2)) * falling
                    )
                    colour, far, through = colour + weight * splats.colour[b, k], far + weight * z, through - weight
                here, own = (b, slice(None), row, column), float(alpha[b, 0, row, column]) * (surface > 0)
                image[here] = colour + through * image[here]
                alpha[here] = 1 - (1 - alpha[here]) * through
                if surface > 0 or 1 - through > module.MIN_WEIGHT:
                    depth[here] = (far + through * own * surface) / (1 - through + through * own)
    return View(image, depth, alpha)


@pytest.mark.parametrize(("profile", "power"), [("gaussian", 2), ("disk", 8)])
def test_equals_loops_over_pixels(profile, power, monkeypatch):
    view, splats = some_view(), some_splats()
    expected = reference(view, splats, power)
    for strip in (module.STRIP, 2 * 6 * 12 * 2):
        monkeypatch.setattr(module, "STRIP", strip)
        drawn = composite(view, splats, profile)
        for name in ("image", "depth", "alpha"):
            torch.testing.assert_close(getattr(drawn, name), getattr(expected, name))
    assert (drawn.image - view.image).abs().amax() > 0.2


def test_an_extent_cuts_splats_off(monkeypatch):
    view, splats = some_view(), some_splats()
    far = composite(view, splats)
    monkeypatch.setattr(module, "EXTENT", 1.0)
    near = composite(view, splats)
    torch.testing.assert_close(near.image, reference(view, splats, 2, extent=1.0).image)
    assert not torch.allclose(near.image, far.image)


@pytest.mark.parametrize("planes", [True, False])
def test_opacity_zero_changes_nothing_at_all(planes):
    view, splats = some_view(planes=planes), some_splats()
    for opacity in (torch.zeros(2, 6, dtype=torch.float64), torch.zeros(2, 6, dtype=torch.float64, requires_grad=True)):
        left = composite(
            view, SplatLayer(splats.centre, splats.log_sigma, splats.angle, opacity, splats.colour, splats.depth)
        )
        assert torch.equal(left.image, view.image)
        for name in ("depth", "alpha"):
            before, after = getattr(view, name), getattr(left, name)
            assert (before is None and after is None) or torch.equal(before, after)


def one(depth, opacity, colour=1.0, sigma=3.0):
    return SplatLayer(
        torch.tensor([[[2.5, 2.5]]]),
        torch.full((1, 1, 2), math.log(sigma)),
        torch.zeros(1, 1),
        torch.tensor([[opacity]]),
        torch.full((1, 1, 3), colour),
        torch.tensor([[depth]]),
    )


def test_depth_is_expected_depth():
    view = View(torch.zeros(1, 3, 5, 5), torch.full((1, 1, 5, 5), 4.0), torch.ones(1, 1, 5, 5))
    for opacity, expected in ((1.0, 1.0), (0.5, 2.5), (0.25, 3.25)):
        drawn = composite(view, one(1.0, opacity))
        torch.testing.assert_close(drawn.depth[0, 0, 2, 2], torch.tensor(expected))
        torch.testing.assert_close(drawn.image[0, :, 2, 2], torch.full((3,), opacity))


def test_surfaces_hide_what_lies_behind_them():
    view = View(torch.zeros(1, 3, 5, 5), torch.full((1, 1, 5, 5), 4.0))
    for behind in (4.0, 4.1, 40.0):
        drawn = composite(view, one(behind, 1.0))
        assert torch.equal(drawn.image, view.image)
        assert torch.equal(drawn.depth, view.depth)
    half = composite(view, one(4.0 * (1 - module.SOFTNESS / 2), 1.0))
    torch.testing.assert_close(half.image[0, 0, 2, 2], torch.tensor(0.5), rtol=1e-4, atol=0)


def test_an_empty_pixel_takes_the_depth_of_splats_that_weigh_enough():
    view = View(torch.zeros(1, 3, 5, 5), torch.zeros(1, 1, 5, 5), torch.zeros(1, 1, 5, 5))
    assert composite(view, one(7.0, 2 * module.MIN_WEIGHT)).depth[0, 0, 2, 2] == pytest.approx(7.0, rel=1e-5)
    weak = composite(view, one(7.0, 0.5 * module.MIN_WEIGHT))
    assert torch.equal(weak.depth, view.depth)
    assert weak.alpha[0, 0, 2, 2] == pytest.approx(0.5 * module.MIN_WEIGHT)


def test_the_nearer_splat_hides_the_farther_whatever_their_order():
    near, far = one(1.0, 1.0, 0.2), one(2.0, 1.0, 0.9)
    for first, second in ((near, far), (far, near)):
        both = SplatLayer(
            *(torch.cat([a, b], 1) for a, b in zip(vars(first).values(), vars(second).values(), strict=True))
        )
        assert composite(View(torch.zeros(1, 3, 5, 5)), both).image[0, 0, 2, 2] == pytest.approx(0.2)


def test_a_batch_is_its_samples_and_single_precision_its_double():
    view, splats = some_view(20, 30, batch=3), some_splats(20, 30, batch=3, count=11)
    together = composite(view, splats)
    for i in range(3):
        index = torch.tensor([i])
        alone = composite(view[index], SplatLayer(*(part[index] for part in vars(splats).values())))
        torch.testing.assert_close(alone.image, together.image[index])
        torch.testing.assert_close(alone.depth, together.depth[index])
    single = composite(view.to(torch.float32), splats.to(torch.float32))
    # Where a splat's cut-off falls on a pixel, precisions differ by 1 / 255 of it.
    assert ((single.image - together.image).abs() > 1e-4).double().mean() < 0.01
    assert ((single.depth - together.depth).abs() > 1e-4).double().mean() < 0.01


@pytest.mark.parametrize("profile", ["gaussian", "disk"])
def test_gradients(profile, monkeypatch):
    view, splats = some_view(4, 5, batch=1), some_splats(4, 5, batch=1, count=3)
    fixed = view.depth
    monkeypatch.setattr(module, "EXTENT", 6.0)

    def picture(image, *parts):
        drawn = composite(View(image, fixed, view.alpha), SplatLayer(*parts, splats.depth), profile)
        return drawn.image, drawn.depth, drawn.alpha

    inputs = (view.image, splats.centre, splats.log_sigma, splats.angle, splats.opacity, splats.colour)
    assert torch.autograd.gradcheck(picture, [part.clone().requires_grad_() for part in inputs])


def test_gradients_are_finite_far_from_thin_splats_and_where_nothing_was_hit():
    view = View(torch.rand(1, 3, 4, 900), torch.zeros(1, 1, 4, 900).requires_grad_())
    for profile in ("gaussian", "disk"):
        thin = one(1.0, 0.5, sigma=0.3)
        sigma = thin.log_sigma.clone().requires_grad_()
        drawn = composite(
            view, SplatLayer(thin.centre, sigma, thin.angle, thin.opacity, thin.colour, thin.depth), profile
        )
        (drawn.image.sum() + drawn.depth.sum()).backward()
        assert torch.isfinite(sigma.grad).all()
        assert torch.isfinite(view.depth.grad).all()


def test_looks_up_colours_and_depths():
    view = some_view(4, 6, batch=1)
    centre = torch.tensor([[[2.7, 1.2], [-3.0, 9.0]]], dtype=torch.float64)
    torch.testing.assert_close(colour_at(view, centre)[0, 0], view.image[0, :, 1, 2])
    torch.testing.assert_close(colour_at(view, centre)[0, 1], view.image[0, :, 3, 0])
    depth = torch.tensor([1.0, 2.0, 3.0, 0.0]).reshape(1, 1, 1, 4)
    places = torch.tensor([[[2.5, 0.5], [3.5, 0.5]]])
    assert depth_at(View(torch.zeros(1, 3, 1, 4), depth), places).tolist() == [[3.0, 2.0]]
    assert depth_quantile(View(torch.zeros(1, 3, 1, 4), depth), 1.0).item() == 3
    assert depth_quantile(View(torch.zeros(1, 3, 1, 4), 0 * depth)).item() == 1
    assert depth_at(View(torch.zeros(1, 3, 1, 4)), places).tolist() == [[1.0, 1.0]]


def test_a_disk_has_the_mean_colour_of_what_it_covers():
    image = torch.zeros(1, 3, 16, 16)
    image[..., 8:] = 1.0
    disk = one(1.0, 1.0, sigma=4.0)
    right, astride = torch.tensor([[[12.0, 8.0]]]), torch.tensor([[[8.0, 8.0]]])
    for centre, expected in ((right, 1.0), (astride, 0.5)):
        moved = SplatLayer(centre, disk.log_sigma, disk.angle, disk.opacity, disk.colour, disk.depth)
        torch.testing.assert_close(
            covered_colour(View(image), moved, "disk"), torch.full((1, 1, 3), expected), atol=0.05, rtol=0
        )
