"""Time and memory of enhancing one view, by output resolution, on the available device.

A `SetEnhancer` is measured on a view and its references in memory: choosing and aligning references, and the network.
The scene is a slanted textured plane with exact depth, so that no dataset is needed.

Axes: h height, w width.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache

import torch
import torch.nn.functional as F
from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from torch import Tensor

from ablations.study.cost import device_description, memory_description, peak_memory
from ablations.study.missing import missing_record, reason_of
from ablations.suite.descriptions import Experiment
from ablations.suite.method_runs import Runs
from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.console import print_line
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.metrics.cost import time_interleaved
from gaussian_enhancer.metrics.provenance import this_machine
from gaussian_enhancer.metrics.records import Record, read_records, write_records
from gaussian_enhancer.runs import status
from gaussian_enhancer.runs.run import find_run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import Camera, identity_camera

MEGABYTE = 1e6
REFERENCES = 5


def cost_records(runs: Runs, experiment: Experiment, console: Console) -> Iterator[Record]:
    """Measure the cost of every method at every output size, with the first seed.

    The methods are timed in turn, one repeat of each per round. A method that cannot be measured gives a record with
    the reason.
    """
    seed = experiment.table.seeds[0]
    weights: dict[str, str] = {}
    training_digests: dict[str, str] = {}
    reasons: dict[str, str] = {}
    for method in experiment.table.methods:
        try:
            weights[method], training_digests[method] = (
                runs.weights(experiment, method, seed),
                runs.train_digest(experiment, method, seed),
            )
        except Exception as error:  # the other methods are still measured
            reasons[method] = reason_of(error)
            print_line(console, f"{method} is missing: {reasons[method]}")
    for size, (height, width) in runs.cfg.scale.outputs.items():
        for method, reason in reasons.items():
            yield missing_record(method, reason, scene=str(size), view=str(size), seed=seed)
        if weights:
            console.print(f"{size}: {width}x{height}", highlight=False)
            job = cost_job(runs, training_digests, str(size), (int(height), int(width)))
            for record in _size_records(runs, weights, job):
                training_name = find_checkpoint(weights[record.variant]).parent.name
                yield replace(record, seed=seed, sources={"train": training_name})


def cost_job(runs: Runs, training_digests: Mapping[str, str], size: str, shape: tuple[int, int]) -> DictConfig:
    """The configuration of the cost measurement at an output size: the methods' trainings, and the machine.

    Args:
        runs: the suite's runs.
        training_digests: training digest by method.
        size: name of the output size.
        shape: height and width of the output, in pixels.
    """
    conditions = {"shape": list(shape), "repeats": runs.cfg.scale.repeats, "machine": this_machine()}
    return OmegaConf.create({"runs": runs.cfg.runs, "size": size, "train": dict(training_digests), **conditions})


def _size_records(runs: Runs, weights: Mapping[str, str], job: DictConfig) -> tuple[Record, ...]:
    """The records of an output size; read from disk if this machine has measured the same weights before."""
    run = find_run(job, "cost")
    if run is None or not run.done:
        with status.track_runs():
            run = open_run(job, "cost", job.size)
            records = tuple(_timed(runs, weights, job.size, tuple(job.shape), run.folder.name))
            write_records(run.folder / "records.jsonl", records)
            run.finish()
    return read_records(run.folder / "records.jsonl")


def _timed(runs: Runs, weights: Mapping[str, str], size: str, shape: tuple[int, int], name: str) -> Iterator[Record]:
    device = start(runs.cfg.runtime)
    cached_plane = cache(plane)
    calls = {method: _enhance_call(path, shape, device, cached_plane) for method, path in weights.items()}
    times = time_interleaved(calls, int(runs.cfg.scale.repeats), 1, device)
    calls.clear()
    cached_plane.cache_clear()  # peak memory then counts only a method's own inputs
    protocol = f"{device_description(device)}: median of {runs.cfg.scale.repeats} interleaved repeats; "
    protocol += f"peak memory {memory_description(device)}"
    for method, timing in times.items():
        peak = peak_memory(_enhance_call(weights[method], shape, device, plane), device) / MEGABYTE
        metrics: dict[str, float | None] = {"milliseconds": timing.milliseconds, "peak_memory_mb": peak}
        yield Record("cost", name, size, "", size, method, metrics, size=(shape[1], shape[0]), protocol=protocol)


def _enhance_call(
    path: str, shape: tuple[int, int], device: torch.device, make_views: Callable[[int, int, int], RenderedSet]
) -> Callable[[], object]:
    """A function that enhances one view by the weights of a file; network and views are loaded immediately."""
    pretrained = load_weights(path)
    enhancer = SetEnhancer(pretrained.network, pretrained.reference_config, device)
    height, width = (side // pretrained.network.scale for side in shape)
    views = make_views(height, width, pretrained.network.scale)
    return lambda: [result.image for result in enhancer(views)]


def plane(height: int, width: int, scale: int = 1) -> RenderedSet:
    """A target view of a textured plane, and reference views around it.

    Args:
        height: of the renders, in pixels.
        width: of the renders, in pixels.
        scale: resolution of the fine photos over that of the renders.
    """
    texture = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))

    def view(index: int) -> RenderedView:
        camera = _camera(index, height, width)
        photo, depth = _render_plane(camera, texture)
        alpha = torch.ones_like(depth)
        fine = cache(lambda: _render_plane(camera.resized(scale * height, scale * width), texture)[0])
        return RenderedView(
            f"{index}.png",
            lambda: photo,
            camera,
            lambda: depth,
            lambda: alpha,
            lambda: photo,
            fine if scale > 1 else None,
        )

    views = [view(index) for index in range(1 + REFERENCES)]
    for rendered_view in views:
        if rendered_view.read_fine_photo is not None:
            rendered_view.read_fine_photo()  # fills the cache: reading is not part of the measurement
    return RenderedSet("plane", (views[0],), tuple(views[1:]))


def _camera(index: int, height: int, width: int) -> Camera:
    """The first camera (index 0), or one of those on a small circle around it."""
    camera, pose = identity_camera(height, width, float(width)), torch.eye(4)
    if index:
        angle = 2 * math.pi * index / REFERENCES
        pose[:2, 3] = 0.1 * torch.tensor([math.cos(angle), math.sin(angle)])
    return Camera(camera.K, pose, height, width)


def _render_plane(
    camera: Camera, texture: Float[Tensor, "1 3 a a"]
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "1 h w"]]:
    """Photo and z depth of the plane z = 3 + x / 4, as a camera sees it."""
    rows, columns = torch.meshgrid(torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij")
    rays = torch.linalg.inv(camera.K) @ torch.stack([columns, rows, torch.ones_like(rows)]).flatten(1)
    centre = camera.centre
    depth = (3 + centre[0] / 4 - centre[2]) / (1 - rays[0] / 4)
    points = centre[:, None] + rays * depth
    grid = (points[:2].T / 3).view(1, camera.height, camera.width, 2)
    photo = F.grid_sample(texture, grid, align_corners=False, padding_mode="reflection")[0].clamp(0, 1)
    return photo, depth.view(1, camera.height, camera.width)
