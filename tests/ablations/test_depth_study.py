import dataclasses

import pytest
import torch

from ablations.scripts import depth as depth_study
from ablations.scripts.depth import (
    FAR,
    SEARCHED,
    ReplacedDepthWarp,
    exact_depths,
    gains_over_raw,
    measure_run,
    propagate_residual,
    reference_configs,
    reference_quality,
    with_sky,
    world_of,
)
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import frame_of
from gaussian_enhancer.align.alignment import AlignedReferences, Unwarped
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.types import identity_camera
from support.networks import small_sif


def wrong_by(factor: float, view: RenderedView) -> RenderedView:
    return dataclasses.replace(view, read_depth=lambda: factor * view.read_depth())


ROWS = [name for name, *_ in SEARCHED]


@pytest.fixture
def misplaced(plane_run) -> tuple[RenderedSet, dict[str, dict[str, torch.Tensor]]]:
    """A run whose stored depth is 30% too large, and depth of each kind: 10% too large, 1% too large, right."""
    rendered = read_run(plane_run)
    exact = {view.name: view.read_depth() for view in (*rendered.targets, *rendered.references)}
    targets = tuple(wrong_by(1.3, view) for view in rendered.targets)
    references = tuple(wrong_by(1.3, view) for view in rendered.references)
    wrong = {"expected": 1.1, "surface": 1.01, "exact": 1.0}
    depths = {kind: {name: factor * z for name, z in exact.items()} for kind, factor in wrong.items()}
    return dataclasses.replace(rendered, targets=targets, references=references), depths


def test_the_better_the_depth_the_better_the_references(misplaced):
    rendered, depths = misplaced
    found = list(measure_run(rendered, SetEnhancer(small_sif(), ReferenceConfig(), precision="float32"), depths))
    assert [variant for _, variant, _, _ in found] == ["raw", *ROWS] * len(rendered.targets)
    by = {kind: [m for _, variant, m, _ in found if variant == kind] for kind in ("raw", *ROWS)}
    for raw, expected, searched, _, _, surface, *_, exact in zip(*by.values(), strict=True):
        assert {m["psnr"] for m in (expected, searched, surface, exact)} == {raw["psnr"]}  # the network is untrained
        assert exact["reference_psnr"] > expected["reference_psnr"] + 1
        assert searched["reference_psnr"] > expected["reference_psnr"]
        assert surface["reference_psnr"] > expected["reference_psnr"]
        assert exact["propagated_psnr"] > max(expected["propagated_psnr"], raw["psnr"])


def test_stored_depth_given_again_changes_nothing(plane_run):
    rendered = read_run(plane_run)
    stored = {view.name: view.read_depth() for view in (*rendered.targets, *rendered.references)}
    kinds = reference_configs(ReferenceConfig(), {"surface": stored})
    default = "surface, smoothed, searched by photos too"
    assert kinds.keys() == {"surface", "surface, searched", "surface, smoothed, searched", default}
    assert isinstance(kinds["surface"].warp, ReplacedDepthWarp)
    view, pool = rendered.targets[0], ReferencePool(rendered.references)
    given, usual = (p.align(read_target(view), view, pool) for p in (kinds[default], ReferenceConfig()))
    assert given.names == usual.names
    assert torch.equal(given.references, usual.references)


def test_residuals_are_handed_on_as_stated():
    render = torch.full((3, 16, 16), 0.5)
    seen = torch.ones(2, 1, 16, 16)
    renders = render.expand(2, 3, 16, 16).clone()
    aligned = AlignedReferences(renders + torch.tensor([0.1, 0.2])[:, None, None, None], seen, ("a", "b"), renders)
    torch.testing.assert_close(propagate_residual(render, aligned), render + 0.3 / 2.5)
    off = dataclasses.replace(aligned, renders=renders + 0.02, references=aligned.references + 0.02)
    weight = torch.exp(torch.tensor(-1.0))
    torch.testing.assert_close(propagate_residual(render, off), render + 0.3 * weight / (2 * weight + 0.5))
    hidden = dataclasses.replace(aligned, visibility=torch.zeros_like(seen))
    assert torch.equal(propagate_residual(render, hidden), render)
    with pytest.raises(InputError, match="splat's renders"):
        propagate_residual(render, dataclasses.replace(aligned, renders=None))


def test_reference_is_judged_where_it_is_visible():
    photo = torch.full((3, 8, 8), 0.5)
    seen = torch.zeros(1, 1, 8, 8)
    seen[..., :4] = 1
    shown = torch.where(seen[0] > 0, photo + 0.1, torch.zeros(()))[None]
    found = reference_quality(AlignedReferences(shown, seen, ("a",)), photo + 0.01, photo)
    assert found["reference_psnr"] == pytest.approx(20, abs=1e-4)
    assert found["render_psnr_there"] == pytest.approx(40, abs=1e-3)
    assert found["reference_visible"] == 0.5
    nothing = reference_quality(AlignedReferences(shown, torch.zeros_like(seen), ("a",)), photo, photo)
    assert nothing == {"reference_psnr": None, "render_psnr_there": None, "reference_visible": 0.0}


def test_sky_lies_behind_all_else():
    depth = torch.tensor([[[0.0, 2.0], [5.0, 0.0]]])
    assert torch.equal(with_sky(depth), torch.tensor([[[5 * FAR, 2.0], [5.0, 5 * FAR]]]))


class PlaneWorld:
    """Stands in for a world that takes a minute to make: z is the seed, on the left half, in the camera's size."""

    def __init__(self, family, seed, camera, device):
        assert (family, device) == ("object", "cpu")
        self.seed, self.camera = seed, camera

    def depth(self):
        z = torch.full((1, self.camera.height, self.camera.width), float(self.seed))
        z[..., self.camera.width // 2 :] = 0
        return z


def test_depth_of_a_world_is_its_own(monkeypatch):
    monkeypatch.setattr(depth_study, "ProceduralView", PlaneWorld)
    views = tuple(RenderedView(f"{i}.png", None, identity_camera(4 + i, 6, 6.0)) for i in range(3))
    depths = exact_depths(("object", 3), views)
    for i, view in enumerate(views):
        assert depths[view.name].shape == (1, 4 + i, 6)
        assert depths[view.name][0, 0].tolist() == [3.0] * 3 + [3 * FAR] * 3
    with pytest.raises(InputError, match="no camera"):
        exact_depths(("object", 3), [RenderedView("bare.png", None)])


def test_only_procedural_runs_have_a_world(tmp_path):
    (tmp_path / "config.yaml").write_text("scene: {family: object, seed: 3}\n")
    assert world_of(tmp_path) == ("object", 3)
    (tmp_path / "config.yaml").write_text("scene: {path: somewhere}\n")
    assert world_of(tmp_path) is None


def test_weights_that_do_not_reproject_are_refused():
    with pytest.raises(InputError, match="reproject"):
        reference_configs(ReferenceConfig(warp=Unwarped()), {})


def test_table_states_gains_over_the_raw_render(misplaced):
    rendered, depths = misplaced
    records = [
        Record("depth", "plane", "plane", "ours_100", view.name, variant, metrics, reasons)
        for view, variant, metrics, reasons in measure_run(
            rendered, SetEnhancer(small_sif(), ReferenceConfig()), depths
        )
    ]
    gains = gains_over_raw(frame_of(records))
    assert gains.loc[gains["variant"] == "exact", "gain psnr"].abs().max() < 5e-5
    table = row_table(gains, read_layout("depth"))
    assert table.iloc[:, :3].to_numpy().tolist() == [[scene, d, "2"] for scene in ("plane", "all") for d in ROWS]
    by_depth = table[table["scene"] == "plane"].set_index("depth")
    assert by_depth.loc["exact", "gain in psnr"] == "+0.00"
    handed = by_depth["gain of residuals handed on"].astype(float)
    assert handed["exact"] > handed["expected"]
