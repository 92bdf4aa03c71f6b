"""What a scene's configuration needs and costs, without loading anything."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from gaussian_enhancer.apps.build import build
from gaussian_enhancer.apps.finer import finer_config
from gaussian_enhancer.apps.inputs import missing_inputs, registered, scene_cost
from gaussian_enhancer.errors import InputError

CONF = Path(__file__).parents[2] / "conf"
SCENES = sorted(path.stem for path in (CONF / "scene" / "datasets").glob("*.yaml"))


def scene(*overrides: str) -> DictConfig:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("fit", list(overrides)).scene


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
    assert scene_cost(scene("scene=object")) is None


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_composes_costs_and_asks_for_its_files(root, name):
    chosen = scene(f"scene=datasets/{name}")
    with pytest.raises(InputError, match=rf"gaussian-enhancer download dataset={chosen.dataset} scenes=\[{name}\]"):
        build(chosen)
    cost = scene_cost(chosen)
    assert cost.photos == chosen.photos
    assert cost.test_photos == (200 if chosen.dataset == "nerf_synthetic" else -(-chosen.photos // 8))
    assert 0.5 < cost.width * cost.height / 1e6 < 2.0
    assert 0.1 < cost.fit_hours < 1.0
    assert cost.enhance_hours == pytest.approx(0.45 * cost.megapixels / 3600)
    assert "fit:" in cost.basis


def test_cost_follows_the_resolution(root):
    quarter = scene_cost(scene("scene=datasets/room", "scene.downscale=4"))
    half, whole = (scene_cost(scene("scene=datasets/room", f"scene.downscale={n}")) for n in (2, 1))
    assert (half.width, half.height) == (1557, 1038)
    assert quarter.megapixels == pytest.approx(half.megapixels / 4, rel=0.01)
    assert whole.fit_hours == pytest.approx(4 * half.fit_hours)
    assert quarter.fit_hours == half.fit_hours  # smaller photos are not promised to fit faster


def test_scenes_of_table_1_have_photos_four_times_as_fine(root):
    for name in registered("mip_nerf_360").scenes:
        finer = finer_config(scene(f"scene=datasets/{name}", "scene.downscale=4"))
        assert finer.downscale == 1
        assert missing_inputs(finer)[0][0] == root / "mip_nerf_360" / name / "images"
    with pytest.raises(InputError, match="finer photos exist"):
        finer_config(scene("scene=datasets/truck"))


def test_unknown_datasets_are_named():
    with pytest.raises(InputError, match="has no 'mip_nerf'; choose from deep_blending, mip_nerf_360"):
        registered("mip_nerf")
