import math
from pathlib import Path

import pytest
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.report.collect import compared_views, provenance_of


def record(
    view: str, variant: str, kind: str = "quality", reasons: dict | None = None, **metrics: float | None
) -> Record:
    stated = {"commit": "c0ffee", "machine": "2 cores", "time": f"2026-01-0{1 + len(variant) % 2}"}
    return Record(kind, "run", "yard", "3dgs", view, variant, metrics, reasons or {}, protocol="8 bit", **stated)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path, Path]:
    """Renders a and b, their enhanced images of another ending, and the photo of b among others."""
    names_by_folder = {"renders": ("a.png", "b.png"), "enhanced": ("a.webp", "b.webp"), "photos": ("b.png", "c.png")}
    for folder, names in names_by_folder.items():
        (tmp_path / folder).mkdir()
        for index, name in enumerate(names):
            Image.new("RGB", (6, 4), (51 * index, 0, 0)).save(tmp_path / folder / name, lossless=True)
    return tmp_path / "renders", tmp_path / "enhanced", tmp_path / "photos"


def test_records_find_their_views_by_name(folders: tuple[Path, Path, Path]) -> None:
    reason = {"lpips_alex": "not measured: no backbone"}
    records = [
        record("b.png", "enhanced", psnr=math.inf, lpips_alex=None, reasons=reason),
        record("b.png", "raw", psnr=20.0, lpips_alex=None, reasons=reason),
        record("b.png", "enhanced", kind="cost", milliseconds=7.5),
        record("other.png", "raw", psnr=1.0),
    ]
    first, second = compared_views(*folders, records)
    assert first.metrics_raw == first.metrics_enhanced == {}
    assert first.milliseconds is first.read_photo is None
    assert (second.metrics_raw, second.metrics_enhanced) == ({"psnr": 20.0}, {"psnr": math.inf})
    assert (second.milliseconds, second.reasons) == (7.5, reason)
    images = second.read()
    assert images.photo is not None
    assert images.photo.max() == 0
    assert images.enhanced[0].unique().tolist() == pytest.approx([0.2])


def test_refuses_a_target_without_its_enhanced_image(folders: tuple[Path, Path, Path]) -> None:
    (folders[1] / "b.webp").unlink()
    with pytest.raises(InputError, match=r"no enhanced image of b\.png"):
        compared_views(*folders, [])


def test_refuses_two_measurements_of_one_view(folders: tuple[Path, Path, Path]) -> None:
    with pytest.raises(InputError, match="measured twice as 'raw'"):
        compared_views(*folders, [record("a.png", "raw", psnr=1.0)] * 2)


def test_provenance_states_each_value_once() -> None:
    provenance = provenance_of([record("a", "raw"), record("a", "enhanced")], {"Weights": "sif", "Configuration": ""})
    assert provenance == {
        "Scene": "yard",
        "Splat": "3dgs",
        "Commit": "c0ffee",
        "Machine": "2 cores",
        "Protocol": "8 bit",
        "Measured": "2026-01-01 to 2026-01-02",
        "Weights": "sif",
    }
