"""Blending of given 2D Gaussians: hand-computed stacks, stopping, gradients by central differences."""

import math

import numpy as np
import pytest

from gaussian_enhancer.splat.raster import Image, Splats, blend, blend_backward
from gaussian_enhancer.splat.tiles import TileLists, bin_tiles, sum_over_tiles

WHITE2 = 0.5 * math.log2(math.e)
BLACK = np.zeros(3, np.float32)


def round_splats(
    centres: list[list[float]], deviation: float, opacities: list[float], colours: list[list[float]]
) -> Splats:
    """Isotropic Gaussians at depths 1, 2, 3, ..."""
    n = len(centres)
    support = deviation * np.sqrt(2 * np.log(255 * np.maximum(opacities, 1 / 255)))[:, None]
    middle = np.array(centres, float).reshape(n, 2)
    slope = math.sqrt(WHITE2) / deviation
    white = np.tile([slope, 0.0, 0.0, slope, 0.0], (n, 1))
    white[:, 4] = np.log2(opacities)
    return Splats(
        np.hstack([middle, support, support, np.zeros((n, 1)), support]),
        white,
        np.arange(1, n + 1, dtype=np.float32),
        np.array(colours, np.float32).reshape(n, 3),
    )


def drawn(splats: Splats, height: int, width: int, background: np.ndarray = BLACK) -> tuple[TileLists, Image]:
    lists = bin_tiles(splats.footprints, splats.depths, height, width)
    return lists, blend(splats, lists, background, height, width)


def test_two_in_front_of_a_background() -> None:
    splats = round_splats([[8.5, 8.5]] * 2, 3.0, [0.5, 0.8], [[1, 0, 0], [0, 1, 0]])
    _, image = drawn(splats, 17, 17, np.array([0, 0, 1], np.float32))
    assert image.colour[:, 8, 8] == pytest.approx([0.5, 0.4, 0.1], abs=1e-6)
    assert image.alpha[0, 8, 8] == pytest.approx(0.9, abs=1e-6)
    assert image.depth[0, 8, 8] == pytest.approx((0.5 * 1 + 0.4 * 2) / 0.9, abs=1e-5)
    assert image.median_depth[0, 8, 8] == 1.0
    weight = 0.5 * math.exp(-0.5 * (3 / 3.0) ** 2)
    assert image.colour[0, 8, 11] == pytest.approx(weight, abs=1e-6)
    assert image.median_depth[0, 8, 11] == 2.0


def test_alpha_is_capped_and_a_pixel_stops_before_transmittance_is_spent() -> None:
    splats = round_splats([[0.5, 0.5]] * 5, 2.0, [0.9999999] * 5, [[1, 1, 1]] * 5)
    _, image = drawn(splats, 1, 1)
    assert image.alpha[0, 0, 0] == pytest.approx(0.9999, abs=1e-6)  # the third would leave 1e-6
    assert image.blended_counts[0] == 5


def test_a_tile_whose_pixels_have_stopped_is_left() -> None:
    splats = round_splats([[8.0, 8.0]] * 100, 200.0, [0.98] * 100, [[1, 1, 1]] * 100)
    lists, image = drawn(splats, 16, 16)
    assert image.blended_counts[0] == 8
    gradient = np.ones((3, 16, 16), np.float32)
    zero = np.zeros((1, 16, 16), np.float32)
    gathered = blend_backward(splats, lists, image, gradient, zero, zero)
    assert (gathered[3:] == 0).all()
    assert (gathered[:2] != 0).any()


def test_a_share_below_one_in_255_is_skipped() -> None:
    _, image = drawn(round_splats([[0.5, 0.5]], 2.0, [0.9 / 255], [[1, 1, 1]]), 1, 1)
    assert image.alpha[0, 0, 0] == 0
    _, image = drawn(round_splats([[0.5, 0.5]], 2.0, [1.1 / 255], [[1, 1, 1]]), 1, 1)
    assert image.alpha[0, 0, 0] == pytest.approx(1.1 / 255, rel=1e-5)


def test_an_empty_image_is_background() -> None:
    splats = round_splats([], 1.0, [], [])
    _, image = drawn(splats, 5, 33, np.array([0.25, 0.5, 0.75], np.float32))
    assert (image.colour == np.array([0.25, 0.5, 0.75])[:, None, None]).all()
    assert (image.depth == 0).all()
    assert (image.median_depth == 0).all()


def test_gradients_equal_central_differences() -> None:
    # Wide and thin enough that no pixel meets a threshold, where the loss would jump.
    draw = np.random.default_rng(0)
    n, height, width = 12, 18, 19
    splats = round_splats(
        draw.uniform(2, 16, (n, 2)).tolist(),
        12.0,
        draw.uniform(0.1, 0.4, n).tolist(),
        draw.uniform(0, 1, (n, 3)).tolist(),
    )
    background = np.array([0.3, 0.1, 0.6], np.float32)
    lists, image = drawn(splats, height, width, background)
    weights = [draw.normal(size=(channels, height, width)).astype(np.float32) for channels in (3, 1, 1)]
    gathered = sum_over_tiles(blend_backward(splats, lists, image, *weights), lists)

    def loss() -> float:
        out = blend(splats, lists, background, height, width)
        planes = (out.colour, out.depth, out.alpha)
        return sum(float((w.astype(float) * p).sum()) for w, p in zip(weights, planes, strict=True))

    def difference(values: np.ndarray, at: tuple[int, ...], step: float) -> float:
        kept = values[at]
        values[at] = kept + step
        above = loss()
        values[at] = kept - step
        below = loss()
        values[at] = kept
        return (above - below) / (2 * step)

    slope = float(splats.whitening[0, 0])
    for g in range(n):
        for channel in range(3):
            assert gathered[g, channel] == pytest.approx(difference(splats.colours, (g, channel), 0.05), abs=5e-3)
        assert gathered[g, 3] == pytest.approx(difference(splats.depths, (g,), 0.05), abs=5e-3)
        by_opacity = difference(splats.whitening, (g, 4), 0.01) / math.log(2)
        assert gathered[g, 4] == pytest.approx(by_opacity, rel=1e-2, abs=2e-2)
        by_x = difference(splats.footprints, (g, 0), 0.02)
        assert 2 * math.log(2) * slope * gathered[g, 5] == pytest.approx(by_x, rel=1e-2, abs=2e-2)
