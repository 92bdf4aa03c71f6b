"""A short training under each logger: what it kept, and that a training that goes on is the same run."""

import json
import math
from pathlib import Path

import pytest
from lightning.pytorch.loggers import CSVLogger
from PIL import Image

from gaussian_enhancer.cli.train import naming_configuration, run
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.run import result_values, run_digest
from gaussian_enhancer.train.loggers import ResumableCSVLogger, make_loggers
from gaussian_enhancer.train.trainer import device_count, spawn_count
from support.csv_log import logged_rows
from support.failures import fill_disk
from support.job_config import job_config
from support.wandb_log import history, records

SMALL = (
    "fusion=sif",
    "fusion.widths=[8,8,8]",
    "data.augmentation.crop=32",
    "data.loading.batch_size=2",
    "data.steps_per_epoch=2",
)
QUICK = ("optimizer.lr=0.01", "lr_scheduler.lr_lambda.warmup=1", "callbacks.ema.multi_avg_fn.decay=0.5")
SHORT = ("trainer=smoke", "trainer.max_steps=4", "save_every=3", "runtime.progress=false", "runtime.threads=1")


def configured(*overrides: str):
    return job_config("train", *SMALL, *QUICK, *SHORT, *overrides)


def trained(logger: str, train: Path, validation: Path, runs: Path, *others: str) -> Path:
    places = [f"data.train=[{train}]", f"data.validation=[{validation}]", f"runs={runs}"]
    assert run(configured(*places, f"logger={logger}", *others)) is not None
    (folder,) = runs.glob("train/*")
    return folder


def scalars(folder: Path) -> dict[tuple[str, int], float]:
    """The last value of each scalar at each step."""
    return {
        (name, int(row["step"])): float(value)
        for row in logged_rows(folder)
        for name, value in row.items()
        if value and name != "step" and not name.startswith("time/")
    }


@pytest.fixture(scope="module")
def by_wandb(plane_run, other_plane_run, tmp_path_factory) -> Path:
    return trained("wandb", plane_run, other_plane_run, tmp_path_factory.mktemp("wandb"), "study=gates")


def logs(folder: Path) -> list[Path]:
    return sorted(folder.glob("wandb/offline-run-*"))


def test_wandb_keeps_the_run_with_its_content_and_group(by_wandb):
    (log,) = logs(by_wandb)
    found = list(records(next(log.glob("*.wandb"))))
    (told,) = [record.run for record in found if record.WhichOneof("record_type") == "run"]
    digest = by_wandb.name.rpartition("-")[2]
    assert (told.run_id, told.run_group, told.job_type) == (digest, "gates", "train")
    assert told.display_name == by_wandb.name
    updates = [one.config.update for one in found if one.WhichOneof("record_type") == "config"]
    config = {item.key: json.loads(item.value_json) for items in updates for item in items}
    assert config["seed"] == 0
    assert config["data"]["loading"]["batch_size"] == 2
    assert "study" not in config


def test_wandb_keeps_the_scalars_that_the_rows_have(by_wandb):
    (log,) = logs(by_wandb)
    kept = {}
    for row in history(list(records(next(log.glob("*.wandb"))))):
        for name, value in row.items():
            if isinstance(value, float | int) and "trainer/global_step" in row:
                kept[name, row["trainer/global_step"]] = value
    expected = scalars(by_wandb)
    assert {name for name, _ in expected} >= {"train/total", "gain/psnr", "gain/ssim"}
    assert {step for name, step in expected if name == "train/total"} == {0, 1, 2, 3}
    for key, value in expected.items():
        assert kept[key] == pytest.approx(value, rel=1e-5), key


def test_wandb_keeps_a_table_of_every_view_and_images(by_wandb):
    (log,) = logs(by_wandb)
    found = history(list(records(next(log.glob("*.wandb")))))
    tables = [row for row in found if "validation/views" in row]
    shown = [row["validation/images"] for row in found if "validation/images" in row]
    assert len(tables) == len(shown) == 3  # after each of two epochs, and at the end
    table = json.loads((log / "files" / tables[-1]["validation/views"]["path"]).read_text())
    assert table["columns"] == ["view", "gain/psnr", "gain/ssim"]
    names = [row[0] for row in table["data"]]
    assert len(names) == len(set(names)) >= 2
    mean = math.fsum(row[1] for row in table["data"]) / len(names)
    assert mean != 0
    assert mean == pytest.approx(json.loads((by_wandb / "card.json").read_text())["validation"]["gain/psnr"], rel=1e-5)
    files = shown[-1]["filenames"]
    assert shown[-1]["captions"] == names[:: max(1, len(names) // 4)][:4]
    for name in files:
        with Image.open(log / "files" / name) as image:
            assert image.size == (3 * 64, 48)  # render, enhanced, photo


@pytest.mark.slow
def test_a_training_that_goes_on_is_the_same_run(by_wandb, plane_run, other_plane_run):
    before = scalars(by_wandb)
    for name in ("done", "card.json", "weights.safetensors"):
        (by_wandb / name).unlink()
    trained("wandb", plane_run, other_plane_run, by_wandb.parents[1], "study=gates")
    steps = [int(row["step"]) for row in logged_rows(by_wandb) if row["train/total"]]
    assert steps == [0, 1, 2, 3]  # the checkpoint was at step 3: nothing is lost, nothing there twice
    after = scalars(by_wandb)
    assert after.keys() == before.keys()
    assert {key: after[key] for key in before if key[1] < 3} == {key: before[key] for key in before if key[1] < 3}
    parts = [list(records(next(log.glob("*.wandb")))) for log in logs(by_wandb)]
    ids = {record.run.run_id for found in parts for record in found if record.WhichOneof("record_type") == "run"}
    assert (len(parts), len(ids)) == (2, 1)


def test_tensorboard_keeps_the_same_scalars_and_images(plane_run, other_plane_run, tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    folder = trained("tensorboard", plane_run, other_plane_run, tmp_path)
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    kept = {(tag, event.step): event.value for tag in events.Tags()["scalars"] for event in events.Scalars(tag)}
    expected = scalars(folder)
    assert any(name == "gain/psnr" for name, _ in expected)
    for key, value in expected.items():
        assert kept[key] == pytest.approx(value, rel=1e-5), key
    images = [tag for tag in events.Tags()["images"] if tag.startswith("validation/")]
    assert images
    assert all(event.width == 3 * 64 for tag in images for event in events.Images(tag))


def test_rows_from_the_first_step_that_is_logged_again_are_dropped(tmp_path):
    first = ResumableCSVLogger(tmp_path, name=None, version="log")
    for step in range(4):
        first.log_metrics({"a": float(step)}, step)
    first.save()
    second = ResumableCSVLogger(tmp_path, name=None, version="log")
    second.log_metrics({"a": 20.0, "b": 1.0}, 2)
    second.save()
    assert [(row["step"], row["a"], row["b"]) for row in logged_rows(tmp_path)] == [
        ("0", "0.0", ""),
        ("1", "1.0", ""),
        ("2", "20.0", "1.0"),
    ]


@pytest.mark.parametrize("kept", [0.3, 0.6, 0.97])
def test_a_file_that_was_cut_loses_the_row_that_was_being_written(kept, tmp_path):
    whole = tmp_path / "whole"
    for folder in (whole, tmp_path):
        first = ResumableCSVLogger(folder, name=None, version="log")
        for step in range(4):
            first.log_metrics({"a": 1000.0 + step}, step)
            first.save()
    path = tmp_path / "log/metrics.csv"
    path.write_bytes(path.read_bytes()[: int(kept * path.stat().st_size)])
    known = path.read_text().count("\n") - 1
    second = ResumableCSVLogger(tmp_path, name=None, version="log")
    for step in range(known, 4):
        second.log_metrics({"a": 1000.0 + step}, step)
        second.save()
    assert logged_rows(tmp_path) == logged_rows(whole)


def test_no_file_is_cut_when_the_disk_is_full_at_new_columns(tmp_path, monkeypatch):
    logger = ResumableCSVLogger(tmp_path, name=None, version="log")
    logger.log_metrics({"a": 1.0}, 0)
    logger.save()
    before = (tmp_path / "log/metrics.csv").read_bytes()
    logger.log_metrics({"a": 2.0, "b": 1.0}, 1)
    monkeypatch.setattr("csv.DictWriter.writerows", fill_disk)
    with pytest.raises(InputError, match="No space left"):
        logger.save()
    assert (tmp_path / "log/metrics.csv").read_bytes() == before


def test_neither_logger_nor_study_nor_processes_make_another_run():
    places = ("data.train=[]", "data.validation=[]")
    plain = naming_configuration(configured(*places))
    watched = ("logger=wandb", "logger=tensorboard", "study=gates", "profiler=simple")
    for other in (*watched, "trainer.devices=2", "trainer.devices=1", "trainer.strategy=ddp"):
        same = naming_configuration(configured(*places, other))
        assert run_digest(same, "train") == run_digest(plain, "train"), other
    assert "logger" not in result_values(plain)
    assert run_digest(naming_configuration(configured(*places, "seed=1")), "train") != run_digest(plain, "train")


def test_any_lightning_logger_is_taken_by_its_target(tmp_path):
    cfg = configured("data.train=[]", "data.validation=[]", "logger=csv")
    cfg.logger = {"_target_": "lightning.pytorch.loggers.CSVLogger", "save_dir": str(tmp_path), "name": "mine"}
    (logger,) = make_loggers(cfg.logger)
    assert type(logger) is CSVLogger
    assert logger.root_dir == str(tmp_path / "mine")


def test_numbers_of_devices_are_lightnings(tmp_path):
    places = ("data.train=[]", "data.validation=[]", f"runs={tmp_path}")
    for words, count in (("1", 1), ("auto", 1), ("3", 3), ("[0,1]", 2), ("-1", 1)):
        assert device_count(configured(*places, f"trainer.devices={words}")) == count
    assert spawn_count(configured(*places, "trainer.devices=2", "trainer.strategy=ddp")) == 2
    assert spawn_count(configured(*places, "trainer.devices=2", "trainer.strategy=fsdp")) == 1  # Lightning's own affair
    with pytest.raises(InputError, match="1 or more"):
        run(configured(*places, "trainer.devices=0"))
