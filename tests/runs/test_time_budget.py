"""``enhance budget_ms=``: the choice, its limits, the machine's speed, what is refused."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaussian_enhancer.cli import enhance
from gaussian_enhancer.cli.options import check_options
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.presets import Preset, choose_preset, read_presets, write_presets
from gaussian_enhancer.runs import time_budget as budget
from support.job_config import job_config, run_job

FAST = Preset("lr_tiny/0 references", "lr_tiny", ("max_references=0",), 1000.0, 28.0, "a machine", "abc")
GOOD = Preset("lr_tiny/2 references", "lr_tiny", ("max_references=2",), 4000.0, 29.0, "a machine", "abc")
BEST = Preset("lr_tiny/3 references", "lr_tiny", (), 16000.0, 30.0, "a machine", "abc")
OFFERS = (FAST, GOOD, BEST)


@given(st.floats(0.1, 1e5), st.floats(0.01, 16.0), st.floats(0.01, 100.0))
def test_the_choice_keeps_within_the_budget_and_nothing_better_would(limit, megapixels, speed) -> None:
    fitting = [one for one in OFFERS if one.milliseconds <= limit / (megapixels * speed)]
    if not fitting:
        with pytest.raises(InputError, match="the fastest setting, lr_tiny/0 references"):
            choose_preset(OFFERS, limit, megapixels, speed)
        return
    chosen, told = choose_preset(OFFERS, limit, megapixels, speed)
    assert chosen is fitting[-1]
    assert chosen.name in told
    assert chosen.machine in told


def test_a_machine_half_as_fast_affords_half_as_much() -> None:
    assert choose_preset(OFFERS, 4000.0, 1.0, 1.0)[0] is GOOD
    assert choose_preset(OFFERS, 4000.0, 1.0, 2.0)[0] is FAST
    assert choose_preset(OFFERS, 4000.0, 0.25, 1.0)[0] is BEST


def test_offers_on_disk_come_back_fastest_first(tmp_path) -> None:
    write_presets(tmp_path / "s.json", (BEST, FAST, GOOD))
    assert read_presets(tmp_path / "s.json") == OFFERS


@pytest.mark.parametrize("text", ["", "[]", "{}", "[1]", '[{"name": "x"}]'])
def test_damaged_offers_are_refused(tmp_path, text) -> None:
    (tmp_path / "s.json").write_text(text)
    with pytest.raises(InputError, match="holds no settings"):
        read_presets(tmp_path / "s.json")


def test_offers_without_a_time_are_refused(tmp_path) -> None:
    write_presets(tmp_path / "s.json", (replace(FAST, milliseconds=0.0),))
    with pytest.raises(InputError, match="one without a time"):
        read_presets(tmp_path / "s.json")


@pytest.fixture
def offered(tmp_path, monkeypatch) -> Path:
    """Settings that every machine is fast enough for within an hour, and slow enough for a microsecond."""
    write_presets(tmp_path / "settings.json", OFFERS[:2])
    monkeypatch.setattr(budget, "PRESETS", tmp_path / "settings.json")
    return tmp_path


def enhanced(offered: Path, run: Path, *overrides: str):
    words = [f"run={run}", f"runs={offered / 'runs'}", "runtime.threads=1", "runtime.progress=false", *overrides]
    run_job(enhance.run, job_config("enhance", *words))
    return sorted((offered / "runs/enhance").glob("*/config.yaml"))


def test_the_job_enhance_does_what_was_chosen_and_says_so(offered, plane_run, capsys) -> None:
    (config,) = enhanced(offered, plane_run, "budget_ms=3600000")
    told = capsys.readouterr().err
    assert "lr_tiny/2 references (weights=lr_tiny max_references=2)" in told
    assert "max_references: 2" in config.read_text()
    assert "weights: lr_tiny" in config.read_text()
    assert "budget_ms" not in config.read_text()
    # The same run as that of a user who asks for the setting by name.
    assert enhanced(offered, plane_run, "weights=lr_tiny", "max_references=2") == [config]


def test_what_cannot_be_kept_is_refused_with_the_fastest(offered, plane_run) -> None:
    with pytest.raises(InputError, match=r"budget_ms: is 0.001, and the fastest setting, lr_tiny/0 references, takes"):
        enhanced(offered, plane_run, "budget_ms=0.001")


@pytest.mark.parametrize("given_", ["weights=sr_tiny", "max_references=1", "precision=float32", "tile=512"])
def test_what_the_budget_decides_cannot_be_given_beside_it(offered, plane_run, given_) -> None:
    with pytest.raises(InputError, match=f"{given_.split('=')[0]}: is .* together with budget_ms"):
        enhanced(offered, plane_run, "budget_ms=33", given_)


@pytest.mark.parametrize("odd", ["0", "-3", "soon", "true", ".inf"])
def test_a_budget_that_is_no_time_is_refused(odd) -> None:
    with pytest.raises(InputError, match=r"budget_ms: is .*; give a (finite )?number"):
        check_options("enhance", job_config("enhance", f"budget_ms={odd}"))


def test_without_settings_a_budget_says_how_to_measure_them(tmp_path, monkeypatch, plane_run) -> None:
    monkeypatch.setattr(budget, "PRESETS", tmp_path / "none.json")
    with pytest.raises(InputError, match="gaussian-enhancer tradeoff kind=quality settings="):
        enhanced(tmp_path, plane_run, "budget_ms=33")


def test_shipped_settings_if_there_are_any_name_shipped_weights() -> None:
    if budget.PRESETS.is_file():
        for one in read_presets(budget.PRESETS):
            assert (budget.PRESETS.parent / f"{one.weights}.safetensors").is_file()
            assert {option.partition("=")[0] for option in one.enhance} <= set(budget.BUDGET_KEYS)
