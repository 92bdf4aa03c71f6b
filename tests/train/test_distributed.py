"""Two processes joined by gloo do what one does: crops, light, gradients, validation, prediction."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError, LostProcessError
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.crops import BalancedDraw, Collate, Crops, SharedCollate
from gaussian_enhancer.train.processes import launch
from gaussian_enhancer.train.samples import prepare_samples
from gaussian_enhancer.train.share import SharedBatches, SharedCrops
from support.command import run_command
from support.job_config import job_config
from support.process_work import dies, notes_its_end, refuses
from support.synthetic_runs import write_plane_run

FAST = ("lr_scheduler.lr_lambda.warmup=1", "callbacks.ema.multi_avg_fn.decay=0.5")


def configured(job: str, *overrides: str):
    return job_config(job, *overrides, "runtime.progress=false", "runtime.threads=1")


def options(train: Path, validation: Path, runs: Path) -> list[str]:
    places = [f"data.train=[{train}]", f"data.validation=[{validation}]", f"runs={runs}", "logger=csv"]
    small = ["size=tiny", "fusion.widths=[8,8,8]", "data.augmentation.crop=32", "data.loading.batch_size=4"]
    quick = ["optimizer.lr=0.01", *FAST, "data.steps_per_epoch=2"]
    return [*places, *small, *quick, "trainer=smoke", "trainer.max_steps=4", "save_every=3"]


@pytest.fixture(scope="module")
def three_views(tmp_path_factory) -> Path:
    """A run with an odd number of views to judge, so that two processes cannot have as many each."""
    return write_plane_run(tmp_path_factory.mktemp("runs") / "plane-3", seed=3, views=9)


@pytest.mark.parametrize("renders_known", [True, False])
def test_shares_make_the_whole_batch(renders_known, plane_run, tmp_path):
    samples = prepare_samples(read_run(plane_run), ReferenceConfig(), tmp_path, "a")
    if not renders_known:  # of one sample: then the whole batch goes without
        samples[0] = type(samples[0])(**{**vars(samples[0]), "has_reference_renders": False})
    augmentation = Augmentation(crop=32, drop_renders=0.5)
    crops, collate = Crops(samples, augmentation), Collate(3, augmentation)
    wholes = [list(BalancedDraw([len(samples)], 12, seed=0))[at : at + 4] for at in (0, 4, 8)]
    parts = []
    for rank in range(2):
        shared = SharedBatches(BalancedDraw([len(samples)], 12, seed=0), 4, rank, 2)
        assert len(shared) == 3
        handed = SharedCrops(crops)
        parts.append([SharedCollate(collate, samples)([handed[one] for one in batch]) for batch in shared])
    for whole, first, second in zip(wholes, *parts, strict=True):
        expected = collate([crops[one] for one in whole])
        assert expected.names == first.names + second.names
        pairs = [(expected.photo, first.photo, second.photo)]
        pairs += [
            (getattr(expected.views, name), getattr(first.views, name), getattr(second.views, name))
            for name in ("render", "references", "visibility", "depth", "reference_renders")
        ]
        for all_, one, other in pairs:
            assert (all_ is None) == (one is None) == (other is None)
            if all_ is not None:
                assert torch.equal(all_, torch.cat([one, other]))


def test_a_batch_that_cannot_be_split_evenly_is_refused():
    with pytest.raises(InputError, match="multiple"):
        SharedBatches(BalancedDraw([3], 12, seed=0), 3, 0, 2)


@pytest.mark.slow
def test_two_processes_train_as_one_does(plane_run, three_views, tmp_path):
    from gaussian_enhancer.cli.train import run

    gains, folders = [], []
    for name, more in (("one", []), ("two", ["trainer.devices=2", "trainer.strategy=ddp"])):
        gains.append(run(configured("train", *options(plane_run, three_views, tmp_path / name), *more)))
        folders += (tmp_path / name).glob("train/*")
    one, two = folders
    assert one.name == two.name
    cards = [json.loads((folder / "card.json").read_text()) for folder in folders]
    assert gains[0] != 0
    assert gains[1] == pytest.approx(gains[0], rel=1e-3)
    for metric, value in cards[0]["validation"].items():
        assert cards[1]["validation"][metric] == pytest.approx(value, rel=1e-3), metric
    weights = [load_file(folder / "weights.safetensors") for folder in folders]
    fresh = sum(float((value - weights[1][name]).abs().max() > 1e-4) for name, value in weights[0].items())
    assert fresh == 0
    assert cards[1]["steps"] == 4
    rows = [(folder / "log/metrics.csv").read_text().splitlines() for folder in folders]
    assert len(rows[0]) == len(rows[1])


def test_two_processes_enhance_as_one_does(three_views, tmp_path):
    from gaussian_enhancer.cli.enhance import run

    torch.manual_seed(0)
    network = SIF((8, 8, 8), (1, 1, 1))
    torch.nn.init.normal_(network.decode.head.weight, std=0.1)
    save_weights(tmp_path / "a.safetensors", network, ReferenceConfig(), {})
    folders = []
    for name, more in (("one", []), ("two", ["runtime.processes=2"])):
        given = [f"run={three_views}", f"weights={tmp_path / 'a.safetensors'}", f"runs={tmp_path / name}"]
        assert run(configured("enhance", *given, *more)) is not None
        folders += (tmp_path / name).glob("enhance/*")
    one, two = folders
    assert one.name == two.name
    images = sorted(path.name for path in (one / "test/ours_100/enhanced").iterdir())
    assert images == ["view_000.png", "view_004.png", "view_008.png"]
    for name in images:
        image = (one / "test/ours_100/enhanced" / name).read_bytes()
        assert image == (two / "test/ours_100/enhanced" / name).read_bytes()
        assert image != (one / "test/ours_100/renders" / name).read_bytes()
    assert [record.view for record in read_records(two / "records.jsonl")] == images
    assert (one / "plan.json").read_bytes() == (two / "plan.json").read_bytes()
    assert (two / "done").is_file()


def test_two_processes_use_an_earlier_step_as_one_does(tmp_path):
    from gaussian_enhancer.cli.enhance import run

    fit = write_plane_run(tmp_path / "plane", steps=(4000, 16000))
    for name, count in (("one", 1), ("two", 2)):
        assert run(configured("enhance", f"run={fit}", f"runtime.processes={count}", f"output={tmp_path / name}")) > 0
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    assert len(list((tmp_path / "two").iterdir())) == 2


def test_a_process_that_fails_ends_the_others():
    cfg = configured("enhance")
    with pytest.raises(InputError, match="a: is bad; mend it"):
        launch(refuses, cfg, "cpu", 2)
    with pytest.raises(LostProcessError, match="one of 2 processes was killed"):
        launch(dies, cfg, "cpu", 2)


def test_processes_leave_their_group_before_they_end(tmp_path):
    launch(notes_its_end, configured("enhance"), "cpu", 2, tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"0": "False", "1": "False"}


@pytest.mark.slow
def test_a_shared_training_that_was_killed_goes_on_alone(plane_run, three_views, tmp_path):
    from gaussian_enhancer.cli.train import run

    words = [*options(plane_run, three_views, tmp_path), "trainer.max_steps=8", "save_every=3"]
    quiet = ("runtime.progress=false", "runtime.threads=1")
    killed = run_command("train", *words, *quiet, "trainer.devices=2", dies_at_step=5)
    assert killed.returncode != 0
    assert killed.stderr.splitlines()[-1].startswith("gaussian-enhancer: one of 2 processes was killed")
    (checkpoint,) = tmp_path.glob("train/*/last.ckpt")
    assert torch.load(checkpoint, weights_only=True)["global_step"] == 3
    run(configured("train", *words))
    (card,) = tmp_path.glob("train/*/card.json")
    assert json.loads(card.read_text())["steps"] == 8
