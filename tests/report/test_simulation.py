"""Sheets and page of the simulator."""

import re

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.degrade.artefact_types import ARTEFACTS
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import ArtefactStep, NoGate, RandomGate
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.report import simulation, simulation_parts
from gaussian_enhancer.report.simulation import ImageRow, Section, sheet, write_page
from gaussian_enhancer.report.simulation_parts import (
    STRENGTHS,
    depth_colours,
    describe_artefacts,
    gate_section,
    generator_section,
    shrink_view,
    type_sections,
)


def view(height: int = 24, width: int = 32, *, geometry: bool = True) -> View:
    noise = torch.Generator().manual_seed(0)
    image = torch.rand(1, 3, height, width, generator=noise)
    if not geometry:
        return View(image)
    depth = 2 + 3 * torch.rand(1, 1, height, width, generator=noise)
    depth[..., : width // 4] = 0
    return View(image, depth, (depth > 0).float())


class Doubled:
    """A second stage that can be told from none: half as bright, a little noise of its own seed."""

    def __call__(self, manual, generators, real=None):
        noise = torch.stack([torch.rand(3, 1, 1, generator=generator) for generator in generators])
        return View(manual.image / 2 + 0.1 * noise, manual.depth, manual.alpha)


def test_a_row_starts_with_the_photo_and_moves_away_from_it() -> None:
    photo = view()
    colours, depths = type_sections(photo, seed=3)
    assert [row.name for row in colours.rows] == list(ARTEFACTS)
    for row in colours.rows:
        assert torch.equal(row.images[0], photo.image[0]), row.name
        assert not torch.equal(row.images[-1], photo.image[0]), row.name
        assert row.captions == ("0", "0.25", "0.5", "0.75", "1")
        assert row.note, f"{row.name} does not say what it is"
    assert depths.file == "types_depth"
    for row in depths.rows:
        assert torch.equal(row.images[0], depth_colours(photo.depth[0], photo.depth[0])), row.name


def test_a_row_keeps_its_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    noises = []

    def artefact(before, strength, generators):
        """Adds what it draws."""
        noises.append(torch.stack([torch.rand(3, 1, 1, generator=generator) for generator in generators]))
        return View(before.image + strength[:, None, None, None] * noises[-1])

    monkeypatch.setattr(simulation_parts, "ARTEFACTS", {"odd": artefact})
    (section,) = type_sections(view(geometry=False), seed=5)
    assert (noises[0] == noises[0][:1]).all()
    steps = [(image - section.rows[0].images[0]).mean() for image in section.rows[0].images]
    assert torch.stack(steps).tolist() == pytest.approx([s * float(noises[0][0].mean()) for s in STRENGTHS], abs=1e-5)


def test_without_depth_there_is_no_sheet_of_depth() -> None:
    assert [section.file for section in type_sections(view(geometry=False), 0)] == ["types"]


def test_gates_show_what_they_drew_and_name_what_they_cannot() -> None:
    photo = view()
    gates = {"none": NoGate(), "random": RandomGate(chance=1.0), "adaptive": "no fingerprint"}
    section = gate_section(photo, gates, seed=1, draws=4)
    none, everything, absent = section.rows
    assert all(torch.equal(image, photo.image[0]) for image in none.images)
    assert none.captions == ("nothing",) * 4
    assert all(len(caption.split(" · ")) == 11 for caption in everything.captions)
    assert len({image.numpy().tobytes() for image in everything.images}) == 4
    assert (absent.images, absent.note) == ((), "not drawn: no fingerprint")


def test_steps_are_told_in_their_order() -> None:
    assert describe_artefacts(()) == "nothing"
    assert (
        describe_artefacts([ArtefactStep("needle", 0.5), ArtefactStep("blur", 0.256, regional=True)])
        == "needle 0.50 · blur 0.26 in a region"
    )


def test_stage_two_is_drawn_from_one_stage_one() -> None:
    photo, real = view(), torch.zeros(1, 3, 24, 32)
    section = generator_section(photo, Simulator(RandomGate(), Doubled()), 0, real, draws=3)
    images = dict(zip(section.rows[0].captions, section.rows[0].images, strict=True))
    first, manual, *drawn, last = images.values()
    assert torch.equal(first, photo.image[0])
    assert torch.equal(last, real[0])
    for image in drawn:
        offset = image - manual / 2
        assert offset.std((1, 2)).max() < 1e-5, "another stage 1"
    assert len({image.numpy().tobytes() for image in drawn}) == 3


def test_without_stage_two_the_section_says_so() -> None:
    section = generator_section(view(), Simulator(NoGate()), 0, None)
    assert section.rows == ()
    assert "generator=none" in section.text


@pytest.mark.parametrize(("height", "width"), [(640, 480), (480, 640), (1, 1000), (1000, 1), (1, 1), (320, 20)])
def test_copies_are_small_and_keep_their_shape(height: int, width: int) -> None:
    small = shrink_view(view(height, width))
    h, w = small.image.shape[-2:]
    assert max(h, w) == min(320, max(height, width))
    assert min(h, w) == max(1, round(min(height, width) * max(h, w) / max(height, width)))
    assert small.depth is not None
    assert small.depth.shape[-2:] == small.alpha.shape[-2:] == (h, w)


def test_reduced_depth_has_no_values_between() -> None:
    depth = torch.zeros(1, 1, 8, 700)
    depth[..., ::2] = 7
    small = shrink_view(View(torch.zeros(1, 3, 8, 700), depth))
    assert set(small.depth.unique().tolist()) == {0.0, 7.0}


def test_depth_is_lighter_the_nearer_and_black_where_nothing_was_hit() -> None:
    depth = torch.tensor([[[1.0, 2.0, 4.0, 8.0, 0.0]]])
    light = depth_colours(depth, depth).mean((0, 1))
    assert (light.diff() < 0).all()
    assert light[-1] == 0
    nearer = depth_colours(depth / 2, depth).mean((0, 1))
    assert (nearer[:4] > light[:4]).all()


@pytest.mark.parametrize("depth", [torch.zeros(1, 3, 4), torch.full((1, 3, 4), 5.0), torch.full((1, 3, 4), 1e-12)])
def test_depth_of_one_value_is_shown(depth: torch.Tensor) -> None:
    shown = depth_colours(depth, depth)
    assert shown.isfinite().all()
    assert (shown == shown[:, :1, :1]).all()


@pytest.mark.parametrize(("height", "width"), [(24, 32), (1, 1), (1, 40), (40, 1)])
def test_sheets_of_any_size_have_room_for_their_words(height: int, width: int) -> None:
    images = (torch.zeros(3, height, width), torch.ones(3, height, width))
    rows = (ImageRow("a", images, ("0", "1")), ImageRow("b", note="not drawn: because"))
    picture = sheet(Section("t", "", rows))
    pixels = np.asarray(picture)
    assert picture.width >= 2 * 96
    assert (pixels[:, : picture.width // 2] == 0).any(), "the black image is missing"
    words = sheet(Section("t", "", (rows[0], ImageRow("b", note=""))))
    assert np.abs(pixels.astype(int) - np.asarray(words)).max() > 50, "the reason is missing"


def test_the_page_is_one_file_that_loads_nothing(tmp_path) -> None:
    photo = view()
    sections = [*type_sections(photo, 0), gate_section(photo, {"a <b>": NoGate(), "c": "x & y"}, 0, draws=2)]
    write_page(tmp_path / "page.html", "<i>", "sub", sections, {"Key": "a\nb"})
    text = (tmp_path / "page.html").read_text()
    sources = re.findall(r'<img src="(.{30})', text)
    assert len(sources) == 2 * 5 * len(ARTEFACTS) + 2
    assert all(source.startswith("data:image/webp;base64,") for source in sources)
    assert text.count('decoding="async"') == text.count('loading="lazy"') == len(sources)
    assert "a &lt;b&gt;" in text
    assert "not drawn: x &amp; y" in text
    assert "<i>" not in text
    assert "http" not in text.replace("http-equiv", "")


def test_the_page_stays_small(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "PAGE_BYTES", 200_000)
    noise = tuple(torch.rand(8, 3, 96, 128, generator=torch.Generator().manual_seed(0)))
    write_page(tmp_path / "page.html", "t", "s", [Section("t", "", (ImageRow("r", noise * 10),))], {})
    assert (tmp_path / "page.html").stat().st_size < 200_000 * 4 / 3 + 40_000


def test_sheets_are_images(tmp_path) -> None:
    path = tmp_path / "types.png"
    sheet(type_sections(view(), 0)[0]).save(path)
    with Image.open(path) as picture:
        assert picture.size[1] > len(ARTEFACTS) * 24
