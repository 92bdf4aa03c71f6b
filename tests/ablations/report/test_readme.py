"""README's figures are those of the records."""

import pytest

from ablations.report.readme import BEGIN, END, RECORDS, SCENES, insert_between_marks, text
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record, read_records
from support.paths import ROOT


def measured(run: str, scene: str, variant: str, psnr: float) -> Record:
    metrics = {"psnr": psnr, "psnr_aligned": psnr + 1, "lpips_alex": 1 / psnr}
    return Record("quality", run, scene, "3dgs", "0.png", variant, metrics, commit="c", machine="m", time="t")


def both(gain: float) -> list[Record]:
    """Two fits of every scene, at 20 and 30 dB."""
    return [
        measured(f"{scene}-{psnr}", scene, variant, psnr + more)
        for scene in SCENES
        for psnr in (20.0, 30.0)
        for variant, more in (("lr/raw", 0.0), ("lr/lr_tiny", gain))
    ]


def test_the_readme_says_what_its_records_say() -> None:
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    assert insert_between_marks(page, text(read_records(ROOT / RECORDS))) == page


def test_numbers_are_means_over_fits_and_the_worst_frame_is_told() -> None:
    made = text(both(0.5))
    assert "| fox (real) | 25.00 → 25.50 dB | +0.50 dB |" in made
    assert "In colour-aligned PSNR, every one of the 12 frames gains, at least 0.500 dB; in plain PSNR," in made
    assert "12 of 12 frames lose, at most 0.25 dB" in text(both(-0.25))


def test_a_view_without_its_raw_render_is_refused() -> None:
    with pytest.raises(InputError, match="no raw render"):
        text([one for one in both(1.0) if one.variant == "lr/lr_tiny"])


def test_only_what_stands_between_the_marks_is_replaced() -> None:
    page = f"before\n{BEGIN}\nold\n{END}\nafter"
    assert insert_between_marks(page, "new\n") == f"before\n{BEGIN}\nnew\n{END}\nafter"
    with pytest.raises(InputError, match="no place"):
        insert_between_marks("before", "new")
