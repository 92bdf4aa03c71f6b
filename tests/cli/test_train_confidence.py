"""The job train_confidence."""

import json

import pytest
from omegaconf import DictConfig

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.checkpoint import checkpoint_digest
from gaussian_enhancer.cli.train_confidence import run
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import load_weights, reference_config_of, save_weights
from support.job_config import job_config
from support.networks import trained


def job(fits, weights, tmp_path, *words: str) -> DictConfig:
    quiet = ("runtime.progress=false", "runtime.threads=1", "steps=20", "hidden=8")
    places = (f"fits=[{fits}]", f"weights={weights}", f"output={tmp_path / 'out'}")
    return job_config("train_confidence", *places, *quiet, *words)


def test_weights_get_a_confidence_and_stay_the_same_otherwise(plane_run, tmp_path, capsys):
    network = trained()
    save_weights(tmp_path / "a.safetensors", network, ReferenceConfig(), {"name": "a", "strength": 0.5})
    cfg = job(plane_run, tmp_path / "a.safetensors", tmp_path)
    run(cfg)
    before, after = load_weights(tmp_path / "a.safetensors"), load_weights(tmp_path / "out/weights.safetensors")
    assert after.confidence is not None
    assert after.confidence.hidden == 8
    for name, value in before.network.state_dict().items():
        assert value.equal(after.network.state_dict()[name]), name
    card = json.loads((tmp_path / "out/card.json").read_text())
    assert card == after.card
    assert card["confidence"]["fits"] == [plane_run.name]
    assert card["confidence"]["weights"] == checkpoint_digest(tmp_path / "a.safetensors")
    assert checkpoint_digest(tmp_path / "out/weights.safetensors") != checkpoint_digest(tmp_path / "a.safetensors")
    run(cfg)
    assert "trained already" in capsys.readouterr().err


def test_other_weights_in_the_same_file_are_another_run(plane_run, tmp_path):
    for strength in (0.5, 0.25):
        save_weights(tmp_path / "a.safetensors", trained(), ReferenceConfig(), {"strength": strength})
        run(job(plane_run, tmp_path / "a.safetensors", tmp_path, "output=null", f"runs={tmp_path / 'runs'}"))
    assert len(list((tmp_path / "runs/train_confidence").iterdir())) == 2


def test_the_warp_of_what_is_written_and_judged_may_be_another(plane_run, tmp_path):
    save_weights(tmp_path / "a.safetensors", trained(), ReferenceConfig(), {"name": "a"})
    run(job(plane_run, tmp_path / "a.safetensors", tmp_path, "+warp.tolerance=0.3", "+warp.photo_consistency=0.01"))
    pretrained = load_weights(tmp_path / "out/weights.safetensors")
    assert pretrained.reference_config == ReferenceConfig(Reprojected(tolerance=0.3, photo_consistency=0.01))
    assert pretrained.card["reference_config"] == reference_config_of(pretrained.reference_config)
    assert pretrained.card["confidence"]["warp"] == {"tolerance": 0.3, "photo_consistency": 0.01}
    default_folder = tmp_path / "default_folder"
    run(job(plane_run, tmp_path / "a.safetensors", default_folder))
    default_confidence = load_weights(default_folder / "out/weights.safetensors").confidence
    assert not default_confidence.centre.equal(pretrained.confidence.centre)  # other references are judged


@pytest.mark.parametrize("warp", ["distance=1", "tolerance=-0.1", "photo_consistency=-0.1", "softness=0.0"])
def test_a_warp_that_does_not_exist_is_refused(plane_run, tmp_path, warp):
    with pytest.raises(InputError, match="warp"):
        run(job(plane_run, "lr_tiny", tmp_path, f"+warp.{warp}"))


def test_weights_that_enlarge_are_refused(plane_run, tmp_path):
    with pytest.raises(InputError, match="not for enhancement by references"):
        run(job(plane_run, "sr_tiny", tmp_path))
    assert not (tmp_path / "out/weights.safetensors").exists()


def test_folds_judge_each_fit_by_weights_that_did_not_learn_from_it(plane_run, tmp_path):
    for name, network in (("a", trained()), ("b", trained())):
        save_weights(tmp_path / f"{name}.safetensors", network, ReferenceConfig(), {"name": name})
    fold = f"folds=[{{weights: {tmp_path / 'b.safetensors'}, fits: [{plane_run}]}}]"
    run(job(plane_run, tmp_path / "a.safetensors", tmp_path, "fits=[]", fold))
    card = json.loads((tmp_path / "out/card.json").read_text())["confidence"]
    assert card["fits"] == [plane_run.name]
    assert card["folds"] == [checkpoint_digest(tmp_path / "b.safetensors")]


@pytest.mark.parametrize("name", ["fox-3dgs-1a2b3c4d", "object_2000-3dgs-1a2b3c4d"])
def test_scenes_that_nothing_is_trained_on_are_refused_in_fits_and_in_folds(tmp_path, name):
    fold = f"folds=[{{weights: lr_tiny, fits: [{tmp_path / name}]}}]"
    for cfg in (job(tmp_path / name, "lr_tiny", tmp_path), job("", "lr_tiny", tmp_path, "fits=[]", fold)):
        with pytest.raises(InputError, match=r"trained on|used for training"):
            run(cfg)
    assert not (tmp_path / "out").exists()


def test_a_fold_of_another_design_is_refused(plane_run, tmp_path):
    save_weights(tmp_path / "a.safetensors", trained(), ReferenceConfig(), {"name": "a"})
    with pytest.raises(InputError, match="of another design"):
        run(job(plane_run, tmp_path / "a.safetensors", tmp_path, f"folds=[{{weights: lr_tiny, fits: [{plane_run}]}}]"))


def test_no_fit_at_all_is_refused(plane_run, tmp_path):
    with pytest.raises(InputError, match="hold no held-out views"):
        run(job(plane_run, "lr_tiny", tmp_path, "fits=[]"))
