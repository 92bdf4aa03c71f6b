"""`distil_splat`: a better splat from Python."""

import shutil
from pathlib import Path
from typing import Any

from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.distil.prune import PruneSettings
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.distil.task import better_splat, distil_task, enhancer_of_new_views, given_splat
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.runs.runtime import choose_device
from gaussian_enhancer.runs.video import file_digest
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
    """Put what the enhancer adds back into a splat: a ``.ply`` that any viewer opens.

    The splat is that of ``gaussian-enhancer distil``, which documents what is done. A call that was killed goes on with
    the same arguments.

    Args:
        run: folder of a fitted run, this project's or original 3DGS output. Give this, or ``gaussians`` with ``scene``.
        gaussians: file of a splat.
        scene: its capture: the folder (COLMAP, nerfstudio, NeRF-Synthetic, OpenSfM), or an opened `Scene`.
        output: folder that is written; it must not hold a splat yet.
        downscale: of a capture's folder: divides width and height of its photos.
        method: how the splat is rendered: "auto", "3dgs", "2dgs" or "mip_splatting".
        weights: a name of the package's weights, or the path of a ``.safetensors`` file.
        device: "cpu" or "cuda"; None takes CUDA where there is one.
        settings: steps, rounds, views and rates; None takes the defaults of `DistilSettings`.
        prune: remove floaters first, by this evidence; None removes none.
        progress: show progress bars.
        **options: fields of `EnhancementOptions`, by which the new views are enhanced.

    Returns:
        The file ``splat.ply`` in the folder.

    Raises:
        InputError: the input, the weights or an option cannot be used, or the folder holds a splat already or cannot
            be written.
    """
    folder = Path(output)
    if folder.is_file() or (folder / "splat.ply").exists():
        raise InputError(folder, "is a file or holds a splat already", "name another folder")
    chosen = choose_device("auto" if device is None else device)
    further = DistilSettings() if settings is None else settings
    how = EnhancementOptions(**{"plan": "full", **options})
    if run is None and isinstance(scene, str | Path):
        scene = open_capture(scene, downscale=downscale)
    splat, capture = given_splat(run, gaussians, scene if isinstance(scene, Scene) else None)
    task = distil_task(splat, capture, further, prune, method=method, device=chosen)
    enhancer, made_of = None, f"{file_digest(splat)}, {prune}"
    if task.makes_views:
        enhancer = enhancer_of_new_views(task, weights, how, chosen)
        made_of += f", {file_digest(find_checkpoint(weights))}, {how}"
    better = better_splat(task, enhancer, folder, progress=progress, made_of=made_of)
    export_splat(folder, capture, better)
    discard_checkpoint(folder)
    shutil.rmtree(folder / "rounds", ignore_errors=True)
    return folder / "splat.ply"
