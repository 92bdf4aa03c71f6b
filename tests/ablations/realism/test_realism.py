from pathlib import Path

import pytest
import torch

from ablations.realism.patches import RenderPair
from ablations.realism.realism import (
    distances,
    photographed,
    real_renders,
    simulated_pairs,
)
from ablations.scripts import realism
from ablations.study.fits import finished_runs, scene_of
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import NoGate
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record, write_records
from support.job_config import job_config
from support.synthetic_runs import write_plane_run


class Noisy:
    """A second stage that draws from the generators it is given."""

    def __call__(self, manual, generators, real=None):
        noise = torch.stack([torch.randn(3, 1, 1, generator=generator) for generator in generators])
        return View(manual.image + 0.1 * noise, manual.depth, manual.alpha)


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("fit")
    return [write_plane_run(folder / f"plane_{i}-3dgs-0123456{i}", seed=i, views=12, steps=(50, 100)) for i in range(2)]


def test_runs_are_found_by_pattern_and_unfinished_ones_named(runs, tmp_path):
    done, unfinished = finished_runs([str(runs[0].parent / "plane_*")])
    assert done == sorted(runs)
    assert unfinished == []
    copied = tmp_path / "plane_2-3dgs-01234562"
    write_plane_run(copied)
    (tmp_path / "plane_3-3dgs-01234563").mkdir()
    done, unfinished = finished_runs([str(tmp_path / "*")])
    assert done == [copied]
    assert [one.name for one in unfinished] == ["plane_3-3dgs-01234563"]
    with pytest.raises(InputError, match="no finished run"):
        finished_runs([str(tmp_path / "plane_3*")])


def test_a_scene_is_named_by_records_or_by_the_folder(tmp_path):
    assert scene_of(Path("runs/object_2-mip_splatting-578ed12c")) == "object_2"
    assert scene_of(Path("my-scene-2dgs-578ed12c")) == "my-scene"
    write_records(tmp_path / "named/records.jsonl", [Record("cost", "named", "fox", "3dgs", "", "raw", {})])
    assert scene_of(tmp_path / "named") == "fox"  # fitted with output=named
    with pytest.raises(InputError, match="SCENE-METHOD-DIGEST"):
        scene_of(Path("plane-0"))


def test_every_snapshot_counts_and_runs_share_evenly(runs):
    everything = real_renders(runs)
    assert len(everything) == 2 * 2 * 3
    some = real_renders(runs, count=4)
    assert [one.scene for one in some] == ["plane_0"] * 2 + ["plane_1"] * 2
    names = [(one.scene, one.target.name, id(one.splat)) for one in everything]
    assert len(set(names)) == len(names)


def test_pairs_hold_photo_and_both_renders_and_depend_on_the_seed_alone(runs):
    reals = real_renders(runs)
    rows = [lambda splat: Simulator(NoGate()), lambda splat: Simulator(NoGate(), Noisy())]
    clean, noisy = (list(simulated_pairs(reals, row)) for row in rows)
    assert all(torch.equal(pair.simulated, pair.photo) for pair in clean)
    assert not any(torch.equal(pair.simulated, pair.photo) for pair in noisy)
    for pair, real in zip(clean, reals, strict=True):
        torch.testing.assert_close(pair.real.float() / 255, real.target.read())
        torch.testing.assert_close(pair.photo.float() / 255, photographed(real).image[0])
    again = list(simulated_pairs(reals, rows[1]))
    assert all(torch.equal(one.simulated, other.simulated) for one, other in zip(noisy, again, strict=True))
    other = list(simulated_pairs(reals, rows[1], seed=1))
    assert not any(torch.equal(a.simulated, b.simulated) for a, b in zip(noisy, other, strict=True))


def test_a_simulator_is_made_once_for_each_splat_from_that_splat(runs):
    made = []

    def row(splat):
        made.append(splat)
        return Simulator(NoGate())

    reals = real_renders(runs)
    list(simulated_pairs(reals, row))
    assert [id(one) for one in made] == list(dict.fromkeys(id(one.splat) for one in reals))


def test_photographs_come_with_the_splats_depth_and_opacity(runs):
    view = photographed(real_renders(runs)[0])
    assert view.depth is not None
    assert view.alpha is not None
    assert view.depth.min() > 0


def test_distances_vanish_for_equal_renders_and_see_a_weaker_simulation(runs):
    pairs = list(simulated_pairs(real_renders(runs), lambda splat: Simulator(NoGate())))
    same = distances([RenderPair(p.scene, p.view, p.photo, p.real, p.real) for p in pairs])
    assert same["psnr_simulated_db"] == same["psnr_real_db"]
    assert all(same[name] == 0 for name in same if not name.startswith("psnr"))
    clean = distances(pairs)
    assert clean["psnr_simulated_db"] > 50 > clean["psnr_real_db"]
    assert clean["spectrum_residual_db"] > clean["spectrum_image_db"] > 1


def test_the_classifier_learns_from_no_test_scene_whatever_its_folder_is_called(tmp_path):
    named = write_plane_run(tmp_path / "monstree-3dgs-01234567")
    renamed = write_plane_run(tmp_path / "mine")
    write_records(renamed / "records.jsonl", [Record("cost", "mine", "fox", "3dgs", "", "raw", {})])
    for run in (named, renamed):
        cfg = job_config("realism", f"train=[{run}]", f"test=[{run}]", "rows=[naive]")
        with pytest.raises(InputError, match=r"frozen test scene.*nothing may be trained on it"):
            realism.study(cfg, torch.device("cpu"))
