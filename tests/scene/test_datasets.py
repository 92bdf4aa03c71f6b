"""Datasets as data: what conf/dataset states is complete, plausible and refused where it is not."""

import pytest
from omegaconf import OmegaConf

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene import datasets
from gaussian_enhancer.scene.datasets import dataset_names, dataset_of, published_dataset
from gaussian_enhancer.scene.published import load_published
from support.paths import CONF
from support.published_on_disk import write_synthetic


def values(name: str) -> dict:
    return OmegaConf.to_container(OmegaConf.load(CONF / "dataset" / f"{name}.yaml"))


def test_every_dataset_of_the_paper_is_there_with_its_scenes():
    found = {path.stem: dataset_of(values(path.stem)) for path in (CONF / "dataset").glob("*.yaml")}
    assert {name: len(dataset.scenes) for name, dataset in found.items()} == {
        "mip_nerf_360": 9,
        "tanks_temples": 2,
        "deep_blending": 2,
        "nerf_synthetic": 8,
    }
    assert set(found) == set(dataset_names())
    assert all(name == dataset.name for name, dataset in found.items())


def test_every_scene_has_a_configuration_of_the_same_resolution():
    for name in dataset_names():
        dataset = dataset_of(values(name))
        for scene, facts in dataset.scenes.items():
            chosen = OmegaConf.load(CONF / "scene" / "datasets" / f"{scene}.yaml")
            assert (chosen.dataset, chosen.name) == (name, scene)
            if name == "mip_nerf_360":
                official = (dataset.pyramid[chosen.downscale],)
                assert tuple(dict.fromkeys((*official, "images_4", "images"))) == facts.images, scene  # and table 1's
                outdoors = scene in ("bicycle", "flowers", "garden", "stump", "treehill")
                assert chosen.downscale == (4 if outdoors else 2), scene
            else:
                assert "downscale" not in chosen
    assert len(list((CONF / "scene" / "datasets").glob("*.yaml"))) == 21


def test_a_new_dataset_is_one_file(tmp_path, monkeypatch):
    """Layout, sizes and background are the file's; nothing else names the dataset."""
    folder = tmp_path / "dataset"
    folder.mkdir()
    made = {**values("nerf_synthetic"), "name": "mine", "title": "Mine", "background": [0.5, 0.5, 0.5]}
    OmegaConf.save(OmegaConf.create(made), folder / "mine.yaml")
    monkeypatch.setattr(datasets, "configurations", lambda: tmp_path)
    root = tmp_path / "mine" / "lego"
    write_synthetic(root)
    scene = load_published(root, dataset="mine", name="lego", photos=9)
    assert scene.background == (0.5, 0.5, 0.5)
    with pytest.raises(InputError, match=r"choose from mine$"):
        published_dataset("tanks")


def test_shared_archive_is_the_same_in_both_datasets():
    archives = [dataset_of(values(name)).archives["base"] for name in ("tanks_temples", "deep_blending")]
    assert archives[0] == archives[1]


def test_scenes_are_chosen_by_name():
    dataset = dataset_of(values("mip_nerf_360"))
    assert list(dataset.select_scenes(("room", "garden"))) == ["garden", "room"]
    assert len(dataset.select_scenes(None)) == 9
    with pytest.raises(InputError, match=r"scenes: names 'rooom'; choose from bicycle, .*room"):
        dataset.select_scenes(("rooom",))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"archives": {"base": {"file": "../a.zip", "url": "https://a"}}}, "plain file name"),
        ({"archives": {"base": {"file": "a.zip", "url": "file:///etc/passwd"}}}, "http or https"),
        ({"archives": {"base": {"file": "a.zip", "url": "https://a", "sha256": "ABC"}}}, "64 lower-case"),
        ({"archives": {"other": {"file": "a.zip", "url": "https://a"}}}, "lies in archive 'base'; name one of other"),
        ({"archives": None}, "give a mapping"),
        ({"colour": "red"}, "states 'colour'"),
    ],
)
def test_wrong_values_are_named(change, message):
    with pytest.raises(InputError, match=message):
        dataset_of({**values("tanks_temples"), **change})


def test_missing_values_are_named():
    incomplete = values("tanks_temples")
    del incomplete["licence"]
    with pytest.raises(InputError, match="'licence'"):
        dataset_of(incomplete)
