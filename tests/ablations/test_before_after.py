"""The README's picture: what it chooses to show is not what enhancement did best."""

import pytest
import torch

from ablations.scripts.before_after import (
    BAND,
    CROP,
    GAP,
    Compared,
    caption,
    changed_block,
    harmed_block,
    median_gain,
    read_views,
    strip,
    used_weights,
    worst_block,
)
from gaussian_enhancer.errors import InputError

HEIGHT, WIDTH = 32, 48


def view(name: str, error: float) -> Compared:
    """A view whose raw render is off by 0.2 in one corner, and whose enhancement leaves `error` there."""
    photo = torch.full((3, HEIGHT, WIDTH), 0.5)
    raw, enhanced = photo.clone(), photo.clone()
    raw[:, -8:, :12] += 0.2
    enhanced[:, -8:, :12] += error
    return Compared(name, 1000, raw, enhanced, photo)


def test_the_view_with_the_median_gain_is_shown() -> None:
    views = [view("best", 0.01), view("worst", 0.3), view("middle", 0.1)]
    assert median_gain(views).name == "middle"
    assert median_gain(views[:2]).name == "worst"  # of two, the one that gains less


def test_the_crop_is_where_the_raw_render_is_worst() -> None:
    assert worst_block(view("a", 0.4)) == (0, HEIGHT - HEIGHT // CROP, WIDTH // CROP, HEIGHT)
    moved = view("a", 0.0)
    moved.raw[:, 8:16, 24:36] += 0.4
    assert worst_block(moved) == (24, 8, 36, 16)


def test_the_changed_crop_counts_changes_for_the_worse_too() -> None:
    changed = view("a", 0.15)
    changed.enhanced[:, 8:16, 24:36] += 0.1
    assert changed_block(changed) == harmed_block(changed) == (24, 8, 36, 16)
    assert changed_block(view("a", 0.0)) == (0, HEIGHT - HEIGHT // CROP, WIDTH // CROP, HEIGHT)


def test_the_harmed_crop_is_where_enhancement_adds_most() -> None:
    harmed = view("a", 0.0)
    harmed.enhanced[:, 8:16, 24:36] += 0.1
    assert worst_block(harmed) == (0, HEIGHT - HEIGHT // CROP, WIDTH // CROP, HEIGHT)
    assert harmed_block(harmed) == (24, 8, 36, 16)


def test_a_loss_is_captioned_as_one() -> None:
    views = [view("a", 0.4), view("b", 0.4)]
    text = caption(views, views[0], "3DGS", "a capture, MIT", "lr_tiny", "worst")
    assert "-6.02 dB; mean of the 2 held-out views -6.02 dB" in text
    assert "fitted for 1,000 steps" in text
    assert text.endswith("the crop is where the raw render is worst.")


def test_the_strip_holds_three_views_and_their_crops() -> None:
    assert strip(view("a", 0.1), (0, 0, WIDTH // CROP, HEIGHT // CROP)).size == (
        3 * WIDTH + 2 * GAP,
        BAND + 2 * HEIGHT + GAP,
    )


def test_weights_of_a_training_are_captioned_by_its_name(tmp_path) -> None:
    for weights, name in (("lr_tiny", "lr_tiny"), ("runs/train/row_sif-0123abcd/weights.safetensors", "row_sif")):
        (tmp_path / "config.yaml").write_text(f"weights: {weights}\n")
        assert used_weights(tmp_path) == name


def test_a_folder_without_enhanced_views_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="holds no enhanced views"):
        read_views(tmp_path)
