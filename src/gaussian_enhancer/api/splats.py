"""`distil_splat`: distil a splat from Python."""

import shutil
import warnings
from pathlib import Path
from typing import Any

from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.distil.prune import PruneSettings
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.distil.task import distil_task, enhancer_of_new_views, find_splat_and_capture, improve_splat
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import file_digest
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.runs.runtime import choose_device
from gaussian_enhancer.scene.capture import open_capture
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.splat.fit.checkpoint import discard_checkpoint
from gaussian_enhancer.splat.fit.export import export_splat


def distil_splat(
    run: str | Path | None = None,
    gaussians: str | Path | None = None,
    scene: str | Path | Scene | None = None,
    *,
    output: str | Path,
    downscale: int | float = 1,
    method: str = "auto",
    weights: str | Path = "lr_tiny",
    device: str | None = None,
    settings: DistilSettings | None = None,
    prune: PruneSettings | None = None,
    progress: bool = True,
    **options: Any,
) -> Path:
    """Train a splat on its enhanced views, so that it contains what enhancement adds; write a ``.ply`` for any viewer.

    The result is the same as that of ``gaussian-enhancer distil``, whose documentation describes the method. A killed
    call resumes when it is repeated with the same arguments.

    Args:
        run: folder of a fitted run, this project's or original 3DGS output. Give this, or ``gaussians`` with ``scene``.
        gaussians: file of a splat.
        scene: the capture of the splat: its folder (COLMAP, nerfstudio, NeRF-Synthetic, OpenSfM), or an opened `Scene`.
        output: output folder; it must not hold a splat yet.
        downscale: for a capture's folder: factor by which width and height of its photos are divided.
        method: rendering method: "auto", "3dgs", "2dgs" or "mip_splatting".
        weights: a name of the package's weights, or the path of a ``.safetensors`` file.
        device: "cpu" or "cuda"; None selects CUDA if it is available.
        settings: steps, rounds, views and learning rates; None uses the defaults of `DistilSettings`.
        prune: settings for the removal of floaters before training; None skips it.
        progress: show progress bars.
        **options: fields of `EnhancementOptions` for the enhancement of the new views.

    Returns:
        The path of ``splat.ply`` in the folder.

    Raises:
        InputError: the input, the weights or an option cannot be used, or the folder already holds a splat or cannot be
            written.
    """
    folder = Path(output)
    if folder.is_file() or (folder / "splat.ply").exists():
        raise InputError(folder, "is a file or holds a splat already", "name another folder")
    target_device = choose_device("auto" if device is None else device)
    distil_settings = DistilSettings() if settings is None else settings
    enhancement_options = EnhancementOptions.of(**{"plan": "full", **options})
    given_capture = open_capture(scene, downscale=downscale) if isinstance(scene, str | Path) else scene
    splat, capture = find_splat_and_capture(run, gaussians, given_capture)
    task = distil_task(splat, capture, distil_settings, prune, method=method, device=target_device)
    for warning in task.mismatch_warnings():
        warnings.warn(warning, stacklevel=2)
    enhancer, provenance = None, f"{file_digest(splat)}, {prune}"
    if task.makes_views:
        enhancer = enhancer_of_new_views(task, weights, enhancement_options, target_device)
        provenance += f", {file_digest(find_checkpoint(weights))}, {enhancement_options}"
    distilled = improve_splat(task, enhancer, folder, progress=progress, input_identity=provenance)
    export_splat(folder, capture, distilled)
    discard_checkpoint(folder)
    shutil.rmtree(folder / "rounds", ignore_errors=True)
    return folder / "splat.ply"
