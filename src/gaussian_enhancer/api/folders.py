"""`enhance_folder`: enhance renders on disk from Python."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.preload import validation_reads
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.earlier_step import EarlierStep, choose_earlier_step, single_step_options
from gaussian_enhancer.runs.enhancement import (
    lost_references,
    mismatch_warnings,
    prepare_enhancement,
    recover_missing_geometry,
)
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos, high_resolution_values
from gaussian_enhancer.runs.inputs import InputPaths, refuse_input_folder
from gaussian_enhancer.runs.output import write_enhanced
from gaussian_enhancer.runs.runtime import choose_device
from gaussian_enhancer.runs.second_splat import averaged_with, first_form, refuse_other_views
from gaussian_enhancer.scene.capture import open_capture
from gaussian_enhancer.scene.high_resolution import attach_fine_photos
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.scene import Scene


def enhance_folder(
    renders: str | Path | None = None,
    photos: str | Path | None = None,
    cameras: str | Path | None = None,
    depth: str | Path | None = None,
    *,
    output: str | Path,
    references: str | Path | None = None,
    depth_scale: int | float = 1.0,
    run: str | Path | None = None,
    step: int | None = None,
    gaussians: str | Path | None = None,
    second: str | Path | None = None,
    earlier_step: EarlierStep = "auto",
    scene: str | Path | Scene | None = None,
    downscale: int | float = 1,
    method: str = "auto",
    views: str = "test",
    weights: str | Path = "lr_tiny",
    device: str | None = None,
    recover_geometry: bool = True,
    **options: Any,
) -> tuple[Path, ...]:
    """Enhance a folder of renders, a fitted run, or a splat with its capture; images keep the names of the renders.

    The images are the same as those of ``gaussian-enhancer enhance output=FOLDER``. All input is read before the first
    image is written, so that a damaged file leaves no incomplete folder.

    Args:
        renders: folder of renders. Give this, or ``run``, or ``gaussians`` with ``scene``.
        photos: folder of photos. A photo with a render's name is its ground truth; the others are references.
        cameras: ``cameras.json`` in 3DGS's list format, of renders and references.
        depth: folder of z-depth maps with the names of the renders: ``.npy``, ``.npz`` or 16-bit ``.png``.
        output: output folder.
        references: folder of reference photos, where ``photos`` holds only ground truth.
        depth_scale: scene units per stored unit of depth.
        run: folder of a fitted run, this project's or original 3DGS output.
        step: for a run: the training step whose renders are enhanced; None selects the latest.
        gaussians: file of a splat.
        second: another splat of the same capture, a folder beside ``run`` or a file beside ``gaussians``. The enhanced
            views of both are averaged, which takes twice as long.
        earlier_step: for a run, or a result folder of the original 3DGS: the renders of this earlier step are enhanced
            as well, and used where photos decide for them, which gains more and takes about 1.3 times as long. "auto"
            takes the step nearest to a fifth of the fit, from 3000 on, if there is one, and no step beside ``second``
            and ``max_references=0``, or for weights that do not warp references; None uses none.
        scene: the capture: its folder (COLMAP, nerfstudio, NeRF-Synthetic, OpenSfM), or an opened `Scene`.
        downscale: for a capture's folder: factor by which width and height of its photos are divided.
        method: for a splat: rendering method, "auto", "3dgs", "2dgs" or "mip_splatting".
        views: for a splat: the cameras that it is rendered from, "test", "train" or "all".
        weights: a name of the package's weights, or the path of a ``.safetensors`` file.
        device: "cpu" or "cuda"; None selects CUDA if it is available.
        recover_geometry: recover cameras and depth that are not given, by structure from motion of renders and photos,
            and by plane sweep. They are kept in the folder ``geometry`` of the output. Without them no photo can be
            used.
        **options: fields of `EnhancementOptions`, for instance ``strength=0.5``.

    Returns:
        The files that were written, in the order of the renders.

    Raises:
        InputError: the input, the weights or an option cannot be used, or an image cannot be written.

    Warns:
        UserWarning: references, or their photos at super-resolution, are not used; the text states the reason.
    """
    if Path(output).is_file():
        raise InputError(output, "cannot be written: it is a file", "name a folder")
    form = None if second is None else first_form(run, gaussians)
    target_device: torch.device = choose_device("auto" if device is None else device)
    settings, pretrained = EnhancementOptions.of(**options), load_weights(weights)
    single = {"second": second is not None, **single_step_options(pretrained, settings.max_references)}
    capture = open_capture(scene, downscale=downscale) if isinstance(scene, str | Path) else scene
    paths = InputPaths(
        run,
        gaussians,
        renders,
        step=step,
        method=method,
        views=views,
        photos=photos,
        references=references,
        cameras=cameras,
        depth=depth,
        depth_scale=depth_scale,
        capture=capture,
        attach_fine=_fine_photos(run, scene, downscale, Path(output) / "photos"),
        earlier_step=choose_earlier_step(earlier_step, run, gaussians, step, single),
    )
    task = paths.read(target_device.type, pretrained.reference_config.fine)
    refuse_input_folder(Path(output), task.rendered)
    if recover_geometry:
        task = recover_missing_geometry(task, pretrained, settings, Path(output) / "geometry")
    enhancer, task, validated = prepare_enhancement(pretrained, task, settings, target_device)
    planner = validated.planner(settings.rules)
    for read_file in (*validation_reads(validated, planner), *task.earlier_files):
        read_file()
    reasons = *validated.missing_references, *mismatch_warnings(validated), *lost_references(enhancer, task, validated)
    for reason in filter(None, (task.note, *reasons)):
        warnings.warn(reason, stacklevel=2)
    images = enhancer(task.rendered, planner, validated.pool)
    if second is not None:
        second_paths = replace(paths, run=second) if form == "run" else replace(paths, gaussians=second)
        other = second_paths.read(target_device.type, pretrained.reference_config.fine)
        refuse_other_views(task.rendered, other.rendered)
        prepared = prepare_enhancement(pretrained, other, settings, target_device)
        images = averaged_with(images, prepared, settings.rules)
    enhanced = write_enhanced(images, Path(output), task.rendered, enhancer.network.scale)
    return tuple(Path(output) / view.name for view in enhanced)


def _fine_photos(
    run: str | Path | None, scene: str | Path | Scene | None, downscale: int | float, drawn: Path
) -> Callable[[RenderedSet], RenderedSet] | None:
    """A function that attaches photos at 4 times the renders' resolution; None if their source is not known.

    Photos of a procedural scene are drawn into the folder ``drawn``.
    """
    if isinstance(scene, str | Path):
        return partial(_attach_from_capture, scene, downscale)
    if run is not None and scene is None:
        return partial(HighResolutionPhotos(drawn), Path(run))
    return None


def _attach_from_capture(folder: str | Path, downscale: int | float, rendered: RenderedSet) -> RenderedSet:
    fine_downscale = high_resolution_values({"path": str(folder), "downscale": downscale})["downscale"]
    return attach_fine_photos(rendered, open_capture(folder, downscale=fine_downscale))
