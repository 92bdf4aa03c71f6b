"""Figures of the README and of the documentation's first page are those of the records."""

import pandas as pd
import pytest

from ablations.report.readme import CAPTURES, SCENES, converged_table, frozen_test_sentence
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record


def measured(run: str, scene: str, variant: str, psnr: float) -> Record:
    metrics = {"psnr": psnr, "psnr_aligned": psnr + 1, "lpips_alex": 1 / psnr}
    return Record("quality", run, scene, "3dgs", "0.png", variant, metrics, commit="c", machine="m", time="t")


def both(gain: float) -> list[Record]:
    """Two fits of every scene, at 20 and 30 dB."""
    return [
        measured(f"{scene}-{psnr}", f"{scene}_5000", variant, psnr + more)
        for scene in SCENES
        for psnr in (20.0, 30.0)
        for variant, more in (("lr/raw", 0.0), ("lr/lr_tiny", gain))
    ]


def test_numbers_are_means_over_fits_and_the_worst_frame_is_told() -> None:
    made = frozen_test_sentence(both(0.5))
    assert made.startswith("Gains: fox (real) +0.50 dB, monstree (real) +0.50 dB, harbour (family unseen in training)")
    assert "In colour-aligned PSNR, all 14 frames gain, at least 0.500 dB; in plain PSNR, all 14 frames gain," in made
    assert "14 of 14 frames lose, at most 0.25 dB" in frozen_test_sentence(both(-0.25))


def test_a_view_without_its_raw_render_is_refused() -> None:
    with pytest.raises(InputError, match="no raw render"):
        frozen_test_sentence([one for one in both(1.0) if one.variant == "lr/lr_tiny"])


def test_converged_splats_are_shown_at_their_last_step_with_what_loses() -> None:
    def row(scene: str, step: int, gain: float, method: str = "lr_tiny two steps") -> dict[str, object]:
        measured = {"raw_psnr_aligned": 25.0, "gain_psnr_aligned": gain, "blocks_harmed": 0.04}
        return {"method": method, "scene": scene, "step": step, **measured}

    rows = [row(scene, 7000, 1.0) for scene in CAPTURES if scene not in ("banana", "plush")]
    rows += [row("banana", 15000, 1.0), row("banana", 15000, 2.0), row("banana", 999, 9.0), row("plush", 15000, -0.5)]
    rows += [row("banana", 15000, 0.5, "lr_tiny"), row("plush", 15000, -0.7, "lr_tiny")]
    made = converged_table(pd.DataFrame([*rows, row("plush", 15000, 9.0, "lr_tiny@1 plain")]))
    assert "| banana (validation) | 15,000 | 25.00 | +1.50 | +1.00 | 0/2 | 4.0% |" in made
    assert "| plush (validation) | 15,000 | 25.00 | -0.50 | **-0.50** | 1/1 | 4.0% |" in made
    assert made.endswith("\nMean of the 2 at 15,000 steps: +0.50 dB (-0.10 from one step), 4.0% of blocks worse.\n")
