"""Nothing is trained on test scenes or chosen by them."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from ablations.scripts import candidates
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.frozen import is_frozen, refuse_frozen
from gaussian_enhancer.train.data import RunsData
from gaussian_enhancer.train.run_samples import RunSamples


@pytest.mark.parametrize("name", ["fox-3dgs-1a2b", "monstree-2dgs-1a2b", "object_2000-3dgs-1a", "indoor_3000-3dgs-1a"])
def test_test_scenes_are_frozen(name):
    assert is_frozen(f"runs/fit/{name}")
    with pytest.raises(InputError, match="nothing may be trained on"):
        refuse_frozen([f"runs/fit/{name}"], "trained on")


@pytest.mark.parametrize(
    "name", ["foxglove-3dgs-1a", "object_0-3dgs-1a", "object_1000-3dgs-1a", "banana-3dgs-1a", "mine"]
)
def test_others_are_not(name):
    assert not is_frozen(f"runs/fit/{name}")
    refuse_frozen([f"runs/fit/{name}"], "trained on")


def found(folder, name):
    """A run folder with held-out renders."""
    run = folder / name
    (run / "test/ours_10/renders").mkdir(parents=True)
    (run / "test/ours_10/gt").mkdir()
    return str(run)


@pytest.mark.parametrize(("train", "validation"), [("fox-3dgs-1", "plane"), ("plane", "object_2000-3dgs-1")])
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
