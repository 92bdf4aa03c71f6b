"""What simple_trainer leaves, as its own code saves it."""

from collections import OrderedDict
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.rendered_capture import open_renderer
from gaussian_enhancer.splat.io.gsplat_results import find_splat, refuse_normalised
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.types import Gaussians, identity_camera
from support.foreign_splats import COUNT, FIELDS, bare, splat, write

CONFIG = (
    "data_dir: data/garden\nnormalize_world_space: {}\nstrategy: !!python/object:gsplat.DefaultStrategy\n  key: a\n"
)


def saved(path: Path, gaussians: Gaussians, **changes: object) -> None:
    """A checkpoint as ``torch.save({"step": step, "splats": self.splats.state_dict()}, path)`` leaves it."""
    splats: OrderedDict[str, object] = OrderedDict(
        means=gaussians.means,
        scales=gaussians.log_scales,
        quats=gaussians.quaternions,
        opacities=gaussians.opacity_logits,
        sh0=gaussians.sh[:, :1].contiguous(),
        shN=gaussians.sh[:, 1:].contiguous(),
    )
    splats.update(changes)
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"step": 29999, "splats": OrderedDict((k, v) for k, v in splats.items() if v is not None)}, path)


def same(found: Gaussians, expected: Gaussians) -> bool:
    return all(torch.equal(getattr(found, name), getattr(expected, name)) for name in FIELDS)


@pytest.mark.parametrize("degree", [0, 3])
def test_a_checkpoint_is_the_splat(tmp_path: Path, degree: int) -> None:
    saved(tmp_path / "ckpts/ckpt_29999_rank0.pt", splat(degree))
    assert same(read_splat(tmp_path / "ckpts/ckpt_29999_rank0.pt"), splat(degree))
    assert same(read_splat(tmp_path), splat(degree))


def test_the_parts_of_all_ranks_are_joined(tmp_path: Path) -> None:
    whole = splat(1)
    saved(tmp_path / "ckpts/ckpt_6999_rank0.pt", splat(2))
    for rank, part in enumerate(map(whole.__getitem__, torch.arange(COUNT).tensor_split(3))):
        saved(tmp_path / f"ckpts/ckpt_29999_rank{rank}.pt", part)
    assert same(read_splat(tmp_path), whole)
    assert same(read_splat(tmp_path / "ckpts/ckpt_29999_rank2.pt"), whole)
    (tmp_path / "ckpts/ckpt_29999_rank1.pt").unlink()
    with pytest.raises(InputError, match=r"lies beside ranks \[0, 2\], of which one is missing"):
        read_splat(tmp_path)


def test_the_latest_step_is_taken_and_its_ply_before_its_checkpoint(tmp_path: Path) -> None:
    for step in (6999, 29999):
        saved(tmp_path / f"ckpts/ckpt_{step}_rank0.pt", splat(1))
    (tmp_path / "ply").mkdir()
    write(tmp_path / "ply/point_cloud_6999.ply", splat(2), bare(2))
    assert find_splat(tmp_path).name == "ckpt_29999_rank0.pt"
    write(tmp_path / "ply/point_cloud_29999.ply", splat(3), bare(3))
    assert find_splat(tmp_path).name == "point_cloud_29999.ply"
    assert same(read_splat(tmp_path), splat(3))


def test_a_splat_in_other_coordinates_than_its_capture_is_refused(tmp_path: Path) -> None:
    saved(tmp_path / "ckpts/ckpt_29999_rank0.pt", splat(1))
    cameras = [identity_camera(8, 8, 8.0)]
    for place in (tmp_path, tmp_path / "ckpts/ckpt_29999_rank0.pt"):
        (tmp_path / "cfg.yml").write_text(CONFIG.format("true"))
        with pytest.raises(InputError, match=r"cfg\.yml: says normalize_world_space: true.*--no-normalize-world-space"):
            open_renderer(place, cameras, (0.0, 0.0, 0.0))
        assert same(read_splat(place), splat(1))  # by itself it can be read
        (tmp_path / "cfg.yml").write_text(CONFIG.format("false"))
        assert len(open_renderer(place, cameras, (0.0, 0.0, 0.0)).gaussians) == COUNT
    (tmp_path / "cfg.yml").unlink()
    refuse_normalised(tmp_path)


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        (
            {"sh0": None, "shN": None, "features": torch.zeros(COUNT, 32)},
            "has no sh0, shN among its splats; give the .ply",
        ),
        ({"quats": torch.zeros(COUNT, 3)}, r"has quats of shape \(5, 3\) for 5 Gaussians"),
        ({"opacities": torch.zeros(COUNT - 1)}, r"has opacities of shape \(4,\) for 5 Gaussians"),
        ({"shN": torch.zeros(COUNT, 24, 3)}, "has 24 higher harmonics; train with a degree of 0 to 3"),
        ({"means": torch.full((COUNT, 3), float("nan"))}, "5 of 5 Gaussians are not finite"),
    ],
)
def test_what_cannot_be_rendered_is_refused(tmp_path: Path, changes: dict[str, object], found: str) -> None:
    saved(tmp_path / "ckpt.pt", splat(1), **changes)
    with pytest.raises(InputError, match=found):
        read_splat(tmp_path / "ckpt.pt")


def test_other_archives_and_damage_are_refused(tmp_path: Path) -> None:
    torch.save({"step": 3}, tmp_path / "a.pt")
    with pytest.raises(InputError, match='has no "splats"'):
        read_splat(tmp_path / "a.pt")
    torch.save([1, 2], tmp_path / "a.pt")
    with pytest.raises(InputError, match='has no "splats"'):
        read_splat(tmp_path / "a.pt")
    saved(tmp_path / "b.pt", splat(3))
    content = (tmp_path / "b.pt").read_bytes()
    for keep in (5, 100, len(content) // 2, len(content) - 1):
        (tmp_path / "b.pt").write_bytes(content[:keep])
        with pytest.raises(InputError, match=r"b\.pt: "):
            read_splat(tmp_path / "b.pt")


def test_a_checkpoint_that_would_run_code_is_refused(tmp_path: Path) -> None:
    marker = tmp_path / "ran"

    class Harmful:
        def __reduce__(self):
            return (Path.touch, (marker,))

    torch.save({"splats": Harmful()}, tmp_path / "a.pt")
    with pytest.raises(InputError, match="no checkpoint that can be read"):
        read_splat(tmp_path / "a.pt")
    assert not marker.exists()


def test_a_tensor_that_claims_more_than_the_file_holds_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("GAUSSIAN_ENHANCER_READ_LIMIT", "0.001")
    count = 10**6
    wide = {"means": 3, "scales": 3, "quats": 4}
    changes = {name: torch.ones(1, axes).expand(count, axes) for name, axes in wide.items()}
    more = {"opacities": torch.ones(1).expand(count), "sh0": torch.ones(1, 1, 3).expand(count, 1, 3)}
    saved(tmp_path / "a.pt", splat(0), **changes, **more, shN=torch.ones(1, 0, 3).expand(count, 0, 3))
    assert (tmp_path / "a.pt").stat().st_size < 10_000
    with pytest.raises(InputError, match=r"claims 1000000 Gaussians, which takes up to 0\.1 GB"):
        read_splat(tmp_path / "a.pt")


def test_a_folder_without_a_splat_is_refused(tmp_path: Path) -> None:
    (tmp_path / "ckpts").mkdir()
    (tmp_path / "ckpts/other.pt").write_bytes(b"")
    with pytest.raises(InputError, match=r"is a folder without ply/point_cloud_STEP\.ply and ckpts/"):
        read_splat(tmp_path)
