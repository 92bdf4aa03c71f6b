"""The Python API: forms of images, kept references, refusals, and equality with the command line."""

import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageChops

import gaussian_enhancer
from gaussian_enhancer import (
    Camera,
    Enhancer,
    InputError,
    Reference,
    distil_splat,
    enhance_folder,
    load_weights,
    read_splat,
    render,
)
from gaussian_enhancer.align.alignment import Unwarped
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.plan import AUTO, Rules
from gaussian_enhancer.infer.weights import Pretrained, save_weights
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.network.ssif_sr import SSIFSR
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.splat.io.ply import write_ply
from support.failures import interrupt
from support.job_config import QUIET, job_config
from support.synthetic_runs import coloured_sheet, coloured_slab, copy_with_splat

NAMES = (
    "Camera",
    "Enhancer",
    "InputError",
    "Reference",
    "distil_splat",
    "enhance_folder",
    "load_weights",
    "read_splat",
    "render",
)


def configured(*overrides: str):
    return job_config("enhance", *overrides, *QUIET)


@pytest.fixture(scope="module")
def views(plane_run) -> tuple[tuple[RenderedView, ...], list[Reference]]:
    rendered = read_run(plane_run)
    return rendered.targets, [
        Reference(one.read_photo(), one.camera, one.read(), one.read_depth(), one.name) for one in rendered.references
    ]


@pytest.fixture(scope="module")
def enhancer() -> Enhancer:
    return Enhancer.from_pretrained("lr_tiny", device="cpu", depth_kind="surface")


def given(view: RenderedView) -> dict[str, object]:
    return {"camera": view.camera, "depth": view.read_depth(), "alpha": view.read_alpha(), "name": view.name}


def as_numpy(image: torch.Tensor) -> np.ndarray:
    return image.permute(1, 2, 0).numpy()


def as_uint8(image: torch.Tensor) -> torch.Tensor:
    return (image * 255).round().to(torch.uint8)


def test_the_names_are_frozen():
    assert tuple(gaussian_enhancer.__all__) == NAMES
    assert set(NAMES) <= set(dir(gaussian_enhancer))
    for name in NAMES:
        assert getattr(gaussian_enhancer, name).__doc__
    with pytest.raises(AttributeError, match="enhancer_of"):
        gaussian_enhancer.enhancer_of


def test_importing_changes_nothing_and_loads_nothing():
    program = """
import os, sys, random, threading, warnings
modules, environment, filters, state = set(sys.modules), dict(os.environ), list(warnings.filters), random.getstate()
import gaussian_enhancer
assert dict(os.environ) == environment and warnings.filters == filters and random.getstate() == state
assert threading.active_count() == 1
own = {name for name in set(sys.modules) - modules if not name.startswith("gaussian_enhancer")}
assert not {"torch", "numpy", "hydra", "lightning", "wandb"} & own, own
assert {name for name in sys.modules if name.startswith("gaussian_enhancer")} == {"gaussian_enhancer"}
import torch
def state():
    return torch.get_num_threads(), torch.get_default_dtype(), torch.initial_seed(), torch.is_grad_enabled()
before = state()
from gaussian_enhancer import *
assert state() == before
assert dict(os.environ) == environment
assert not {"lightning", "wandb", "lpips", "kornia", "torchmetrics", "torchvision", "gsplat"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_plan_is_the_commands():
    assert build(configured("run=unused").plan) == AUTO
    assert build(configured("run=unused", "plan=full").plan) == EnhancementOptions(plan="full").rules == Rules()


def test_the_image_is_the_commands(plane_run, views, enhancer, tmp_path):
    from gaussian_enhancer.cli.enhance import run

    run(configured(f"run={plane_run}", "weights=lr_tiny", f"output={tmp_path}"))
    targets, references = views
    for view in targets:
        file = torch.from_numpy(np.array(Image.open(tmp_path / view.name))).permute(2, 0, 1)
        image = enhancer(as_uint8(view.read()), references=references, **given(view))
        assert torch.equal(image, file)
        assert not torch.equal(image, as_uint8(view.read()))


def test_forms_of_one_image_give_the_same_image(views, enhancer):
    (view, _), references = views
    expected = enhancer(view.read(), references=references, **given(view))
    assert (expected.dtype, expected.shape) == (torch.float32, view.read().shape)
    arrays = [
        replace(
            one, photo=as_numpy(one.photo), render=as_numpy(as_uint8(one.render)), depth=as_numpy(one.depth)[..., 0]
        )
        for one in references
    ]
    image = as_numpy(view.read())
    known = {**given(view), "depth": view.read_depth()[0].numpy(), "alpha": view.read_alpha()[0].numpy()}
    for dtype in (np.float32, np.float64, np.dtype(">f4")):
        found = enhancer(image.astype(dtype), references=arrays, **known)
        assert isinstance(found, np.ndarray)
        assert (found.dtype, found.shape) == (dtype, image.shape)
        np.testing.assert_allclose(found, as_numpy(expected), atol=2e-6)
    small = enhancer(as_numpy(as_uint8(view.read())), references=arrays, **known)
    np.testing.assert_array_equal(small, as_numpy(as_uint8(expected)))
    half = enhancer(view.read().half(), references=references, **given(view))
    assert half.dtype == torch.float16


def test_a_batch_is_its_images(views, enhancer):
    targets, references = views
    single = [enhancer(view.read(), references=references, **given(view)) for view in targets]
    together = enhancer(
        torch.stack([view.read() for view in targets]),
        [view.camera for view in targets],
        torch.stack([view.read_depth() for view in targets]),
        references,
        alpha=torch.stack([view.read_alpha()[0] for view in targets]),
        name=[view.name for view in targets],
    )
    assert torch.equal(together, torch.stack(single))
    assert torch.equal(
        enhancer(targets[0].read()[None], references=[]), enhancer(targets[0].read(), references=[])[None]
    )


def test_references_are_kept_between_calls_and_read_once(views, monkeypatch):
    (view, other), references = views
    enhancer = Enhancer.from_pretrained("lr_tiny", device="cpu", depth_kind="surface")
    expected = [enhancer(one.read(), references=references, **given(one)) for one in (view, other)]
    for one in references:
        enhancer.add_reference(one)
    assert enhancer.references == tuple(references)
    assert torch.equal(enhancer(view.read(), **given(view)), expected[0])
    reads = []
    pool = enhancer._added_references.pool
    monkeypatch.setattr(pool, "_read", lambda *index: reads.append(index))
    assert torch.equal(enhancer(view.read(), **given(view)), expected[0])
    assert not reads
    assert not enhancer._added_references.planner.plans
    enhancer.clear_references()
    alone = enhancer(view.read(), **given(view))
    assert torch.equal(alone, enhancer(view.read(), references=[], **given(view)))
    assert not torch.equal(alone, expected[0])


def test_features_of_references_that_are_not_warped_are_kept(views):
    torch.manual_seed(0)
    network = SIF((8, 8, 8), (1, 1, 1)).eval()
    torch.nn.init.normal_(network.decode.head.weight, std=0.1)
    enhancer = Enhancer(Pretrained(network, ReferenceConfig(Unwarped(), 2, 2), {}), "cpu")
    (view, _), references = views
    first = enhancer(view.read(), references=references)
    kept = dict(enhancer._call_references.features.entries)
    assert len(kept) == 2
    torch.testing.assert_close(enhancer(view.read(), references=references), first)
    assert all(enhancer._call_references.features.entries[key] is value for key, value in kept.items())


def test_a_reference_that_is_the_view_itself_is_left_out(views, enhancer):
    (view, _), references = views
    answer = Reference(view.read_photo(), view.camera, view.read(), view.read_depth(), view.name)
    with_answer, without = (
        enhancer(view.read(), references=r, **given(view)) for r in ([*references, answer], references)
    )
    assert torch.equal(with_answer, without)
    cheated = enhancer(view.read(), references=[*references, answer], **{**given(view), "name": "other"})
    assert not torch.equal(cheated, without)


def test_without_references_an_image_comes_back_from_the_render_alone(views):
    (view, _), _ = views
    enhancer = Enhancer(Pretrained(SIF((8, 8, 8), (1, 1, 1)).eval(), ReferenceConfig(), {}), "cpu")
    assert torch.equal(enhancer(view.read()), view.read())


def test_super_resolution_returns_four_times_the_size(views):
    (view, _), references = views
    weights = Pretrained(SSIFSR((8, 8, 8), (1, 1, 1)).eval(), ReferenceConfig(fine=True), {})
    enhancer = Enhancer(weights, "cpu")
    assert enhancer.scale == 4
    fine = [replace(one, photo=one.photo.repeat_interleave(4, 1).repeat_interleave(4, 2)) for one in references]
    assert enhancer(as_uint8(view.read()), references=fine, **given(view)).shape == (3, 192, 256)


def test_depth_that_does_not_fit_is_left_out_with_a_warning(views):
    (view, _), references = views
    enhancer = Enhancer.from_pretrained("lr_tiny", device="cpu", depth_kind="surface")
    wrong = {**given(view), "depth": view.read_depth() * 3}
    with pytest.warns(UserWarning, match="the depth is none of what the renders show.*no photo is used"):
        image = enhancer(view.read(), references=references, **wrong)
    torch.testing.assert_close(image, view.read(), rtol=0, atol=1e-6)  # nothing to go by: the render
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        right = enhancer(view.read(), references=references, **given(view))
    assert not torch.equal(right, image)


def test_mistakes_are_refused_with_their_remedy(views, enhancer, tmp_path):
    (view, _), references = views
    image, known = view.read(), given(view)
    one = references[0]
    narrow = one.render[..., ::2]
    for words, call in (
        (r"render: has shape \(48, 64, 3\); give torch images", lambda: enhancer(image.permute(1, 2, 0))),
        (r"render: has shape \(3, 48, 64\); give numpy images", lambda: enhancer(image.numpy())),
        ("render: is of type torch.int64", lambda: enhancer(image.long())),
        ("render: has values up to 255", lambda: enhancer(image / image.max() * 255)),
        ("render: has values that are not finite", lambda: enhancer(image * torch.nan)),
        ("depth: is 1 of 32x48 for render of 1 of 64x48", lambda: enhancer(image, depth=known["depth"][..., ::2])),
        ("depth: has shape", lambda: enhancer(image[None], depth=known["depth"][0])),
        ("depth: has values down to -", lambda: enhancer(image, depth=-known["depth"])),
        ("depth: is of type torch.int32", lambda: enhancer(image, depth=known["depth"].int())),
        ("camera: is for 64x48, and the image is 48x48", lambda: enhancer(image[..., :48], camera=view.camera)),
        ("camera: is no list for a batch of 1", lambda: enhancer(image[None], camera=view.camera)),
        ("camera: has 2 entries for a batch of 1", lambda: enhancer(image[None], camera=[view.camera, view.camera])),
        ("no camera to reproject", lambda: enhancer(image, depth=known["depth"], references=references)),
        ("no depth to reproject", lambda: enhancer(image, camera=view.camera, references=references)),
        ("has no camera; give Reference", lambda: enhancer(image, references=[Reference(one.photo)], **known)),
        ("stands twice", lambda: enhancer(image, references=[one, one], **known)),
        ("photo of reference: has shape", lambda: Reference(one.photo[0])),
        ("photo of reference: has shape", lambda: Reference(one.photo[None])),
        ("render of reference a: is 32x48 for a photo of 64x48", lambda: replace(one, render=narrow, name="a")),
        ("depth of reference: is 64x24", lambda: Reference(one.photo, depth=one.depth[:, ::2])),
        ("camera of reference", lambda: Reference(one.photo[:, :24], one.camera)),
        ("neither a file nor a shipped name", lambda: Enhancer.from_pretrained("lr_absent")),
        ("strength", lambda: Enhancer.from_pretrained("lr_tiny", strength=2)),
        ("depth_kind", lambda: Enhancer.from_pretrained("lr_tiny", depth_kind="mean")),
        ("plan: is 'some'", lambda: Enhancer.from_pretrained("lr_tiny", plan="some")),
        ("background", lambda: Enhancer.from_pretrained("lr_tiny", background=(0, 0, 255))),
        ("device: is 'gpu'", lambda: Enhancer.from_pretrained("lr_tiny", device="gpu")),
        ("device: is 'meta'", lambda: Enhancer.from_pretrained("lr_tiny", device="meta")),
        ("device: is 'xpu'", lambda: Enhancer.from_pretrained("lr_tiny", device="xpu")),
        ("nothing to enhance", lambda: enhance_folder(output=tmp_path / "none")),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            call()
    assert not list(tmp_path.iterdir())


def test_an_unknown_option_is_refused_by_name(tmp_path):
    for call in (
        lambda: Enhancer.from_pretrained("lr_tiny", device="cpu", max_refs=1),
        lambda: enhance_folder(renders=tmp_path, output=tmp_path / "out", max_refs=1),
    ):
        with pytest.raises(InputError, match="options: names 'max_refs'; choose from max_references"):
            call()


def test_wrong_types_are_refused():
    """In a process of its own, since the tests' shape checker refuses them first."""
    program = """
import torch
from gaussian_enhancer import Enhancer, InputError, Reference, render
enhancer, image = Enhancer.from_pretrained("lr_tiny", device="cpu"), torch.rand(3, 16, 16)
for call in (
    lambda: enhancer([[0.0]]),
    lambda: enhancer(image, camera=torch.eye(4)),
    lambda: enhancer(image, references=Reference(image)),
    lambda: enhancer(image, references=[image]),
    lambda: render(None, torch.eye(4)),
):
    try:
        call()
    except InputError as error:
        print(error)
"""
    words = ("is of type list", "from_matrices", "give a list", "give gaussian_enhancer.Reference", "from_matrices")
    lines = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    ).stdout.splitlines()
    assert len(lines) == len(words)
    assert all(word in line for word, line in zip(words, lines, strict=True))


def test_a_camera_of_another_size_with_the_same_aspect_follows(views, enhancer):
    (view, _), references = views
    large = replace(view, camera=view.camera.resized(480, 640))
    expected = enhancer(view.read(), references=references, **given(view))
    found = enhancer(view.read(), references=references, **given(large))
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)


def test_cameras_from_matrices():
    K, pose = [[50.0, 0, 32], [0, 50, 24], [0, 0, 1]], np.eye(4)
    pose[:3, 3] = 1, 2, 3
    camera = Camera.from_matrices(K, pose, 48, 64)
    assert camera.centre.tolist() == [-1, -2, -3]
    assert torch.equal(camera.world_to_camera, Camera.from_matrices(torch.tensor(K), pose[:3], 48, 64).world_to_camera)
    for words, arguments in (
        (r"camera K: has shape \(4, 4\)", (pose, pose, 48, 64)),
        (r"camera pose: has shape \(3, 3\)", (K, K, 48, 64)),
        ("focal lengths above 0", (np.diag([-50, 50, 1]), pose, 48, 64)),
        (r"last row", (K, pose.T, 48, 64)),
        ("K: has the last row", (np.ones((3, 3)), pose, 48, 64)),
        ("rigid", (K, pose * [[2], [2], [2], [1]], 48, 64)),
        ("mirrored", (K, np.diag([-1, 1, 1, 1]), 48, 64)),
        ("NaN", (K, np.where(pose == 3, np.nan, pose), 48, 64)),
        ("image of 64x0", (K, pose, 0, 64)),
        ("no matrix", (K, "identity", 48, 64)),
    ):
        with pytest.raises(InputError, match=words):
            Camera.from_matrices(*arguments)


def test_a_splat_is_read_and_rendered(views, tmp_path):
    (view, _), _ = views
    write_ply(tmp_path / "splat.ply", coloured_slab())
    found = render(read_splat(tmp_path / "splat.ply"), view.camera, background=(1, 1, 1))
    assert found.colour.shape == (3, 48, 64)
    assert found.colour.std() > 0.05
    white = np.ones(3)
    assert torch.equal(render(coloured_slab(), view.camera, background=white).colour, found.colour)
    assert Enhancer.from_pretrained("lr_tiny", background=white).background == (1.0, 1.0, 1.0)
    with pytest.raises(InputError, match="method: is 'nerf'; choose auto, 3dgs"):
        render(coloured_slab(), view.camera, "nerf")
    with pytest.raises(InputError, match=r"background: is \[0, 0, 255\]; give three numbers from 0 to 1"):
        render(coloured_slab(), view.camera, background=(0, 0, 255))


def test_weights_are_loaded():
    assert load_weights("lr_tiny").card["name"] == "lr_tiny"


def same_files(folder: Path, other: Path) -> None:
    names = sorted(path.name for path in other.iterdir())
    assert names == sorted(path.name for path in folder.iterdir())
    for name in names:
        with Image.open(folder / name) as one, Image.open(other / name) as two:
            assert ImageChops.difference(one, two).getbbox() is None, name


def test_folders_are_enhanced_as_by_the_command(plane_run, tmp_path):
    from gaussian_enhancer.cli.enhance import run

    side = plane_run / "test/ours_100"
    folders = {"renders": side / "renders", "photos": plane_run / "train/ours_100/gt"}
    geometry = {"cameras": plane_run / "cameras.json", "depth": side / "depth"}
    words = [f"{name}={path}" for name, path in {**folders, **geometry}.items()]
    run(configured(*words, f"output={tmp_path / 'command'}"))
    written = enhance_folder(**folders, **geometry, output=tmp_path / "api", device="cpu")
    assert written == (tmp_path / "api/view_000.png", tmp_path / "api/view_004.png")
    same_files(tmp_path / "api", tmp_path / "command")
    with pytest.warns(UserWarning, match="cannot be reprojected"):
        enhance_folder(**folders, output=tmp_path / "bare", device="cpu", recover_geometry=False)


def test_runs_and_splats_with_their_scene_are_enhanced(plane_run, tmp_path):
    save_weights(tmp_path / "a.safetensors", SIF((8, 8, 8), (1, 1, 1)), ReferenceConfig(), {})
    weights = tmp_path / "a.safetensors"
    enhance_folder(run=plane_run, step=50, output=tmp_path / "run", weights=weights, device="cpu")
    same_files(tmp_path / "run", plane_run / "test/ours_50/renders")
    from gaussian_enhancer.scene.scene import Photo, Scene

    views = read_run(plane_run).references
    photos = tuple(Photo(view.name, view.camera, view.read_photo) for view in views)
    scene = Scene("plane", photos, tuple(range(1, len(photos))), (0,))
    write_ply(tmp_path / "splat.ply", coloured_slab())
    (written,) = enhance_folder(
        gaussians=tmp_path / "splat.ply", scene=scene, output=tmp_path / "splat", weights=weights, device="cpu"
    )
    assert Image.open(written).size == (64, 48)


def test_a_splat_is_distilled_as_by_the_command(plane_run, tmp_path, monkeypatch):
    from gaussian_enhancer.cli.distil import run

    fitted = copy_with_splat(plane_run, tmp_path / "plane", coloured_sheet(24))
    save_weights(tmp_path / "a.safetensors", SIF((8, 8, 8), (1, 1, 1)), ReferenceConfig(), {"strength": 1.0})
    given = {"run": fitted, "weights": tmp_path / "a.safetensors"}
    words = [f"{name}={value}" for name, value in given.items()]
    few = DistilSettings(steps=20, views=3)
    run(job_config("distil", *words, "settings.steps=20", "settings.views=3", f"output={tmp_path / 'job'}", *QUIET))

    def distilled(**other: object) -> Path:
        asked = {"settings": few, "output": tmp_path / "api", "device": "cpu", "progress": False, **given, **other}
        return distil_splat(**asked)

    with monkeypatch.context() as patched:
        patched.setattr("gaussian_enhancer.distil.distil.EnhancedViews.make", interrupt)
        with pytest.raises(KeyboardInterrupt):
            distilled()
    with pytest.raises(InputError, match="belongs to a fit with other settings"):
        distilled(strength=0.5)
    assert distilled() == tmp_path / "api/splat.ply"
    assert (tmp_path / "api/splat.ply").read_bytes() == (tmp_path / "job/splat.ply").read_bytes()
    assert sorted(path.name for path in (tmp_path / "api").iterdir()) == ["cfg_args", "splat.ply"]
    for told, other in (
        ("holds a splat already", {}),
        ("was given no splat", {"run": None, "output": tmp_path / "new"}),
        ("comes without its capture", {"run": None, "gaussians": tmp_path / "x.ply", "output": tmp_path / "new"}),
    ):
        with pytest.raises(InputError, match=told):
            distilled(**other)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("module", ["api.enhancer", "api.rendering", "types"])
def test_examples_of_the_documentation_run(module):
    import doctest
    import importlib

    imported = importlib.import_module(f"gaussian_enhancer.{module}")
    names = {name: getattr(gaussian_enhancer, name) for name in NAMES}
    found = doctest.testmod(imported, extraglobs={**names, "torch": torch})
    assert (found.failed, found.attempted > 0) == (0, True)
