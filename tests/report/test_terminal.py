import io

from rich.console import Console

from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.terminal import comparison_table, reasons
from support.report_samples import REASON, compared


def printed(views: list[ComparedView], width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(comparison_table(views, "yard"))
    return console.file.getvalue()


def test_every_number_fits_into_eighty_columns() -> None:
    views = [compared(f"{i:04d}.png", 0.5 - i, 1) for i in range(3)]
    text = printed(views)
    assert "…" not in text
    assert text.count("21.12→21.62") == 4  # three views and their mean
    assert "21.00→20.50" in text
    assert "−1.50" in text
    assert "12" in text
    assert text.count("worst") == 1


def test_a_missing_metric_states_its_reason_once() -> None:
    assert reasons([compared(f"{i}.png", 0.5, i) for i in range(3)]) == f"lpips_alex: {REASON}"


def test_views_without_photos_show_their_time() -> None:
    assert "12" in printed([compared("a.png", 0.0, 1, photo=False)])
