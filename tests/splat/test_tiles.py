"""Tile lists against a brute-force look at every pixel centre."""

import numpy as np
import pytest

from gaussian_enhancer.splat.thresholds import TILE
from gaussian_enhancer.splat.tiles import TileLists, bin_tiles, grid, sum_over_tiles


def ellipses(count: int, height: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Random ellipses as footprints, and their covariances times the squared radius."""
    draw = np.random.default_rng(seed)
    axes = draw.normal(size=(count, 2, 2)) * np.exp(draw.normal(size=(count, 1, 1)) * 1.2 + 1.0)
    cov = axes @ axes.transpose(0, 2, 1) + 0.3 * np.eye(2)
    middle = draw.uniform(-0.3, 1.3, size=(count, 2)) * [width, height]
    xx, yy, xy = cov[:, 0, 0], cov[:, 1, 1], cov[:, 0, 1]
    chord = np.sqrt(np.linalg.det(cov) / xx)
    return np.column_stack([middle, np.sqrt(xx), np.sqrt(yy), xy / xx, chord]), cov


def inside(footprint: np.ndarray, cov: np.ndarray, height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[:height, :width] + 0.5
    offset = np.stack([x - footprint[0], y - footprint[1]], -1)
    return np.einsum("hwi,ij,hwj->hw", offset, np.linalg.inv(cov), offset) <= 1.0


def nearest(footprint: np.ndarray, cov: np.ndarray, left: int, row: int) -> float:
    """Smallest squared distance on a row of pixel centres between a tile's first and last column."""
    inverse = np.linalg.inv(cov)
    dy = row + 0.5 - footprint[1]
    at = -inverse[0, 1] / inverse[0, 0] * dy
    dx = np.clip(at, left + 0.5 - footprint[0], left + TILE - 0.5 - footprint[0])
    return float(np.array([dx, dy]) @ inverse @ np.array([dx, dy]))


def listed(lists: TileLists, height: int, width: int) -> dict[int, set[tuple[int, int, int]]]:
    """Per Gaussian, the (tile, first row, end row) it is listed with."""
    found: dict[int, set[tuple[int, int, int]]] = {}
    for tile in range(len(lists.tile_starts) - 1):
        for e in range(lists.tile_starts[tile], lists.tile_starts[tile + 1]):
            entry = (tile, int(lists.rows[e, 0]), int(lists.rows[e, 1]))
            found.setdefault(int(lists.gaussians[e]), set()).add(entry)
    return found


@pytest.mark.parametrize(("height", "width"), [(1, 1), (17, 33), (40, 16), (50, 70)])
def test_lists_are_the_support_and_no_more(height: int, width: int) -> None:
    footprints, covariances = ellipses(150, height, width)
    lists = bin_tiles(footprints, np.ones(150, np.float32), height, width)
    found = listed(lists, height, width)
    down, across = grid(height, width)
    for g in range(150):
        mask = np.zeros((down * TILE, across * TILE), bool)
        mask[:height, :width] = inside(footprints[g], covariances[g], height, width)
        rows = {}
        for tile in range(down * across):
            top, left = tile // across * TILE, tile % across * TILE
            hit = mask[top : top + TILE, left : left + TILE].any(axis=1).nonzero()[0]
            if len(hit):
                rows[tile] = (hit[0], hit[-1] + 1)
        got = {tile: (first, end) for tile, first, end in found.get(g, set())}
        assert set(rows) <= set(got)
        for tile, (first, end) in rows.items():
            assert got[tile][0] <= first
            assert got[tile][1] >= end
        for tile, (first, end) in got.items():
            assert all(nearest(footprints[g], covariances[g], tile % across * TILE, tile // across * TILE + row) < 1.01
                       for row in range(first, end))  # fmt: skip


def test_order_is_by_depth_then_index() -> None:
    footprints = np.tile([8.0, 8.0, 3.0, 3.0, 0.0, 3.0], (6, 1))
    depths = np.array([2.0, 1.0, 2.0, 0.5, 1e6, 1.0], np.float32)
    lists = bin_tiles(footprints, depths, 16, 16)
    assert lists.gaussians.tolist() == [3, 1, 5, 0, 2, 4]


def test_slots_lie_by_gaussian_and_sums_follow_them() -> None:
    footprints, _ = ellipses(80, 60, 60, seed=3)
    lists = bin_tiles(footprints, np.random.default_rng(0).uniform(1, 9, 80).astype(np.float32), 60, 60)
    assert (np.sort(lists.slots) == np.arange(len(lists.gaussians))).all()
    assert (lists.slot_starts[lists.gaussians] <= lists.slots).all()
    assert (lists.slots < lists.slot_starts[lists.gaussians + 1]).all()
    by_entry = np.random.default_rng(1).normal(size=(len(lists.gaussians), 5)).astype(np.float32)
    expected, values = np.zeros((80, 5)), np.empty_like(by_entry)
    np.add.at(expected, lists.gaussians, by_entry)
    values[lists.slots] = by_entry
    np.testing.assert_allclose(sum_over_tiles(values, lists), expected, atol=1e-4)


def test_a_negative_chord_lists_the_whole_box() -> None:
    footprints = np.array([[16.0, 16.0, 15.0, 15.0, 1.0, -1.0], [16.0, 16.0, 15.0, 15.0, 1.0, 0.1]])
    found = listed(bin_tiles(footprints, np.ones(2, np.float32), 32, 32), 32, 32)
    assert {tile for tile, _, _ in found[0]} == {0, 1, 2, 3}
    assert {tile for tile, _, _ in found[1]} == {0, 3}  # a thin diagonal


def test_empty_and_unusable_footprints_are_nowhere() -> None:
    usable = [8.0, 8.0, 3.0, 3.0, 0.0, 3.0]
    rows = [usable]
    for position in range(6):
        for value in (np.nan, np.inf, -np.inf):
            rows.append([*usable[:position], value, *usable[position + 1 :]])
    rows.append([8.0, 8.0, 0.0, 3.0, 0.0, 3.0])
    lists = bin_tiles(np.array(rows), np.ones(len(rows), np.float32), 16, 16)
    assert lists.gaussians.tolist() == [0]
    assert len(bin_tiles(np.zeros((0, 6)), np.zeros(0, np.float32), 16, 16).gaussians) == 0


def test_far_larger_than_the_image_covers_every_row_once() -> None:
    lists = bin_tiles(np.array([[5e5, -3e5, 1e9, 1e9, 0.0, 1e9]]), np.ones(1, np.float32), 33, 17)
    assert len(lists.gaussians) == 6
    assert (lists.rows[:, 1] - lists.rows[:, 0]).tolist() == [16, 16, 16, 16, 1, 1]


def test_lists_do_not_depend_on_the_number_of_threads() -> None:
    import numba

    footprints, _ = ellipses(200, 60, 60, seed=4)
    depths = np.random.default_rng(0).integers(1, 9, 200).astype(np.float32)
    before = numba.get_num_threads()
    expected = bin_tiles(footprints, depths, 60, 60)
    numba.set_num_threads(1)
    try:
        alone = bin_tiles(footprints, depths, 60, 60)
    finally:
        numba.set_num_threads(before)
    assert all((found == other).all() for found, other in zip(alone, expected, strict=True))
