"""Inserted texts are those of the records, and nothing else of a page changes."""

from pathlib import Path

import pytest

from ablations.report.inserted_text import BEGIN, END, PAGES, TEXTS, fill_page, insert_between_marks
from gaussian_enhancer.errors import InputError
from support.paths import ROOT

BEGIN_TEST = BEGIN.format("docs/results/test.jsonl")


@pytest.mark.parametrize("name", PAGES)
def test_every_page_says_what_its_records_say(name: str) -> None:
    page = (ROOT / name).read_text(encoding="utf-8")
    assert fill_page(page, ROOT, name) == page


def test_every_text_is_on_a_page() -> None:
    text = "".join((ROOT / name).read_text(encoding="utf-8") for name in PAGES)
    assert [records for records in TEXTS if BEGIN.format(records) not in text] == []


def test_only_what_stands_between_the_marks_is_replaced() -> None:
    page = f"before\n{BEGIN_TEST}\nold\n{END}\nafter"
    assert insert_between_marks(page, "new\n", BEGIN_TEST, "x") == f"before\n{BEGIN_TEST}\nnew\n{END}\nafter"


def test_a_page_without_marks_is_refused() -> None:
    with pytest.raises(InputError, match="no place"):
        insert_between_marks("before", "new", BEGIN_TEST, "x")
    with pytest.raises(InputError, match=r"docs/video\.md: has no place for its figures"):
        fill_page("no marks", Path(), "docs/video.md")
    with pytest.raises(InputError, match="has no place"):
        fill_page(f"{BEGIN_TEST}\nno end", ROOT, "README.md")
