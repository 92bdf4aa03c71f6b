"""Every snippet of docs/python.md runs, in the page's order, on a small synthetic scene."""

import json
import re
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer import Camera, render
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.splat.io.ply import write_ply
from gaussian_enhancer.types import Gaussians
from support.paths import DOCS
from support.synthetic_runs import coloured_slab

PAGE = DOCS / "python.md"
FOLDERS = ("enhanced", "enhanced_run", "enhanced_views", "best_views")
GL = torch.diag(torch.tensor([1.0, -1, -1, 1]))
CAMERA = {"fl_x": 64, "fl_y": 64, "cx": 32, "cy": 24, "w": 64, "h": 48}


def camera_to_world(camera: Camera) -> torch.Tensor:
    """In OpenGL's axes."""
    return torch.linalg.inv(camera.world_to_camera) @ GL


def write_capture(folder: Path, run: Path) -> None:
    """A capture in nerfstudio's layout."""
    frames = []
    rendered = read_run(run)
    for view in sorted((*rendered.targets, *rendered.references), key=lambda one: one.name):
        (folder / "images").mkdir(parents=True, exist_ok=True)
        Image.fromarray((view.read_photo() * 255).byte().permute(1, 2, 0).numpy()).save(folder / "images" / view.name)
        frames.append({"file_path": f"images/{view.name}", "transform_matrix": camera_to_world(view.camera).tolist()})
    (folder / "transforms.json").write_text(json.dumps({**CAMERA, "frames": frames}))


def rasterization(*, viewmats, Ks, width, height, render_mode, means, quats, scales, opacities, colors):
    """gsplat's function of that name, by this project's rasteriser."""
    assert render_mode == "RGB+ED"
    drawn = render(
        Gaussians(means, scales.log(), quats, opacities.logit(), colors[:, None]),
        Camera(Ks[0], viewmats[0], height, width),
    )
    return torch.cat([drawn.colour, drawn.depth]).movedim(0, -1)[None], drawn.alpha[..., None], {}


class NerfstudioCameras(list):
    """As much of nerfstudio's ``Cameras`` as the page uses."""

    def __getitem__(self, index: Any) -> Any:
        return NerfstudioCameras(super().__getitem__(index)) if isinstance(index, slice) else super().__getitem__(index)


@pytest.fixture
def scene(plane_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The names that the page takes for granted, in a folder with the files that it names."""
    monkeypatch.chdir(tmp_path)
    rendered, gaussians = read_run(plane_run), coloured_slab()

    def array(image: torch.Tensor) -> np.ndarray:
        return image.permute(1, 2, 0).numpy()

    training = [
        (array(v.read_photo()), v.camera, array(v.read()), v.read_depth()[0].numpy()) for v in rendered.references
    ]
    side = plane_run / "test/ours_100"
    shutil.copytree(side / "renders", "renders")
    shutil.copytree(side / "depth", "depth")
    shutil.copytree(plane_run / "train/ours_100/gt", "photos")
    shutil.copy(plane_run / "cameras.json", "cameras.json")
    shutil.copytree(plane_run, "runs/fit/garden")
    write_capture(tmp_path / "garden", plane_run)
    for splat_file in ("point_cloud.ply", "runs/fit/garden/splat.ply"):
        write_ply(tmp_path / splat_file, gaussians)
    monkeypatch.setattr("gaussian_enhancer.api.splats.DistilSettings", partial(DistilSettings, steps=4, views=2))
    target = rendered.targets[0]

    def outputs(cameras: NerfstudioCameras) -> dict[str, torch.Tensor]:
        (one,) = cameras
        drawn = render(gaussians, one.own)
        return {"rgb": drawn.colour.movedim(0, -1), "depth": drawn.depth.movedim(0, -1)}

    def nerfstudio_camera(camera: Camera) -> SimpleNamespace:
        poses = camera_to_world(camera)[:3]
        return SimpleNamespace(own=camera, camera_to_worlds=poses, get_intrinsics_matrices=lambda: camera.K)

    def rasterised(splats: dict[str, torch.Tensor], camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
        drawn = render(gaussians, camera)
        return drawn.colour, drawn.depth

    splats = {
        "means": gaussians.means,
        "quats": gaussians.quaternions,
        "scales": gaussians.log_scales.exp(),
        "opacities": gaussians.opacity_logits.sigmoid(),
        "colors": gaussians.sh[:, 0],
    }
    return {
        "np": np,
        "torch": torch,
        "training_views": training,
        "render": array(target.read()),
        "render_without_camera": array(target.read()),
        "camera": target.camera,
        "depth": target.read_depth()[0].numpy(),
        "camera_to_world": camera_to_world(target.camera).numpy(),
        "path_renders": [array(v.read()) for v in rendered.targets],
        "path_cameras": [v.camera for v in rendered.targets],
        "path_depths": [v.read_depth()[0].numpy() for v in rendered.targets],
        "rasterization": rasterization,
        "splats": splats,
        "rasterised": rasterised,
        "training_photos": {f"{i}": (one[0], one[1]) for i, one in enumerate(training)},
        "model": SimpleNamespace(get_outputs_for_camera=outputs),
        "cameras": NerfstudioCameras([nerfstudio_camera(target.camera)]),
    }


def snippets() -> Iterator[tuple[int, str]]:
    """Line and text of each Python block."""
    text = PAGE.read_text(encoding="utf-8")
    for match in re.finditer(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        yield text[: match.start(1)].count("\n"), match[1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the depth is none of what:UserWarning")  # 200 random Gaussians are no scene
def test_every_snippet_runs(scene: dict[str, Any], capsys: pytest.CaptureFixture[str]):
    names = dict(scene)
    shapes = []
    for line, text in snippets():
        exec(compile("\n" * line + text, str(PAGE), "exec"), names)
        shapes.append(tuple(names["image"].shape))
    assert len(shapes) == 13
    assert set(shapes) == {(48, 64, 3), (3, 48, 64)}
    assert names["video"].shape == (2, 48, 64, 3)
    assert torch.allclose(torch.as_tensor(names["world_to_camera"]).float(), scene["camera"].world_to_camera, atol=1e-6)
    assert [len(list(Path(folder).iterdir())) for folder in FOLDERS] == [2, 2, 1, 1]
    printed = capsys.readouterr().out
    assert printed.startswith("render 0: has references but no camera to reproject them by")


def test_the_first_snippet_is_five_lines():
    _, first = next(iter(snippets()))
    assert len(first.splitlines()) == 5
