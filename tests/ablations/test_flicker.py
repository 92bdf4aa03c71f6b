import dataclasses
from functools import partial

import pytest
import torch

from ablations.report.video import flicker_table
from ablations.scripts.flicker import (
    compare_variants,
    exact_photos,
    path_cameras,
    reference_changes,
    rendered_sequence,
    sequence_records,
)
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import RowFile, line_of
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.scene.path import smooth_path
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from support.networks import small_sif
from support.synthetic_runs import plane_camera, plane_view


def same(value):
    return value


def plane_path(frames: int = 5) -> RenderedSet:
    """A textured plane along a path, with three other views of it as references."""
    coarse = torch.rand(1, 3, 12, 12, generator=torch.Generator().manual_seed(0))
    texture = torch.nn.functional.interpolate(coarse, size=(192, 192), mode="bicubic")[0].clamp(0, 1)

    def view(name, camera):
        photo, depth = plane_view(camera, texture)
        parts = [partial(same, part) for part in (photo, depth, torch.ones_like(depth), photo)]
        return RenderedView(name, parts[0], camera, *parts[1:])

    cameras = smooth_path([plane_camera(0, 32, 48), plane_camera(1, 32, 48)], frames)
    targets = tuple(view(f"path_{i:04d}.png", camera) for i, camera in enumerate(cameras))
    references = tuple(view(f"view_{i}.png", plane_camera(i, 32, 48)) for i in range(4))
    return RenderedSet("plane", targets, references)


def wavering_path() -> RenderedSet:
    """A camera that wavers between two photos of different exposure."""
    rendered = plane_path(2)
    middle = smooth_path([plane_camera(0, 32, 48), plane_camera(1, 32, 48)], 21)
    targets = [
        dataclasses.replace(rendered.targets[0], name=f"path_{i:04d}.png", camera=middle[8 if i % 2 else 12])
        for i in range(8)
    ]
    references = [
        dataclasses.replace(view, read_photo=partial(same, (view.read_photo() * share).clamp(0, 1)))
        for view, share in zip(rendered.references[:2], (0.5, 1.0), strict=True)
    ]
    return dataclasses.replace(rendered, targets=tuple(targets), references=tuple(references))


class Unsteady(Network):
    """Brightens every other frame."""

    def __init__(self, step: float) -> None:
        super().__init__()
        self.step, self.count = step, 0

    def stages(self, views):
        self.count += 1
        return (views.render + self.step * (self.count % 2),)


class Enlarging(Network):
    scale = 4

    def stages(self, views):
        return (torch.nn.functional.interpolate(views.render, scale_factor=4),)


def filmed(network):
    return rendered_sequence(plane_path(), SetEnhancer(network, ReferenceConfig(), precision="float32"))


def means(run, film):
    found = list(sequence_records(run, film, "none"))
    return {
        variant: [r.metrics["warped_error"] for r in found if r.variant == variant] for variant in film.images
    }, found


def named(plane_run, tmp_path):
    """The plane's run under a name as fits have it."""
    run = tmp_path / "plane-3dgs-00000000"
    run.symlink_to(plane_run)
    return run


def test_carrying_changes_over_calms_what_is_unsteady(plane_run, tmp_path):
    rendered = plane_path()
    photos = [view.read() + 0.05 for view in rendered.targets]
    enhancer = SetEnhancer(Unsteady(0.1), ReferenceConfig(), precision="float32")
    found, all_records = means(named(plane_run, tmp_path), rendered_sequence(rendered, enhancer, photos, [0.5]))
    assert sum(found["steady 0.5"]) < 0.6 * sum(found["enhanced"])
    rows = by_name(flicker_table(all_records))
    assert list(rows) == ["raw", "enhanced", "steady 0.5", "photo"]
    assert float(rows["steady 0.5"][1]) < 0.6 * float(rows["enhanced"][1])
    assert float(rows["enhanced"][4]) < float(rows["steady 0.5"][4])  # half-way of the two brightnesses is the photos
    for name, column in (("raw", 1), ("photo", 2)):
        assert float(rows[name][column]) == 1
    assert float(rows["steady 0.5"][1]) == pytest.approx(sum(found["steady 0.5"]) / sum(found["raw"]), abs=1e-3)
    assert float(rows["steady 0.5"][2]) == pytest.approx(sum(found["steady 0.5"]) / sum(found["photo"]), abs=1e-3)


def by_name(printed: str) -> dict[str, list[str]]:
    """Cells of a table's rows by their second one."""
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in printed.splitlines()[2:]]
    return {name: cells for _, name, *cells in rows}


class Tinting(Network):
    """Takes on the mean colour of its first reference."""

    def stages(self, views):
        return (views.render + 0.2 * (views.references[:, 0].mean((2, 3), keepdim=True) - 0.5),)


def test_references_that_are_kept_along_the_path_change_less_often(plane_run, tmp_path):
    rendered = wavering_path()
    enhancer = SetEnhancer(
        Tinting(), ReferenceConfig(references=1, candidates=1), precision="float32", colour_clamping=0
    )
    config = enhancer.reference_config
    film = rendered_sequence(rendered, enhancer, hysteresis=[0.5, 1.0])
    assert enhancer.reference_config is config
    run = named(plane_run, tmp_path)
    found, all_records = means(run, film)
    new = {name: sum(count for count, _ in reference_changes(names)) for name, names in film.references.items()}
    assert new["enhanced"] == new["path 1"] >= 5
    assert new["path 0.5"] == 0
    assert found["path 1"] == found["enhanced"]
    assert sum(found["path 0.5"]) < 0.8 * sum(found["enhanced"])
    rows = by_name(flicker_table(all_records))
    assert rows["path 0.5"][3] == "0 of 7"
    assert rows["enhanced"][3] == "7 of 7"
    assert rows["enhanced"][2] == rows["enhanced"][4] == ""  # no exact photos


def test_identity_flickers_as_its_input(plane_run, tmp_path):
    found, _ = means(named(plane_run, tmp_path), filmed(small_sif()))
    assert found["raw"] == found["enhanced"]
    assert max(found["change"]) < 0.003  # a constant image at half brightness, brought to 8 bits


def test_unsteady_network_is_found_out(plane_run, tmp_path):
    run = named(plane_run, tmp_path)
    found, lines = means(run, filmed(Unsteady(10 / 255)))
    for raw, enhanced, change in zip(found["raw"], found["enhanced"], found["change"], strict=True):
        assert enhanced > raw + 0.015
        assert change == pytest.approx(10 / 255, abs=0.004)
    file = RowFile(tmp_path / "flicker.jsonl", ("run", "view", "variant"))
    file.add_lines(list(map(line_of, lines)))
    table = row_table(compare_variants(file.read()), read_layout("flicker")).set_index("frames")
    assert list(table.index) == ["raw", "enhanced", "change"]
    assert table.loc["enhanced", ["run", "pairs"]].tolist() == [run.name, "4"]
    assert float(table.loc["enhanced", "error / raw"]) > 1.5
    new = table.loc["enhanced", "new references"].split(" of ")
    shown = "error - raw there" if new[0] == new[1] else "elsewhere"
    assert float(table.loc["enhanced", shown]) > 255 * 0.015
    sizes = [r.metrics["size"] for r in lines if r.variant == "change"]
    assert float(table.loc["change", "error / size of the change"]) == pytest.approx(
        sum(found["change"]) / sum(sizes), abs=0.01
    )


def test_changes_of_references_are_counted():
    names = [("a", "b", "c"), ("a", "b", "c"), ("b", "a", "c"), ("b", "d", "c"), ("x", "y", "c")]
    assert reference_changes(names) == [(0, False), (0, True), (1, False), (2, False)]


def test_path_passes_neighbouring_cameras_of_the_run(plane_run):
    path = path_cameras(plane_run, 3, 7)
    assert len(path) == 7
    assert {(camera.height, camera.width) for camera in path} == {(48, 64)}
    with pytest.raises(InputError, match="cameras: is 9"):
        path_cameras(plane_run, 9, 7)


def test_photos_of_a_capture_along_a_path_are_not_known(tmp_path):
    (tmp_path / "config.yaml").write_text("scene: {path: somewhere}\n")
    assert exact_photos(tmp_path, [plane_camera(0, 8, 8)]) == ()


def test_frames_without_depth_are_refused():
    path = plane_path(2)
    bare = dataclasses.replace(path, targets=tuple(dataclasses.replace(v, read_depth=None) for v in path.targets))
    with pytest.raises(InputError, match="lacks"):
        rendered_sequence(bare, SetEnhancer(small_sif(), ReferenceConfig(references=0)))


def test_networks_that_enlarge_are_refused():
    with pytest.raises(InputError, match="4 times"):
        filmed(Enlarging())
