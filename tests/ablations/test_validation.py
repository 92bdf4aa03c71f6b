"""The jobs that choose by validation runs: weights, and the limits that they are held to."""

import json
import shutil

import pytest
import torch

from ablations.scripts import candidates, guards
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import frame_of
from gaussian_enhancer.align.alignment import Reprojected, Unwarped
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import Pretrained, save_weights
from gaussian_enhancer.metrics.records import Record, write_records
from support.networks import small_sif


@pytest.fixture
def weights(tmp_path):
    """Weights of a network that is untrained, and of one that brightens every render by about 0.1."""
    files = []
    for label, shift in (("same", 0.0), ("brighter", 0.2)):
        network = small_sif()
        with torch.no_grad():
            network.decode.head.bias[:12] = shift
        files.append(tmp_path / f"{label}-0123abcd" / "weights.safetensors")
        files[-1].parent.mkdir()
        save_weights(files[-1], network, ReferenceConfig(), {})
    return [str(file) for file in files]


def test_rows_are_named_by_what_was_trained_and_not_twice(weights):
    assert list(candidates.load_enhancers(weights)) == ["same", "brighter"]
    with pytest.raises(InputError, match="second row same"):
        candidates.load_enhancers([weights[0], weights[0]])
    with pytest.raises(InputError, match="enlarges 4 times"):
        candidates.load_enhancers(["sr_tiny"])


def test_candidates_are_compared_on_the_same_views(weights, plane_run, tmp_path, job, capsys):
    run, found = tmp_path / "plane-3dgs-0123abcd", tmp_path / "rows.jsonl"
    run.symlink_to(plane_run)
    job("candidates", f"weights=[{','.join(weights)}]", f"runs=[{run}]", "every=2", f"records={found}")
    rows = [json.loads(line) for line in found.read_text().splitlines()]
    by = {name: [row for row in rows if row["row"] == name] for name in ("same", "brighter")}
    assert [row["view"] for row in by["same"]] == [row["view"] for row in by["brighter"]]
    assert {row["psnr"] for row in by["same"]} == {0.0}
    assert max(row["psnr"] for row in by["brighter"]) < -0.1
    head, _, same, brighter = capsys.readouterr().out.splitlines()
    assert head.startswith("| weights | psnr |")
    assert "| worst view | views worse |" in head
    assert same.startswith("| same | +0.0000 |")
    assert brighter.startswith("| brighter | -")


def test_the_worst_view_is_shown():
    gains = {"v0": 1.0, "v1": 0.5, "v2": -0.25}
    where = {"row": "a", "scene": "s", "run": "s-3dgs"}
    rows = [{**where, "view": view, "psnr": g, "psnr_aligned": g} for view, g in gains.items()]
    line = row_table(frame_of(rows), read_layout("gains")).iloc[0]
    assert (line["worst view"], line["views worse"]) == ("-0.250", "1 of 3")


@pytest.mark.parametrize("name", ["candidates", "guards"])
def test_a_fit_by_another_name_is_named_by_its_records_and_one_without_is_refused(
    name, weights, plane_run, tmp_path, job, capsys
):
    words = [name, f"weights=[{weights[0]}]", f"runs=[{tmp_path}/mine]"]
    words += ["guard=strength"] if name == "guards" else []
    shutil.copytree(plane_run, tmp_path / "mine")
    with pytest.raises(SystemExit) as stop:
        job(*words)
    assert stop.value.code == 2
    assert capsys.readouterr().err == (
        f"gaussian-enhancer: {tmp_path}/mine: is not named SCENE-METHOD-DIGEST; name runs of `gaussian-enhancer fit`\n"
    )
    write_records(tmp_path / "mine" / "records.jsonl", [Record("cost", "mine", "plane", "3dgs", "", "raw", {})])
    job(*words)
    assert "| plane |" in capsys.readouterr().out


def test_the_more_of_a_wrong_change_the_worse(weights, plane_run, tmp_path, job, capsys):
    run, found = tmp_path / "plane-3dgs-0123abcd", tmp_path / "rows.jsonl"
    run.symlink_to(plane_run)
    job("guards", "guard=strength", f"weights=[{weights[1]}]", f"runs=[{run}]", f"records={found}")
    lines = capsys.readouterr().out.splitlines()[2:]
    assert [line.split("|")[1].strip() for line in lines] == [f"brighter, strength {s}" for s in (0.5, 0.8, 1.0)]
    rows = [json.loads(line) for line in found.read_text().splitlines()]
    losses = [row["psnr"] for row in rows if row["view"] == rows[0]["view"]]
    assert losses == sorted(losses, reverse=True)
    assert len(set(losses)) == 3
    assert all(row["commit"] and row["machine"] and row["time"] for row in rows)


def test_evidence_keeps_an_invention_small(weights, plane_run, tmp_path, job, capsys):
    run, found = tmp_path / "plane-3dgs-0123abcd", tmp_path / "rows.jsonl"
    run.symlink_to(plane_run)
    job("guards", "guard=colour_clamping", f"weights=[{weights[1]}]", f"runs=[{run}]", f"records={found}")
    lines = capsys.readouterr().out.splitlines()[2:]
    assert len(lines) == len(guards.LIMITS["colour_clamping"])
    rows = [json.loads(line) for line in found.read_text().splitlines()]
    losses = {row["row"]: row["psnr"] for row in rows if row["view"] == rows[0]["view"]}
    free, point, *_, wide = losses.values()
    assert free < wide < point


def test_the_limit_is_all_that_differs():
    pretrained = Pretrained(small_sif(), ReferenceConfig(), {})
    for guard, limits in guards.LIMITS.items():
        made = [guards.guarded_enhancer(pretrained, guard, limit) for limit in limits]
        agreements = [one.reference_config.warp.photo_consistency for one in made]  # type: ignore[union-attr]
        assert agreements == (
            list(limits) if guard == "photo_consistency" else [Reprojected().photo_consistency] * len(made)
        )
        assert [one.colour_clamping for one in made] == (
            list(limits) if guard == "colour_clamping" else [3] * len(made)
        )
        assert [one.strength for one in made] == (list(limits) if guard == "strength" else [1.0] * len(made))
    with pytest.raises(InputError, match="do not warp"):
        guards.guarded_enhancer(Pretrained(small_sif(), ReferenceConfig(Unwarped()), {}), "photo_consistency", 0.2)
