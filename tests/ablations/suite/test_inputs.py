"""What a scene's configuration needs, and how long its fit takes, without loading anything."""

from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from ablations.suite.inputs import missing_inputs, published_fit_minutes
from ablations.suite.time_estimates import Estimates
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.high_resolution import high_resolution_config
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.scene.datasets import published_dataset
from support.job_config import job_config
from support.paths import CONF

SCENES = sorted(path.stem for path in (CONF / "scene" / "datasets").glob("*.yaml"))


def scene(*overrides: str) -> DictConfig:
    return job_config("fit", *overrides).scene


@pytest.fixture
def root(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATASETS", str(tmp_path))
    return tmp_path


def test_what_is_missing_is_named_with_the_command(root):
    found = missing_inputs(scene("scene=datasets/room"))
    folder = root / "mip_nerf_360" / "room"
    assert [path for path, _ in found] == [folder / "images_2", folder / "sparse/0"]
    command = f"gaussian-enhancer download dataset=mip_nerf_360 scenes=[room] images=[images_2] folder={root}"
    assert all(command in remedy for _, remedy in found)


def test_unset_variable_is_named_and_the_rest_of_the_path_too(monkeypatch):
    monkeypatch.delenv("GAUSSIAN_ENHANCER_DATASETS", raising=False)
    found = missing_inputs(scene("scene=datasets/lego"))
    assert found[0][0] == Path("$GAUSSIAN_ENHANCER_DATASETS/nerf_synthetic/lego/transforms_train.json")
    assert found[0][1].startswith(
        "set GAUSSIAN_ENHANCER_DATASETS to a folder, then fetch it: gaussian-enhancer download"
    )


def test_other_scenes(tmp_path, monkeypatch):
    monkeypatch.delenv("GAUSSIAN_ENHANCER_DATA", raising=False)
    assert missing_inputs(scene("scene=object")) == []
    assert missing_inputs(scene("scene=capture", f"scene.path={tmp_path}")) == []
    assert missing_inputs(scene("scene=capture", f"scene.path={tmp_path}/x"))[0][0] == tmp_path / "x"
    path, remedy = missing_inputs(scene("scene=captures/fox"))[0]
    assert path == Path("$GAUSSIAN_ENHANCER_DATA/captures/fox")
    assert "set GAUSSIAN_ENHANCER_DATA" in remedy
    assert missing_inputs(scene("scene=capture"))[0][0] == Path("scene.path")
    assert published_fit_minutes(scene("scene=object")) is None


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_composes_asks_for_its_files_and_has_a_published_time(root, name):
    chosen = scene(f"scene=datasets/{name}")
    with pytest.raises(InputError, match=rf"gaussian-enhancer download dataset={chosen.dataset} scenes=\[{name}\]"):
        build(chosen)
    assert 6 < published_fit_minutes(chosen) < 60
    assert published_fit_minutes(scene(f"scene=datasets/{name}", "scene.name=own")) is None


def test_times_follow_the_resolution_upwards(root):
    half, whole, quarter = (
        published_fit_minutes(scene("scene=datasets/room", f"scene.downscale={n}")) for n in (2, 1, 4)
    )
    assert half == pytest.approx(1708 / 60)
    assert whole == pytest.approx(4 * half)
    assert quarter == half  # smaller photos are not promised to fit faster


def test_a_dry_run_reckons_with_what_was_published_where_no_finished_fit_tells(root):
    estimates = Estimates(root / "runs", OmegaConf.create({"minutes": {"fit": 0.7}}))
    room, procedural = (
        job_config("fit", f"scene={name}", "settings.steps=15000") for name in ("datasets/room", "object")
    )
    assert estimates.minutes("fit", room) == pytest.approx(1708 / 60 / 2)
    assert estimates.minutes("fit", procedural) == pytest.approx(0.7 * 15)


def test_scenes_of_table_1_have_photos_four_times_as_fine(root):
    for name in published_dataset("mip_nerf_360").scenes:
        finer = high_resolution_config(scene(f"scene=datasets/{name}", "scene.downscale=4"))
        assert finer.downscale == 1
        assert missing_inputs(finer)[0][0] == root / "mip_nerf_360" / name / "images"
    with pytest.raises(InputError, match="photos of 4 times the resolution exist"):
        high_resolution_config(scene("scene=datasets/truck"))


def test_unknown_datasets_are_named():
    with pytest.raises(InputError, match="is 'mip_nerf'; choose from deep_blending, mip_nerf_360"):
        published_dataset("mip_nerf")
