"""Nothing is trained on test scenes or chosen by them."""

import re
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from ablations.scripts import candidates
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.frozen import (
    FROZEN_FAMILY,
    PROCEDURAL,
    UNTRAINED_FROM,
    is_frozen,
    refuse_frozen,
    refuse_untrained,
)
from gaussian_enhancer.scene.procedural import FAMILIES
from gaussian_enhancer.train.data import RunsData
from gaussian_enhancer.train.run_samples import RunSamples
from support.paths import ROOT

FROZEN = ["fox-3dgs-1a2b", "monstree-2dgs-1a2b", "object_5000-3dgs-1a", "indoor_7000-3dgs-1a", "harbour_0-3dgs-1a"]
SECOND = ["object_2000-3dgs-1a", "indoor_3000-3dgs-1a", "outdoor_4999-2dgs-1a"]


@pytest.mark.parametrize("name", FROZEN)
def test_nothing_is_chosen_by_a_test_scene(name):
    assert is_frozen(f"runs/fit/{name}")
    with pytest.raises(InputError, match="nothing may be chosen by"):
        refuse_frozen([f"runs/fit/{name}"])
    with pytest.raises(InputError, match="nothing may be trained on"):
        refuse_untrained([f"runs/fit/{name}"])


@pytest.mark.parametrize("name", SECOND)
def test_scenes_of_the_second_validation_choose_and_do_not_teach(name):
    refuse_frozen([f"runs/fit/{name}"])
    with pytest.raises(InputError, match="second validation, which must not be used for training"):
        refuse_untrained([f"runs/fit/{name}"])


@pytest.mark.parametrize(
    "name", ["foxglove-3dgs-1a", "object_0-3dgs-1a", "object_1000-3dgs-1a", "banana-3dgs-1a", "mine", "harbour-3dgs-1"]
)
def test_others_are_neither(name):
    assert not is_frozen(f"runs/fit/{name}")
    refuse_untrained([f"runs/fit/{name}"])


def test_every_procedural_family_is_known_here():
    assert all(PROCEDURAL.match(f"{family}_1-3dgs-1a") for family in FAMILIES)
    assert FROZEN_FAMILY in FAMILIES


def test_no_training_scene_is_drawn_from_the_frozen_family_or_from_frozen_seeds():
    """What sweeps make pairs of, and what scales learn from and choose by."""
    files = sorted((ROOT / "conf/sweep").glob("pairs_procedural*.yaml"))
    assert len(files) >= 6
    for file in files:
        params = OmegaConf.load(file).hydra.sweeper.params
        assert FROZEN_FAMILY not in str(params.scene).split(",")
        assert max(int(seed) for seed in str(params["scene.seed"]).split(",")) < UNTRAINED_FROM
    for file in sorted((ROOT / "conf/scale").glob("*.yaml")):
        trainings = OmegaConf.to_container(OmegaConf.load(file).trainings)
        assert FROZEN_FAMILY not in str(trainings)
        assert not re.search(r"scene\.seed=[2-9]\d{3}", str(trainings))


def found(folder, name):
    """A run folder with held-out renders."""
    run = folder / name
    (run / "test/ours_10/renders").mkdir(parents=True)
    (run / "test/ours_10/gt").mkdir()
    return str(run)


@pytest.mark.parametrize(("train", "validation"), [("fox-3dgs-1", "plane"), ("plane", "object_5000-3dgs-1")])
def test_a_training_that_names_one_is_refused_before_anything_is_read(tmp_path, train, validation):
    sides = [found(tmp_path, train)], [found(tmp_path, validation)]
    data = RunsData(*sides, RunSamples(ReferenceConfig(), tmp_path / "samples"))
    with pytest.raises(InputError, match="frozen test scene"):
        data.prepare_data()


def test_a_choice_of_weights_that_names_one_is_refused(tmp_path):
    (Path(found(tmp_path, "monstree-3dgs-1")) / "done").write_text("{}")
    cfg = OmegaConf.create({"runs": [str(tmp_path / "monstree-*")], "weights": ["lr_tiny"]})
    with pytest.raises(InputError, match="nothing may be chosen by"):
        candidates.study(cfg, torch.device("cpu"))
