import base64
import io

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.report.figures import (
    absolute_error,
    apply_colour_map,
    colour_map,
    contact_sheet,
    data_uri,
    error_scale,
    sample_values,
)
from gaussian_enhancer.scene.image_files import to_bytes


def lightness(colours: torch.Tensor) -> torch.Tensor:
    """CIE L* of sRGB colours, from the standard's own constants."""
    linear = torch.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    luminance = linear @ torch.tensor([0.2126, 0.7152, 0.0722])
    return torch.where(luminance > 216 / 24389, 116 * luminance ** (1 / 3) - 16, luminance * 24389 / 27)


def test_the_colour_map_rises_evenly_in_lightness() -> None:
    steps = lightness(colour_map(256)).diff()
    assert (steps > 0).all()
    assert steps.max() < 2 * steps.mean()
    assert lightness(colour_map(2)).tolist() == pytest.approx([4, 95], abs=4)


def test_error_is_the_mean_absolute_difference() -> None:
    image = torch.zeros(3, 2, 2)
    photo = torch.tensor([0.3, 0.6, 0.0])[:, None, None].expand(3, 2, 2)
    assert torch.allclose(absolute_error(image, photo), torch.full((2, 2), 0.3))
    assert torch.equal(absolute_error(photo, photo), torch.zeros(2, 2))


def test_the_applied_map_spans_the_colours_and_saturates() -> None:
    shown = apply_colour_map(torch.tensor([[0.0, 0.1, 5.0, float("nan")]]), 0.1)
    colours = colour_map()
    assert torch.equal(shown[:, 0, 0], colours[0])
    for column in (1, 2, 3):
        assert torch.equal(shown[:, 0, column], colours[-1])


def test_values_outside_are_clamped():
    colours = apply_colour_map(torch.tensor([[-1.0, 2.0]]))
    torch.testing.assert_close(colours[:, 0, 0], colour_map()[0])
    torch.testing.assert_close(colours[:, 0, 1], colour_map()[-1])


def test_the_scale_ignores_outliers_and_is_shared() -> None:
    quiet, loud = torch.full((100, 100), 0.05), torch.full((100, 100), 0.234)
    quiet[0, 0] = 1.0
    assert error_scale([sample_values(quiet)]) == pytest.approx(0.05)
    assert error_scale([sample_values(quiet), sample_values(loud)]) == pytest.approx(0.24)
    assert error_scale([torch.zeros(4)]) == 0.02
    assert len(sample_values(loud, 100)) == 100


def decoded(uri: str) -> Image.Image:
    head, _, body = uri.partition(",")
    assert head == "data:image/webp;base64"
    return Image.open(io.BytesIO(base64.b64decode(body))).convert("RGB")


def test_a_small_image_travels_without_loss() -> None:
    image = torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(0))
    assert np.array_equal(np.asarray(decoded(data_uri(image))), to_bytes(image))


def test_an_image_keeps_to_its_budget_and_edge() -> None:
    image = torch.rand(3, 300, 500, generator=torch.Generator().manual_seed(0))
    uri = data_uri(image, budget=20_000)
    assert len(uri) * 3 / 4 < 20_100
    assert decoded(data_uri(image, edge=100)).size == (100, 60)


def test_a_contact_sheet_holds_every_image() -> None:
    red, blue = (torch.zeros(3, 10, 20).index_fill(0, torch.tensor(c), 1.0) for c in (0, 2))
    sheet = contact_sheet([[red, blue], [blue, red]], ["a", "b"], ["x", "y"], height=40)
    colours = sheet.getcolors(100_000)
    counts = {colour: count for count, colour in colours or []}
    assert counts[(255, 0, 0)] == counts[(0, 0, 255)] == 2 * 40 * 80
    with pytest.raises(InputError, match="rows of"):
        contact_sheet([[red]], ["a", "b"], ["x"])
