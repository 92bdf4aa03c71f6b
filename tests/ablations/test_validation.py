"""The scripts that choose by validation runs: weights, their strength, how far references may differ."""

import json
import sys

import agreement
import candidates
import pytest
import renders
import strength
import torch
from test_sif import small

from gaussian_enhancer.enhance.enhancer import Enhancer
from gaussian_enhancer.enhance.prepare import Preparation
from gaussian_enhancer.enhance.weights import Pretrained, save_weights
from gaussian_enhancer.errors import InputError


@pytest.fixture
def weights(tmp_path):
    """Weights of a network that is untrained, and of one that brightens every render by about 0.1."""
    files = []
    for label, shift in (("same", 0.0), ("brighter", 0.2)):
        network = small()
        with torch.no_grad():
            network.decode.head.bias[:12] = shift
        files.append(tmp_path / f"{label}-0123abcd" / "weights.safetensors")
        files[-1].parent.mkdir()
        save_weights(files[-1], network, Preparation(), {})
    return [str(file) for file in files]


def test_rows_are_named_by_what_was_trained_and_not_twice(weights):
    assert list(candidates.enhancers(weights)) == ["same", "brighter"]
    assert candidates.name_of("lr_tiny") == "lr_tiny"
    assert candidates.name_of("own.safetensors") == "own"
    with pytest.raises(InputError, match="second row same"):
        candidates.enhancers([weights[0], weights[0]])
    with pytest.raises(InputError, match="enlarges 4 times"):
        candidates.enhancers(["sr_tiny"])


def test_candidates_are_compared_on_the_same_views(weights, plane_run, tmp_path, monkeypatch, capsys):
    run, found = tmp_path / "plane-3dgs-0123abcd", tmp_path / "rows.jsonl"
    run.symlink_to(plane_run)
    monkeypatch.setattr(sys, "argv", ["x", *weights, "--runs", str(run), "--every", "2", "--json", str(found)])
    candidates.main()
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
    rows = [{"row": "a", "scene": "s", "psnr": g, "psnr_aligned": g} for g in (1.0, 0.5, -0.25)]
    line = renders.table(rows).splitlines()[-1]
    assert "| -0.250 | 1 of 3 |" in line


def test_half_the_strength_is_half_the_change(weights, plane_run):
    network = candidates.enhancers([weights[1]])["brighter"].network
    rows = strength.gains(Pretrained(network, Preparation(), {}), plane_run, [])
    assert {row["strength"] for row in rows} == set(strength.STRENGTHS)
    view = rows[0]["view"]
    mine = [row["psnr"] for row in rows if row["view"] == view]
    assert mine == sorted(mine, reverse=True)  # the more of a wrong change, the worse
    table = strength.table(rows).splitlines()
    assert len(table) == 2 + len(strength.STRENGTHS)
    assert strength.is_worse({"psnr_aligned": -0.06, "ssim": 0.0})
    assert strength.is_worse({"psnr_aligned": 0.0, "ssim": 0.0, "lpips_alex": 0.006})
    assert not strength.is_worse({"psnr_aligned": -0.04, "ssim": -0.001, "lpips_alex": 0.004})


def test_the_limit_of_agreement_is_all_that_differs():
    made = agreement.enhancers(Pretrained(small(), Preparation(), {}))
    assert [one.preparation.warp.agreement for one in made.values()] == list(agreement.LIMITS)
    assert all(isinstance(one, Enhancer) for one in made.values())
