import math
import re
from html.parser import HTMLParser

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.report.cards import pictured_indices
from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.page import document
from support.page_data import page_data
from support.report_samples import NASTY, REASON, compared

VOID = {"meta", "link", "img", "input"}
LOADING = {"src", "href", "srcset", "action", "poster", "data", "formaction", "background"}


class Checked(HTMLParser):
    """Every element closed in order; attributes and texts kept for looking at."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"an attribute twice in <{tag}>: {names}"
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((self.open[-1] if self.open else "", data))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def page(views: list[ComparedView], provenance: dict[str, str]) -> str:
    return document("A <b>title</b>", views, provenance)


def test_every_element_is_closed_and_ids_are_unique(page: str) -> None:
    identifiers = [attributes["id"] for _, attributes in Checked(page).elements if "id" in attributes]
    assert len(identifiers) == len(set(identifiers)) >= 4


def test_nothing_is_loaded_from_elsewhere(page: str) -> None:
    checked = Checked(page)
    for tag, attributes in checked.elements:
        for name in LOADING & attributes.keys():
            assert re.match(r"data:|#", attributes[name] or ""), f"<{tag} {name}={attributes[name]!r:.60}>"
    styles = "".join(text for tag, text in checked.texts if tag == "style")
    assert "url(" not in styles
    assert "@import" not in styles
    assert len(styles) > 1000
    policy = next(a["content"] for a in checked.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert policy
    assert "default-src 'none'" in policy
    assert not re.search(r"https?://", page)


def test_names_are_text_and_never_markup(page: str) -> None:
    checked = Checked(page)
    shown = NASTY.replace("\ud800", "\ufffd")
    assert len(checked.all("script")) == 2
    assert shown in [text for tag, text in checked.texts if tag == "h3"]
    assert "A <b>title</b>" in [text for tag, text in checked.texts if tag in ("h1", "title")]
    assert any(attributes.get("alt") == f"render, {shown}" for attributes in checked.all("img"))
    assert page_data(page)["views"][1]["name"] == NASTY


def test_numbers_equal_the_input_exactly(page: str, views: list[ComparedView]) -> None:
    entries = page_data(page)["views"]
    for view, entry in zip(views, entries, strict=True):
        assert entry["raw"] == dict(view.metrics_raw)
        assert entry["enhanced"] == dict(view.metrics_enhanced)
        assert entry["milliseconds"] == view.milliseconds
    values = [a["data-value"] for a in Checked(page).all("td") if a.get("data-of") == "raw"]
    keys = ("psnr", "psnr_aligned", "ssim")
    assert [float(v or "nan") for v in values] == [view.metrics_raw[key] for view in views for key in keys]


def test_the_missing_metric_states_its_reason(page: str) -> None:
    texts = [text for tag, text in Checked(page).texts if tag == "td"]
    assert texts.count(REASON) == 3


def test_the_worst_frame_is_marked_once_and_gains_are_coloured(page: str) -> None:
    article = page[page.index('id="view-1"') : page.index('id="view-2"')]
    assert page.count("worst frame") == 1
    assert "worst frame" in article
    assert re.search(r'<td class="worse" data-of="gain" data-value="-0.25">−0.25</td>', article)
    assert re.search(r'<td class="better" data-of="gain" data-value="0.5">\+0.50</td>', page)
    third = page[page.index('id="view-2"') :]
    assert re.search(r'<td class="same" data-of="gain" [^>]*>±0.00</td>', third)


def test_identical_images_leave_valid_json_and_say_so() -> None:
    view = compared("a.png", 0.0, 1)
    same = ComparedView("b.png", view.read_raw, view.read_raw, view.read_raw, {"psnr": math.inf}, {"psnr": math.inf})
    text = document("t", [view, same], {})
    assert page_data(text)["views"][1]["raw"] == {"psnr": "inf"}
    assert page_data(text)["summary"]["psnr"]["n"] == 1
    assert "1 not finite, left out" in text
    assert "∞" in text


def test_views_without_photos_have_no_numbers_and_no_error_maps() -> None:
    text = document("t", [compared("a.png", 0.0, 1, photo=False)], {})
    checked = Checked(text)
    assert [a["class"] for a in checked.all("img")] == ["raw", "enhanced"]
    assert "nothing to measure against" in text
    assert not any(a.get("data-mode") for a in checked.all("button"))


def test_the_page_stays_small(views: list[ComparedView]) -> None:
    big = torch.rand(3, 900, 1700, generator=torch.Generator().manual_seed(0))
    text = document("t", [ComparedView("big.png", lambda: big, lambda: big.flip(0))], {})
    assert len(text) < 2 * 600_000 * 4 / 3 + 60_000


def test_a_long_report_pictures_an_even_choice_with_the_worst() -> None:
    chosen = pictured_indices(200, 77, 10)
    assert len(chosen) == 10
    assert {0, 77, 199} <= set(chosen)
    assert chosen == sorted(chosen)
    assert pictured_indices(5, None, 10) == [0, 1, 2, 3, 4]
    views = [compared(f"{i}.png", 1.0 if i != 5 else -1.0, 1, height=8, width=8) for i in range(9)]
    text = document("t", views, {}, most_pictured=3)
    assert len(Checked(text).all("article")) == 3
    assert 'id="view-5"' in text
    assert len(page_data(text)["views"]) == 9
    assert "pictures of 3, numbers of all" in text


def test_the_file_is_written_whole(tmp_path, views: list[ComparedView], provenance: dict[str, str]) -> None:
    path = tmp_path / "deep" / "report.html"
    write_text(path, document("Title", views, provenance))
    assert path.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    before = path.read_bytes()
    with pytest.raises(InputError, match="occurs twice"):
        write_text(path, document("Title", [views[0], views[0]], provenance))
    assert path.read_bytes() == before


def test_refuses_nothing_and_images_that_differ_in_size(views: list[ComparedView]) -> None:
    with pytest.raises(InputError, match="no view"):
        document("t", [], {})
    view = views[0]
    with pytest.raises(InputError, match=r"photo has size 32×48, the render 64×48"):
        document("t", [ComparedView("a", view.read_raw, view.read_enhanced, lambda: view.read_raw()[..., :32])], {})
