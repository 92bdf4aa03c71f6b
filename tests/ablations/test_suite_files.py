"""The files of the suite: every study composes, names what exists, and carries the paper's numbers exactly."""

import hashlib
import json
from pathlib import Path

import pytest
from hydra import compose
from omegaconf import OmegaConf

from ablations.study.description import read_description
from ablations.suite.descriptions import known_names, method_rows, read_experiment, requested_names
from ablations.suite.evaluation import compose_checked
from ablations.suite.method_runs import Runs
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import build
from support.job_config import initialised, job_config
from support.paths import ROOT

NAMES = [name for group in known_names().values() for name in group]


def loaded(path: Path):
    return OmegaConf.to_container(OmegaConf.load(path))


PAPER = loaded(ROOT / "ablations/paper.yaml")


def configured(scale: str):
    return job_config("tables", "table=all", f"scale={scale}")


@pytest.fixture(scope="module", params=["smoke", "desk", "paper"])
def scale(request):
    return configured(request.param).scale


def numbers(values: object) -> list[float]:
    """All numbers below a node, in order."""
    if isinstance(values, dict):
        return [number for key, below in values.items() if key != "columns" for number in numbers(below)]
    if isinstance(values, list | tuple):
        return [number for below in values for number in numbers(below)]
    return [] if values is None else [float(values)]  # type: ignore[arg-type]


def test_the_copy_of_the_papers_numbers_is_as_it_was_transcribed() -> None:
    canonical = json.dumps(PAPER, sort_keys=True).encode()
    assert hashlib.sha256(canonical).hexdigest()[:16] == "441883bea3f0ccf5"
    assert PAPER["table_2"]["3dgs"]["gepp"] == [28.96, 0.871, 0.186]
    assert PAPER["table_9"]["tanks_temples"]["std"] == [0.05, 0.0001, 0.0001]


def test_there_are_ten_tables_three_figures_and_our_own_studies() -> None:
    tables = [f"table_{number}" for number in range(1, 11)]
    assert requested_names("all") == (*tables, "figure_5", "figure_6", "figure_7")
    assert {"gates", "generator", "alignment", "depth", "references", "losses", "sizes", "mode"} <= set(
        requested_names("studies")
    )
    assert requested_names(["2", 2, "table_2"]) == ("table_2",)


@pytest.mark.parametrize("name", NAMES)
def test_every_study_is_a_table_at_every_scale(name, scale) -> None:
    one = read_experiment(name, scale)
    learning = [method for method, values in one.table.methods.items() if values.train]
    assert set(learning) <= set(one.table.methods)
    assert all(method.about for method in one.table.methods.values())
    assert one.table.about
    assert one.table.methods[one.table.baseline].role == "" or one.table.kind == "cost"
    for dataset in one.table.datasets.values():
        assert dataset.scenes
        assert dataset.stand_in or scale.name == "paper"
    scenes = [scene for dataset in one.table.datasets.values() for scene in dataset.scenes]
    assert len(scenes) == len(set(scenes))  # records of a table name the scene, not the dataset
    if one.table.kind == "repeats":
        assert len(one.table.seeds) >= (2 if scale.name == "smoke" else 3)


def test_stand_ins_are_labelled_in_distribution_where_and_only_where_they_are_procedural(scale) -> None:
    for dataset in scale.datasets.values():
        families = {scene[0].removeprefix("scene=") for scene in dataset.scenes.values()}
        procedural = families <= {"unbounded", "outdoor", "indoor", "object"}
        label = "in-distribution (same generator, assets and light as training)"
        assert (label in dataset.get("stand_in", "")) == procedural


def test_committed_tables_call_their_stand_ins_as_the_scale_does() -> None:
    datasets = configured("desk").scale.datasets
    for path in (ROOT / "docs/results/tables/desk").glob("*.json"):
        page = path.with_suffix(".md").read_text(encoding="utf-8")
        for key, dataset in read_description(path).datasets.items():
            if key in datasets:
                assert dataset.stand_in == datasets[key].stand_in
                assert dataset.stand_in in page


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("table_")])
def test_the_papers_values_are_carried_over_exactly(name) -> None:
    table = read_experiment(name, configured("smoke").scale).table
    found, printed = numbers(dict(table.paper)), numbers(PAPER[name])
    if name == "table_3":
        assert table.paper["2k"] == {
            "paper_ge": (1105.0, 19300.0),
            "paper_gepp_lr": (1339.0, 19500.0),
            "paper_gepp_sr": None,
        }
        assert table.paper["4k"] == {
            "paper_ge": None,
            "paper_gepp_lr": None,
            "paper_gepp_sr": (412.0, 16100.0),
        }
        return
    assert found == printed
    blocks = {"repeats": set(table.datasets) - {"captures"}, "quality": set(table.splats)}[table.kind]
    assert set(table.paper) == blocks
    if table.kind == "quality":
        assert all(set(methods) <= set(table.methods) for methods in table.paper.values())


def test_all_scenes_of_the_paper_are_in_its_scale() -> None:
    own = ("captures", "fine_captures", "validation")  # none of the paper's
    datasets = {key: value for key, value in configured("paper").scale.datasets.items() if key not in own}
    counts = {key: len(dataset.scenes) for key, dataset in datasets.items()}
    assert counts == {"mip_nerf_360": 9, "tanks_temples": 2, "deep_blending": 2, "nerf_synthetic": 8}
    for dataset in datasets.values():
        for (choice,) in dataset.scenes.values():
            assert (ROOT / "conf" / f"{choice.replace('=', '/')}.yaml").is_file()


def test_desk_measures_as_the_quality_table_does_on_three_worlds_a_dataset_and_on_captures() -> None:
    """Sparse fits by the same settings, of worlds that no training learns from, and captures kept for validation."""
    with initialised():
        quality, desk = compose("quality", ["backbones=null"]), configured_inside("desk")
        group = quality.groups.procedural
        worlds = [(scene[0], f"scene.seed={seed}") for scene in group.scenes.values() for seed in (3000, 3001, 3002)]
        worlds += [(f"scene=captures/{name}",) for name in ("plush", "banana", "copr")]
        known = {
            frozenset((*world, f"splat={splat}", *quality.fit, *group.densities.sparse.fit))
            for world in worlds
            for splat in quality.splat_choices
        }
    cells = {
        frozenset(cell.fit) for number in (7, 8, 9) for cell in read_experiment(f"table_{number}", desk.scale).cells
    }
    assert cells == known
    pairs = Runs(desk).pairs("usual")
    assert len(pairs["train"]) == 12
    assert all("captures" not in word for side in pairs.values() for one in side for word in one)


def test_budgets_are_chosen_on_worlds_that_no_table_reports() -> None:
    desk = configured("desk").scale
    chosen = {frozenset(cell.fit) for cell in read_experiment("budget", desk).cells}
    reported = {frozenset(cell.fit) for name in known_names()["all"] for cell in read_experiment(name, desk).cells}
    assert chosen
    assert not chosen & reported
    steps = {row.train[-1] for row in read_experiment("budget", desk).table.methods.values() if row.mode == "paper"}
    assert len(steps) == 4


def configured_inside(scale: str):
    return compose("tables", ["table=all", f"scale={scale}"])


def methods() -> list[tuple[str, str]]:
    """A study and a method for every choice of overrides of the job train, once."""
    found: dict[tuple[str, ...], tuple[str, str]] = {}
    for path in sorted((ROOT / "ablations").glob("*/*.yaml")):
        study = loaded(path)
        for method, values in method_rows(study).items() if "methods" in study else ():
            if values.get("train"):
                found[(*study.get("train", ()), *values["train"])] = (path.stem, method)
    return sorted(found.values())


def test_rows_that_are_listed_are_the_shared_ones() -> None:
    shared = loaded(ROOT / "ablations/methods.yaml")
    assert method_rows({"methods": ["gepp", "raw"]}) == {"gepp": shared["gepp"], "raw": shared["raw"]}
    assert list(method_rows({"methods": ["gepp", "raw"]})) == ["gepp", "raw"]
    with pytest.raises(InputError, match="methods: names 'ours'; choose from raw"):
        method_rows({"methods": ["raw", "ours"]})
    files = [path for folder in ("tables", "studies") for path in (ROOT / "ablations" / folder).glob("*.yaml")]
    assert shared.keys() <= {name for path in files for name in loaded(path)["methods"]}


@pytest.mark.parametrize(("name", "method"), methods())
def test_every_row_composes_and_builds_what_it_names(name, method) -> None:
    scale = configured("smoke").scale
    overrides = read_experiment(name, scale).table.methods[method].train
    with initialised():
        parent = compose("tables", ["table=all", "scale=smoke"])
        job = compose_checked("train", parent, [*overrides, "data.train=[a]", "data.validation=[b]"])
    build(job.fusion)
    build(job.loss)
    reference_config = build(job.reference_config)
    assert reference_config.fine == method.endswith("gepp_sr")
    mode = read_experiment(name, scale).table.methods[method].mode
    faithful = type(build(job.fusion)).__module__.startswith("gaussian_enhancer.network.paper.")
    assert faithful == (mode == "paper")


@pytest.mark.parametrize("name", known_names()["all"])
def test_every_row_of_the_paper_is_there_twice_and_named(name) -> None:
    methods = read_experiment(name, configured("smoke").scale).table.methods
    modes = {mode: [key for key, row in methods.items() if row.mode == mode] for mode in ("paper", "ours")}
    assert modes["ours"]
    assert modes["paper"] == [f"paper_{key}" for key in modes["ours"]]
    for mode, keys in modes.items():
        assert all(methods[key].title.endswith(f", {mode}") for key in keys)
    assert all(row.mode or not row.train for row in methods.values())


def test_files_behind_rows_are_used_and_say_why_they_are_fair() -> None:
    words = " ".join(path.read_text(encoding="utf-8") for path in (ROOT / "ablations").rglob("*.yaml"))
    for group in ("gates", "generator", "alignment", "depth", "references", "mode", "variant"):
        for path in (ROOT / "conf/ablation" / group).glob("*.yaml"):
            assert f"+ablation/{group}={path.stem}]" in words or f"+ablation/{group}={path.stem}," in words, path.name
            lines = path.read_text(encoding="utf-8").splitlines()
            assert lines[0] == "# @package _global_"
            assert lines[1].startswith("# ")
            assert len(lines) <= 15
