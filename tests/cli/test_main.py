"""The command line: dispatch, Hydra's grammar, exit codes, completion, content-addressed runs."""

import importlib
import os
import signal
import subprocess
import sys
import types
from pathlib import Path
from typing import get_type_hints

import pytest
from hydra import compose
from omegaconf import OmegaConf

from ablations import options as ablation_options
from gaussian_enhancer.cli import main as cli
from gaussian_enhancer.cli import options
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import build, require
from gaussian_enhancer.runs.run import digest_of, open_run
from gaussian_enhancer.runs.runtime import choose_device
from support.failures import interrupt
from support.job_config import initialised, job_config
from support.paths import CONF

BASE = CONF / "base.yaml"


class Toy(options.Options):
    """Options of the job `toy`."""

    colour: options.Group
    size: int
    path: options.PathText | None
    extra: options.Group | None


@pytest.fixture
def toy_job(tmp_path, monkeypatch):
    """A job `toy` with one group, whose `run` records what it was given."""
    conf = tmp_path / "conf"
    (conf / "colour").mkdir(parents=True)
    (conf / "base.yaml").write_text(BASE.read_text())
    (conf / "colour" / "red.yaml").write_text("name: red\n")
    (conf / "colour" / "blue.yaml").write_text("name: blue\n")
    (conf / "toy.yaml").write_text("defaults: [base, {colour: red}, _self_]\nsize: 1\npath: null\n")
    configurations = []

    def run(cfg):
        configurations.append(OmegaConf.to_container(cfg, resolve=True))
        if cfg.size < 0:
            raise InputError("size", f"is {cfg.size}", "give a positive number")

    module = types.ModuleType("gaussian_enhancer.cli.toy")
    module.run = run
    monkeypatch.setitem(sys.modules, "gaussian_enhancer.cli.toy", module)
    monkeypatch.setitem(cli.JOBS, "toy", "a toy")
    monkeypatch.setitem(options.OPTIONS, "toy", Toy)
    monkeypatch.setattr(cli, "configurations", lambda: conf)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["gaussian-enhancer"])
    return configurations


def test_job_gets_overrides(toy_job):
    cli.main(["toy", "size=3", "colour=blue", "+extra.deep=[1,2]"])
    assert toy_job[0]["size"] == 3
    assert toy_job[0]["colour"] == {"name": "blue"}
    assert toy_job[0]["extra"] == {"deep": [1, 2]}


def test_single_run_leaves_no_folder_behind(toy_job, tmp_path):
    cli.main(["toy"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["conf"]


def test_multirun_sweeps(toy_job):
    cli.main(["toy", "-m", "colour=red,blue", "size=1,2"])
    assert [(c["colour"]["name"], c["size"]) for c in toy_job] == [
        ("red", 1),
        ("red", 2),
        ("blue", 1),
        ("blue", 2),
    ]


def test_cfg_job_prints_the_configuration(toy_job, capsys):
    cli.main(["toy", "--cfg", "job", "size=7"])
    assert OmegaConf.create(capsys.readouterr().out).size == 7
    assert not toy_job


def test_user_mistake_is_one_line_and_exit_code_2(toy_job, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["toy", "size=-1"])
    assert stop.value.code == 2
    assert capsys.readouterr().err == "gaussian-enhancer: size: is -1; give a positive number\n"


MISTAKES = {
    "size=-1": "size: is -1; give a positive number",
    "nothing=3": "nothing: is no option of toy; see gaussian-enhancer toy --help",
    "colour=green": "colour: has no choice 'green'; choose blue, red",
    "path=a=b": """override path=a=b: cannot be parsed (mismatched input '=' expecting <EOF>); """
    """quote the value twice: path='"a=b"'""",
    "path=Tom's": """override path=Tom's: cannot be parsed (LexerNoViableAltException: path=Tom's); """
    """quote the value twice: path='"Tom'"'"'s"'""",
    "--photos": "argument --photos: is unknown; options are key=value: gaussian-enhancer toy --help",
    "runtime.threads=abc": "runtime.threads: is 'abc'; give a whole number",
    "runtime=null": "runtime: is None; give names and values",
    "output=[1]": "output: is [1]; give text or null",
    f"output={'a' * 300}": f"output: is '{'a' * 37}...{'a' * 38}'; "
    "give a path of at most 4095 bytes, with names of at most 255 or null",
    "path=${nowhere}": "path: cannot be resolved: Interpolation key 'nowhere' not found; set what it refers to",
    "colour=null": "command line of toy: is refused (Config group override must be a string or a list. Got NoneType); "
    "see gaussian-enhancer toy --help",
}


@pytest.mark.parametrize("sweep", [(), ("-m",)], ids=["run", "multirun"])
@pytest.mark.parametrize("word", MISTAKES)
def test_a_mistake_is_one_line_in_a_run_and_in_a_sweep(toy_job, capsys, word, sweep):
    with pytest.raises(SystemExit) as stop:
        cli.main(["toy", *sweep, word])
    assert capsys.readouterr().err == f"gaussian-enhancer: {MISTAKES[word]}\n"
    assert stop.value.code == 2


def test_the_home_folder_is_found_in_overrides(toy_job, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    cli.main(["toy", "path=~/photos"])
    assert toy_job[0]["path"] == f"{tmp_path}/photos"
    cli.main(["toy", "-m", "path=~/a,~/b"])
    assert [cfg["path"] for cfg in toy_job[1:]] == [f"{tmp_path}/a", f"{tmp_path}/b"]
    assert cli.expand_home("paths=[~/a,b~/c]") == f"paths=[{tmp_path}/a,b~/c]"
    assert cli.expand_home("~path") == "~path"


def test_the_other_runs_of_a_sweep_are_made_where_one_is_refused(toy_job, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["toy", "-m", "size=-1,2"])
    assert stop.value.code == 2
    assert [cfg["size"] for cfg in toy_job] == [-1, 2]


@pytest.mark.parametrize("sweep", [(), ("-m",)], ids=["run", "multirun"])
def test_ctrl_c_is_one_line_and_exit_code_130(toy_job, capsys, monkeypatch, sweep):
    monkeypatch.setattr(sys.modules["gaussian_enhancer.cli.toy"], "run", interrupt)
    with pytest.raises(SystemExit) as stop:
        cli.main(["toy", *sweep])
    assert stop.value.code == 130
    assert capsys.readouterr().err == (
        "gaussian-enhancer: stopped by Ctrl-C; the same command goes on where it stopped\n"
    )


def test_a_measurement_that_is_stopped_begins_anew(toy_job, capsys, monkeypatch):
    monkeypatch.setitem(cli.BENCHMARKS, "toy", "a toy")
    monkeypatch.setattr(cli, "RESTARTED", {"toy"})
    module = types.ModuleType("ablations.benchmarks.toy")
    module.run = interrupt
    monkeypatch.setitem(sys.modules, "ablations.benchmarks.toy", module)
    with pytest.raises(SystemExit) as stop:
        cli.main(["toy"])
    assert stop.value.code == 130
    assert capsys.readouterr().err == "gaussian-enhancer: stopped by Ctrl-C; the same command begins anew\n"


def test_trainings_with_checkpoints_do_not_begin_anew():
    assert {"fit", "train", "train_generator", "distil", "ibgs"}.isdisjoint(cli.RESTARTED)


def test_a_killed_process_of_a_sweep_is_one_line(toy_job, capsys, monkeypatch):
    def run(cfg):
        os.kill(os.getpid(), signal.SIGKILL)

    # The tests check shapes in every function, and a checked function cannot be sent to another process.
    monkeypatch.setattr(cli, "job_function", lambda job: run)
    with pytest.raises(SystemExit) as stop:
        cli.main(["toy", "-m", "size=1,2", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"])
    assert stop.value.code == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "gaussian-enhancer: a process of the sweep was killed, for want of memory perhaps; "
        "the same command goes on where it stopped"
    )


def test_an_internal_error_keeps_its_traceback(toy_job, capsys, monkeypatch):
    def run(cfg):
        raise ValueError("ours")

    monkeypatch.setattr(sys.modules["gaussian_enhancer.cli.toy"], "run", run)
    with pytest.raises(ValueError, match="ours"):
        cli.main(["toy"])


def test_every_job_has_options_that_its_own_configuration_meets():
    with initialised():
        for job in cli.JOBS:
            cfg = compose(job, ["dataset=mip_nerf_360"] if job == "download" else [])
            for name, variable in (("folder", "GAUSSIAN_ENHANCER_DATASETS"), ("backbones", "GAUSSIAN_ENHANCER_DATA")):
                if name in cfg and not OmegaConf.is_missing(cfg, name) and variable in str(cfg._get_node(name)):
                    cfg[name] = "folder"
            options.check_options(job, cfg)
            assert job in options.OPTIONS or job in ablation_options.OPTIONS
            assert set(OmegaConf.load(CONF / f"{job}.yaml")) <= known(job)


def test_quality_has_the_options_of_each_of_its_files():
    for name in sorted(path.stem for path in (CONF / "heldout").glob("*.yaml")):
        options.check_options("quality", job_config("quality", f"heldout={name}", "backbones=null"))


def test_trainings_accept_keys_that_recipes_add():
    options.check_options("train", job_config("train", "data.train=[]", "data.validation=[]", "+faithful=true"))


def test_groups_may_be_added_to_jobs_that_refuse_unknown_options():
    groups = ["+sweep=two_jobs", "scene=indoor", "+scene/imperfections=phone", "+scene.background=[0,0,0]"]
    options.check_options("enhance", job_config("enhance", *groups))


def test_every_job_has_a_module_that_runs_it():
    for job in cli.JOBS:
        assert callable(importlib.import_module(f"{cli.package_of(job)}.{job}").run)


def test_a_job_locks_what_its_module_says_or_its_records(tmp_path):
    module = types.ModuleType("toy")
    assert cli.output_path_of(module, OmegaConf.create({"records": "found.jsonl"})) == Path("found.jsonl")
    assert cli.output_path_of(module, OmegaConf.create({"records": None})) is None
    assert cli.output_path_of(module, OmegaConf.create({"records": "???"})) is None
    module.output_path = lambda cfg: tmp_path
    assert cli.output_path_of(module, OmegaConf.create({"records": "found.jsonl"})) == tmp_path


def test_the_list_of_jobs_names_each_once(capsys):
    cli.main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    assert sorted(line.split()[0] for line in lines if line.startswith("  ")) == sorted([*cli.JOBS, "completion"])
    assert lines.index("single measurements:") > lines.index(next(line for line in lines if "  dashboard " in line))


def known(job):
    """Names of a job's options, and those that are checked elsewhere."""
    other_keys = {
        "defaults",
        "this_run",
        "hydra",
        "title",
        "about",
        "scenes",
        "images",
        "training",
        "tradeoff",
        "numerics",
    }
    return other_keys | {"order"} | set(get_type_hints(options.options_of(job)))


def test_unknown_job_is_refused(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["paint"])
    assert stop.value.code == 2
    assert "demo, fit" in capsys.readouterr().err


def test_completion_offers_jobs_keys_and_group_options(toy_job):
    assert "toy" in cli.complete("gaussian-enhancer t")
    assert "colour=" in cli.complete("gaussian-enhancer toy col")
    assert cli.complete("gaussian-enhancer toy colour=") == ["colour=blue", "colour=red"]
    assert cli.complete("gaussian-enhancer nothing col") == []


def test_completion_script_is_valid_bash():
    subprocess.run(["bash", "-n"], input=cli.COMPLETION, text=True, check=True)


def test_run_folder_depends_on_content_only(tmp_path):
    cfg = OmegaConf.create({"runs": str(tmp_path), "output": None, "runtime": {"threads": 1}, "size": 1})
    first = open_run(cfg, "toy", "a")
    assert open_run(OmegaConf.merge(cfg, {"runtime": {"threads": 2}}), "toy", "a") == first
    assert open_run(OmegaConf.merge(cfg, {"size": 2}), "toy", "a") != first
    assert not first.done
    first.finish()
    assert open_run(cfg, "toy", "a").done


def test_a_folder_of_another_finished_run_is_refused(tmp_path):
    cfg = OmegaConf.create({"runs": "", "output": str(tmp_path / "mine"), "runtime": {}, "size": 1})
    first = open_run(cfg, "toy", "a")
    changed_cfg = OmegaConf.merge(cfg, {"size": 2})
    assert open_run(changed_cfg, "toy", "a").folder == first.folder  # no result yet: nothing is lost
    open_run(cfg, "toy", "a").finish()
    with pytest.raises(InputError, match="another finished run"):
        open_run(changed_cfg, "toy", "a")


def test_a_folder_with_results_of_another_unfinished_run_is_refused(tmp_path):
    cfg = OmegaConf.create({"runs": "", "output": str(tmp_path / "mine"), "runtime": {}, "size": 1, "rate": 1e-5})
    first = open_run(cfg, "toy", "a")
    (first.folder / "checkpoint.pt").write_bytes(b"half of it")
    with pytest.raises(InputError, match="holds an unfinished run of another configuration"):
        open_run(OmegaConf.merge(cfg, {"size": 2}), "toy", "a")
    assert OmegaConf.load(first.folder / "config.yaml").size == 1
    assert open_run(cfg, "toy", "a") == first  # the same one goes on


def test_digest_ignores_key_order():
    assert digest_of({"a": 1, "b": [1.5, None]}) == digest_of({"b": [1.5, None], "a": 1})


def test_missing_value_names_its_override():
    with pytest.raises(InputError, match=r"scene\.path.*add scene\.path=\.\.\."):
        require(OmegaConf.create({"scene": {"path": "???"}}))


def test_missing_value_below_a_node_names_its_full_key():
    cfg = OmegaConf.create({"scene": {"_target_": "builtins.dict", "path": "???"}})
    with pytest.raises(InputError, match=r"add scene\.path=\.\.\."):
        build(cfg.scene)


def test_device_names():
    assert choose_device("cpu").type == "cpu"
    with pytest.raises(InputError, match="auto, cpu or cuda"):
        choose_device("tpu")


def test_unset_environment_variable_is_named(monkeypatch):
    monkeypatch.delenv("NOT_SET_HERE", raising=False)
    cfg = OmegaConf.create({"scene": {"path": "${oc.env:NOT_SET_HERE}/fox"}})
    with pytest.raises(InputError, match=r"scene\.path.*NOT_SET_HERE"):
        require(cfg)


def test_no_group_takes_the_name_of_a_jobs_own_key() -> None:
    """Hydra would read ``variant=x`` as a choice of the group ``variant``, and refuse it."""
    groups = {folder.name for folder in CONF.iterdir() if folder.is_dir()}
    for job in CONF.glob("*.yaml"):
        values = OmegaConf.load(job)
        chosen = str(values.get("defaults", ""))  # a group that the job chooses from may be added to below
        assert not [key for key in groups & set(values) if f"'{key}'" not in chosen], job.name
