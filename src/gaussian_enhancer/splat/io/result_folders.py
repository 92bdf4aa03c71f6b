"""Finds the latest splat in a result folder of the original 3DGS or of gsplat's example trainer, simple_trainer."""

import re
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import convert_read_errors
from gaussian_enhancer.splat.io.gsplat_results import CHECKPOINT, PLY

ITERATION = re.compile(r"iteration_(\d+)")


def find_splat(path: str | Path) -> Path:
    """Return a file's path unchanged; of a result folder, the latest step's .ply, or its checkpoint without a .ply.

    Args:
        path: a splat's file, the original 3DGS's ``model_path``, or simple_trainer's ``result_dir``.

    Raises:
        InputError: the folder holds no splat, or cannot be read.
    """
    folder = Path(path)
    with convert_read_errors(folder):
        if not folder.is_dir():
            return folder
    latest = latest_iteration(folder)
    if latest is not None:
        return latest
    candidates = [
        (int(match[1]), subfolder == "ply", path)
        for subfolder, pattern in (("ckpts", CHECKPOINT), ("ply", PLY))
        for path in folder.glob(f"{subfolder}/*")
        if (match := pattern.fullmatch(path.name)) and match.groups()[1:] in ((), ("0",))
    ]
    if not candidates:
        received = (
            "is a folder without point_cloud/iteration_STEP/point_cloud.ply, ply/point_cloud_STEP.ply and "
            "ckpts/ckpt_STEP_rank0.pt"
        )
        raise InputError(folder, received, "name the splat's file, or a result folder of 3DGS or gsplat")
    return max(candidates)[2]


def latest_iteration(folder: Path) -> Path | None:
    """The splat of the latest iteration in a result folder of the original 3DGS; None if there is none."""
    by_iteration = {
        int(match[1]): path
        for path in folder.glob("point_cloud/iteration_*/point_cloud.ply")
        if (match := ITERATION.fullmatch(path.parent.name))
    }
    return by_iteration[max(by_iteration)] if by_iteration else None
