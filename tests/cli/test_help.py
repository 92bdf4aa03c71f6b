"""The help of a job shows each option with its comment and default."""

import sys

import pytest
from omegaconf import OmegaConf

from gaussian_enhancer.cli import main as cli
from gaussian_enhancer.cli.help import help_text
from support.paths import CONF


@pytest.mark.parametrize("job", cli.JOBS)
def test_every_option_is_shown_with_its_default_and_comment(job):
    shown = help_text(job, [], CONF).splitlines()
    job_options = options(CONF / f"{job}.yaml")
    again = {
        name for name in job_options if name != "runtime"
    }  # a job's own default and comment take the place of the base's
    base = {name: line for name, line in options(CONF / "base.yaml").items() if name not in again}
    assert job_options
    for line in (*job_options.values(), *base.values()):
        assert f"  {line}" in shown
    assert [line for line in shown if line.startswith("  runs:")] == [f"  {(base | job_options)['runs']}"]


def options(file):
    """Every line with an option, by the option's name."""
    lines = [line for line in file.read_text().splitlines() if ":" in line and line[0].isalpha()]
    named = {line.partition(":")[0]: line for line in lines}
    return {name: line for name, line in named.items() if name not in ("defaults", "this_run", "hydra")}


def test_groups_are_shown_with_their_choices_and_the_options_of_the_one_that_is_taken():
    shown = help_text("fit", ["scene=transforms", "settings.steps=2"], CONF)
    assert "splat=3dgs\n      of 2dgs, 3dgs, mip_splatting" in shown
    assert "options of scene=transforms:" in shown
    assert "plan=auto  # auto: leave out what the scene does not need; full: leave nothing out" in help_text(
        "enhance", [], CONF
    )
    assert "a folder of your own choice" in shown
    assert "_target_" not in shown


@pytest.mark.parametrize("word", ["--help", "-h"])
def test_the_command_line_prints_it(word, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["gaussian-enhancer"])
    cli.main(["enhance", word])
    assert "strength: null  # share of the network's change" in capsys.readouterr().out


def test_every_job_explains_its_options():
    """Names that speak for themselves, and parts whose options are explained within, need no comment."""
    plain = {"title", "about", "markdown", "records", "lpips", "kind", "groups", "tables"}
    for job in cli.JOBS:
        values = OmegaConf.load(CONF / f"{job}.yaml")
        for line in (CONF / f"{job}.yaml").read_text().splitlines():
            name = line.partition(":")[0]
            if line[:1].isalpha() and name in values and name not in {*plain, "defaults", "this_run"}:
                assert "#" in line or OmegaConf.is_config(values._get_node(name)), f"{job}: {name}"
