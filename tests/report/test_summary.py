import dataclasses
import math
import statistics

import pytest

from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.quantities import KNOWN, quantities
from gaussian_enhancer.report.summary import measured_quantities, summarise, worst_view
from support.report_samples import compared

BY_KEY = {quantity.key: quantity for quantity in KNOWN}


def with_numbers(name: str, **pairs: tuple[float, float]) -> ComparedView:
    view = compared(name, 0.0, 1, height=4, width=4)
    raw = {key: pair[0] for key, pair in pairs.items()}
    return dataclasses.replace(view, metrics_raw=raw, metrics_enhanced={key: pair[1] for key, pair in pairs.items()})


def test_mean_spread_and_count() -> None:
    pairs = [(20.0, 21.0), (22.0, 22.5), (25.0, 24.0)]
    summary = summarise([with_numbers(str(i), psnr=pair) for i, pair in enumerate(pairs)], BY_KEY["psnr"])
    gains = [b - a for a, b in pairs]
    assert summary.comparison.gain == pytest.approx(statistics.fmean(gains))
    assert summary.comparison.deviation == pytest.approx(statistics.stdev(gains))
    assert (summary.comparison.count, summary.improved, summary.worst) == (3, 2, 2)


def test_a_lower_distance_is_better_and_the_highest_rise_worst() -> None:
    views = [with_numbers("a", lpips_alex=(0.3, 0.2)), with_numbers("b", lpips_alex=(0.3, 0.31))]
    summary = summarise(views, BY_KEY["lpips_alex"])
    assert (summary.improved, summary.worst) == (1, 1)
    assert BY_KEY["lpips_alex"].verdict(-0.1) == "better"
    assert BY_KEY["psnr"].verdict(-0.1) == "worse"
    assert BY_KEY["psnr"].verdict(0.004) == "same"
    assert BY_KEY["psnr"].verdict(math.inf) == "better"


def test_one_view_has_no_spread() -> None:
    assert math.isnan(summarise([with_numbers("a", psnr=(1.0, 2.0))], BY_KEY["psnr"]).comparison.deviation)


def test_the_worst_frame_is_decided_by_colour_aligned_psnr_first() -> None:
    views = [
        with_numbers("a", psnr=(20.0, 19.0), psnr_aligned=(20.0, 21.0)),
        with_numbers("b", psnr=(20.0, 21.0), psnr_aligned=(20.0, 20.5)),
    ]
    assert worst_view([summarise(views, quantity) for quantity in measured_quantities(views)]) == 1


def test_unknown_metrics_are_kept_without_a_direction() -> None:
    metrics = quantities({"zebra", "ssim", "psnr"})
    assert [quantity.key for quantity in metrics] == ["psnr", "ssim", "zebra"]
    assert metrics[2].verdict(1.0) == "same"
