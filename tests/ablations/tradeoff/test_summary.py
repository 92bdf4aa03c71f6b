"""Settings summed up over views."""

import pytest

from ablations.tradeoff.summary import summarise
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.metrics.tradeoff import mean_squared_error


def record(variant: str, view: str, time: float, psnr: float, **metrics: float) -> Record:
    own = {"milliseconds_per_megapixel": float(time), "lower_quartile": time - 1.0, "upper_quartile": time + 2.0}
    return Record(
        "tradeoff", "", "s", "", view, variant, {**own, "psnr": float(psnr), "ssim": 0.75, **metrics}, size=(1000, 500)
    )


def test_a_setting_is_summed_up_over_its_views() -> None:
    records = [
        record("a/x", "0", 10, 20, lpips_alex=0.2, peak_memory_mb=5.0),
        record("a/x", "1", 30, 30, lpips_alex=0.4),
        record("b/y", "0", 1, 20, lpips_alex=0.2),
        record("b/y", "1", 1, 20),
    ]
    (a, b), reasons = summarise(records)
    assert reasons == {}
    assert (a.name, a.milliseconds, a.low, a.high, a.psnr, a.dssim) == ("a/x", 20, 19, 22, 25, 0.25)
    assert a.perceptual == {"lpips_alex": pytest.approx(0.3)}
    assert (a.memory, a.views, a.megapixels) == (5.0, 2, 0.5)
    assert b.perceptual == {}  # one view lacks it
    assert b.error("lpips_alex") is None
    assert b.error("mse") == mean_squared_error(20.0) == pytest.approx(0.01)


def test_a_setting_that_lacks_a_view_is_missing_with_its_reason() -> None:
    gone = Record("missing", "", "s", "", "", "c/z", {}, {"row": "not trained"})
    records = [record("a/x", "0", 1, 20), record("a/x", "1", 1, 20), record("b/y", "0", 1, 20), gone]
    found, reasons = summarise(records)
    assert [one.name for one in found] == ["a/x"]
    assert reasons == {"b/y": "measured on 1 of 2 views", "c/z": "not trained"}
