"""Lines and progress bars on the terminal."""

import io

import pytest
from omegaconf import OmegaConf
from rich.console import Console

from gaussian_enhancer.console import hides_progress, print_line


def test_a_line_is_printed_as_it_is() -> None:
    written = io.StringIO()
    line = "[bold]runs[/bold]/" + "long/" * 40 + "image.png"
    print_line(Console(file=written, width=40), line)
    assert written.getvalue() == line + "\n"


@pytest.mark.parametrize(
    ("asked", "terminal", "hidden"), [(True, True, False), (False, True, True), (True, False, True)]
)
def test_bars_are_shown_on_terminals_to_those_who_want_them(asked: bool, terminal: bool, hidden: bool) -> None:
    cfg = OmegaConf.create({"runtime": {"progress": asked}})
    assert hides_progress(cfg, Console(file=io.StringIO(), force_terminal=terminal)) is hidden
