"""What simple_trainer leaves, as its own code saves it."""

from pathlib import Path

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.rendered_capture import open_renderer
from gaussian_enhancer.splat.io.gsplat_results import refuse_normalised
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.types import identity_camera
from support.foreign_splats import COUNT, same, splat, write_checkpoint

CONFIG = (
    "data_dir: data/garden\nnormalize_world_space: {}\nstrategy: !!python/object:gsplat.DefaultStrategy\n  key: a\n"
)


@pytest.mark.parametrize("degree", [0, 3])
def test_a_checkpoint_is_the_splat(tmp_path: Path, degree: int) -> None:
    write_checkpoint(tmp_path / "ckpts/ckpt_29999_rank0.pt", splat(degree))
    assert same(read_splat(tmp_path / "ckpts/ckpt_29999_rank0.pt"), splat(degree))
    assert same(read_splat(tmp_path), splat(degree))


def test_the_parts_of_all_ranks_are_joined(tmp_path: Path) -> None:
    whole = splat(1)
    write_checkpoint(tmp_path / "ckpts/ckpt_6999_rank0.pt", splat(2))
    for rank, part in enumerate(map(whole.__getitem__, torch.arange(COUNT).tensor_split(3))):
        write_checkpoint(tmp_path / f"ckpts/ckpt_29999_rank{rank}.pt", part)
    assert same(read_splat(tmp_path), whole)
    assert same(read_splat(tmp_path / "ckpts/ckpt_29999_rank2.pt"), whole)
    (tmp_path / "ckpts/ckpt_29999_rank1.pt").unlink()
    with pytest.raises(InputError, match=r"lies beside ranks \[0, 2\], of which one is missing"):
        read_splat(tmp_path)


def test_a_splat_in_other_coordinates_than_its_capture_is_refused(tmp_path: Path) -> None:
    write_checkpoint(tmp_path / "ckpts/ckpt_29999_rank0.pt", splat(1))
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
    write_checkpoint(tmp_path / "ckpt.pt", splat(1), **changes)
    with pytest.raises(InputError, match=found):
        read_splat(tmp_path / "ckpt.pt")


def test_other_archives_and_damage_are_refused(tmp_path: Path) -> None:
    torch.save({"step": 3}, tmp_path / "a.pt")
    with pytest.raises(InputError, match='has no "splats"'):
        read_splat(tmp_path / "a.pt")
    torch.save([1, 2], tmp_path / "a.pt")
    with pytest.raises(InputError, match='has no "splats"'):
        read_splat(tmp_path / "a.pt")
    write_checkpoint(tmp_path / "b.pt", splat(3))
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
    write_checkpoint(tmp_path / "a.pt", splat(0), **changes, **more, shN=torch.ones(1, 0, 3).expand(count, 0, 3))
    assert (tmp_path / "a.pt").stat().st_size < 10_000
    with pytest.raises(InputError, match=r"claims 1000000 Gaussians, which takes up to 0\.1 GB"):
        read_splat(tmp_path / "a.pt")
