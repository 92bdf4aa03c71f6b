"""Validation error over time and samples from what trainings logged."""

import json
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from ablations.report import tradeoff_training
from ablations.report.tradeoff_training import training_parts
from ablations.tradeoff.trainings import training_records
from gaussian_enhancer.errors import InputError

HEAD = "epoch,gain/psnr,gain/ssim,step,time/seconds,train/total\n"


def training(runs: Path, label: str, seed: int, log: str | None, minutes: float | None = 2.0, **own) -> None:
    folder = runs / "train" / f"{label}-{seed}{own.get('size', '')}"
    (folder / "log").mkdir(parents=True)
    data = {"loading": {"batch_size": 4, "seed": seed}}
    OmegaConf.save(
        {"label": label, "seed": seed, "data": data, "trainer": {"max_steps": 200}, **own}, folder / "config.yaml"
    )
    if log is not None:
        (folder / "log" / "metrics.csv").write_text(log)
    if minutes is not None:
        (folder / "card.json").write_text(json.dumps({"minutes": minutes}))


def found(runs: Path):
    return list(training_records(runs, "*", 100))


def test_validations_stand_over_the_seconds_and_samples_before_them(tmp_path) -> None:
    log = f"{HEAD}0,,,49,10.0,1\n0,,,99,20.0,1\n0,0.1,0.01,99,,\n1,,,199,40.0,1\n1,0.3,0.02,199,,\n1,0.4,0.03,200,,\n"
    training(tmp_path, "ge", 0, log)
    first, last = found(tmp_path)
    assert (first.view, first.variant, first.seed) == ("100", "ge", 0)
    assert first.metrics == {"gain_psnr": 0.1, "samples": 400.0, "seconds": 20.0, "gain_ssim": 0.01}
    assert last.metrics == {"gain_psnr": 0.4, "samples": 800.0, "seconds": 40.0, "gain_ssim": 0.03}
    assert last.view == "200"
    assert "as logged" in last.protocol


def test_without_logged_seconds_the_cards_minutes_are_spread_and_said_to_be(tmp_path) -> None:
    training(tmp_path, "ge", 0, "epoch,gain/psnr,step,train/total\n0,0.1,99,\n1,0.4,200,\n", minutes=2.0)
    first, last = found(tmp_path)
    assert (first.metrics["seconds"], last.metrics["seconds"]) == (60.0, 120.0)
    assert "spread evenly" in first.protocol


def test_unfinished_and_unvalidated_trainings_say_so_and_trial_runs_are_no_part(tmp_path) -> None:
    training(tmp_path, "killed", 0, HEAD, minutes=None)
    training(tmp_path, "silent", 0, f"{HEAD}0,,,199,40.0,1\n")
    training(tmp_path, "unlogged", 0, None)
    training(tmp_path, "trial", 0, HEAD, trainer={"max_steps": 20})
    reasons = {record.variant: record.reasons["row"] for record in found(tmp_path)}
    validated = "logged no validation"
    assert reasons == {"killed": "is not finished", "silent": validated, "unlogged": validated}


def test_seeds_are_one_variant_and_equal_labels_of_other_settings_are_two(tmp_path) -> None:
    log = f"{HEAD}1,0.4,0.03,200,,\n"
    training(tmp_path, "ge", 0, log)
    training(tmp_path, "ge", 1, log.replace("0.4", "0.2"))
    assert {record.variant for record in found(tmp_path)} == {"ge"}
    text = "\n".join(part for part, _, _ in training_parts(found(tmp_path)))
    assert "| ge | 2 | 200 | 800 | 120 | +0.300 ± 0.141 | 1 |" in text
    training(tmp_path, "ge", 0, log, size="base")
    variants = {record.variant for record in found(tmp_path)}
    assert len(variants) == 2
    assert all(variant.startswith("ge, ") for variant in variants)


def test_the_diagrams_error_is_the_ratio_of_mean_squared_errors(tmp_path, monkeypatch) -> None:
    training(tmp_path, "ge", 0, f"{HEAD}1,10.0,0.03,200,,\n")
    drawn = []
    monkeypatch.setattr(tradeoff_training, "work_precision", lambda title, panels, columns: drawn.extend(panels) or "")
    list(training_parts(found(tmp_path)))
    marks = [(mark.label, mark.x, mark.y) for panel in drawn for mark in panel.curves["ge"]]
    assert marks == [("200 steps", 120, pytest.approx(0.1)), ("200 steps", 800, pytest.approx(0.1))]


def test_a_damaged_card_is_refused_by_name(tmp_path) -> None:
    training(tmp_path, "ge", 0, f"{HEAD}1,10.0,0.03,200,,\n")
    (card,) = tmp_path.glob("train/*/card.json")
    card.write_text("{}")
    with pytest.raises(InputError, match=r"card\.json: is no card"):
        found(tmp_path)
