import math
from pathlib import Path

import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.measure.records import Record
from gaussian_enhancer.report.collect import compared_views, provenance_of
from gaussian_enhancer.scene.rendered import RenderedView


def record(
    view: str, variant: str, kind: str = "quality", reasons: dict | None = None, **metrics: float | None
) -> Record:
    stated = {"commit": "c0ffee", "machine": "2 cores", "time": f"2026-01-0{1 + len(variant) % 2}"}
    return Record(kind, "run", "yard", "3dgs", view, variant, metrics, reasons or {}, protocol="8 bit", **stated)


@pytest.fixture
def targets() -> list[RenderedView]:
    return [RenderedView(name, lambda: torch.zeros(3, 4, 6)) for name in ("a.jpg", "b.jpg")]


@pytest.fixture
def enhanced(tmp_path: Path) -> Path:
    for index, name in enumerate(("a.png", "b.png")):
        Image.new("RGB", (6, 4), (51 * index, 0, 0)).save(tmp_path / name)
    return tmp_path


def test_records_find_their_views_by_name(targets: list[RenderedView], enhanced: Path) -> None:
    reason = {"lpips_alex": "not measured: no backbone"}
    records = [
        record("b.jpg", "enhanced", psnr=math.inf, lpips_alex=None, reasons=reason),
        record("b.jpg", "raw", psnr=20.0, lpips_alex=None, reasons=reason),
        record("b.jpg", "enhanced", kind="cost", milliseconds=7.5),
        record("other.jpg", "raw", psnr=1.0),
    ]
    first, second = compared_views(targets, enhanced, records)
    assert first.metrics_raw == first.metrics_enhanced == {}
    assert first.milliseconds is None
    assert (second.metrics_raw, second.metrics_enhanced) == ({"psnr": 20.0}, {"psnr": math.inf})
    assert (second.milliseconds, second.reasons) == (7.5, reason)
    assert second.read().enhanced[0].unique().tolist() == pytest.approx([0.2])


def test_refuses_a_target_without_its_enhanced_image(targets: list[RenderedView], enhanced: Path) -> None:
    (enhanced / "b.png").unlink()
    with pytest.raises(InputError, match=r"no enhanced image of b\.jpg"):
        compared_views(targets, enhanced, [])


def test_refuses_two_measurements_of_one_view(targets: list[RenderedView], enhanced: Path) -> None:
    with pytest.raises(InputError, match="measured twice as 'raw'"):
        compared_views(targets, enhanced, [record("a.jpg", "raw", psnr=1.0)] * 2)


def test_provenance_states_each_value_once() -> None:
    found = provenance_of([record("a", "raw"), record("a", "enhanced")], {"Weights": "sif", "Configuration": ""})
    assert found == {
        "Scene": "yard",
        "Splat": "3dgs",
        "Commit": "c0ffee",
        "Machine": "2 cores",
        "Protocol": "8 bit",
        "Measured": "2026-01-01 to 2026-01-02",
        "Weights": "sif",
    }
