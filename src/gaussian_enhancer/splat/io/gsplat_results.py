"""Reading of the result folder and the checkpoints of gsplat's example trainer, simple_trainer.

``ckpts/ckpt_STEP_rankR.pt`` holds the part of the splat that was on the GPU of rank R: ``{"splats": {means, scales,
quats, opacities, sh0, shN}}``, with scales as natural logarithms, opacities as logits and quaternions as (w, x, y, z).
With ``save_ply`` there is also ``ply/point_cloud_STEP.ply``. Source: gsplat (Apache-2.0), examples/simple_trainer.py.

Axes: n Gaussians, k spherical-harmonics coefficients.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import convert_read_errors, refuse_larger, refuse_larger_archive, regular_file
from gaussian_enhancer.splat.io.validity import refuse_or_drop_invalid
from gaussian_enhancer.types import Gaussians

PLY = re.compile(r"point_cloud_(\d+)\.ply")
CHECKPOINT = re.compile(r"ckpt_(\d+)_rank(\d+)\.pt")
SHAPES: Mapping[str, tuple[int | None, ...]] = {
    "means": (3,),
    "scales": (3,),
    "quats": (4,),
    "opacities": (),
    "sh0": (1, 3),
    "shN": (None, 3),
}
"""Shape of each tensor after the axis of Gaussians; None stands for any length."""
_REMEDY = "give the .ply that simple_trainer writes with --save-ply"


def refuse_normalised(splat: str | Path) -> None:
    """Raise an error for a result folder whose splat is in other coordinates than its capture.

    By default simple_trainer translates, rotates and scales the cameras before training.

    Args:
        splat: a result folder or a file in it; other files are accepted without a check.

    Raises:
        InputError: the folder's ``cfg.yml`` says that the world was normalised.
    """
    path = Path(splat)
    with convert_read_errors(path):
        config = (path if path.is_dir() else path.parent.parent) / "cfg.yml"
        if not config.is_file():
            return
    with convert_read_errors(config):
        text = config.read_text(encoding="utf-8", errors="replace")  # not parsed: its YAML names Python objects
    if re.search(r"^normalize_world_space: true$", text, flags=re.MULTILINE):
        received = "says normalize_world_space: true, so the splat and its capture have different coordinates"
        raise InputError(config, received, "train with --no-normalize-world-space")


def read_gsplat_checkpoint(path: str | Path, *, invalid: str = "refuse") -> Gaussians:
    """Read a checkpoint and join the parts of all ranks, float32 on the CPU.

    Args:
        path: the file of any rank; the other ranks' files are in the same folder.
        invalid: what to do with Gaussians that cannot be rendered: "refuse" or "drop".

    Raises:
        InputError: a file is missing, damaged or not from simple_trainer, or holds another kind of splat or invalid
            Gaussians that are refused.
    """
    file = Path(path)
    ranks = [_read_rank(rank_file) for rank_file in _rank_files(file)]
    if len({tensors["shN"].shape[1] for tensors in ranks}) > 1:
        raise InputError(file, "has parts of different degrees", _REMEDY)
    joined = {name: torch.cat([tensors[name] for tensors in ranks]) for name in SHAPES}
    gaussians = Gaussians(
        means=joined["means"],
        log_scales=joined["scales"],
        quaternions=joined["quats"],
        opacity_logits=joined["opacities"],
        sh=torch.cat([joined["sh0"], joined["shN"]], dim=1),
    )
    return refuse_or_drop_invalid(path, gaussians, invalid)


def _rank_files(file: Path) -> list[Path]:
    """The files of a checkpoint's ranks, in order; a file whose name states no rank stands alone."""
    match = CHECKPOINT.fullmatch(file.name)
    if match is None:
        return [file]
    matches = filter(None, (CHECKPOINT.fullmatch(path.name) for path in file.parent.iterdir()))
    by_rank = {int(other[2]): file.parent / other[0] for other in matches if other[1] == match[1]}
    if sorted(by_rank) != list(range(len(by_rank))):
        raise InputError(file, f"lies beside ranks {sorted(by_rank)}, of which one is missing", _REMEDY)
    return [by_rank[rank] for rank in sorted(by_rank)]


def _read_rank(path: Path) -> dict[str, Tensor]:
    """The tensors of one rank, validated."""
    try:
        refuse_larger_archive(path)
        values: Any = torch.load(path, map_location="cpu", weights_only=True)
    except InputError:
        raise
    except Exception as error:  # damaged bytes can raise any exception in zipfile and torch's unpickler
        cause = str(error).strip().split(". ")[0].splitlines() or [type(error).__name__]
        received = f"is an archive, but no checkpoint that can be read ({cause[0]})"
        raise InputError(path, received, "give a .ply, or a checkpoint that gsplat's simple_trainer wrote") from error
    splats = values.get("splats") if isinstance(values, Mapping) else None
    if not isinstance(splats, Mapping):
        raise InputError(path, 'has no "splats"', "give a checkpoint of gsplat's simple_trainer")
    missing = [name for name in SHAPES if not isinstance(splats.get(name), Tensor)]
    if missing:
        raise InputError(path, f"has no {', '.join(missing)} among its splats", _REMEDY)
    count = len(splats["means"]) if splats["means"].dim() else 0
    for name, axes in SHAPES.items():
        shape = tuple(splats[name].shape)
        sizes_match = all(expected in (None, actual) for expected, actual in zip((count, *axes), shape, strict=False))
        if len(shape) != 1 + len(axes) or not sizes_match:
            raise InputError(path, f"has {name} of shape {shape} for {count} Gaussians", _REMEDY)
    if 1 + splats["shN"].shape[1] not in (1, 4, 9, 16):
        raise InputError(path, f"has {splats['shN'].shape[1]} higher harmonics", "train with a degree of 0 to 3")
    # An expanded tensor has more elements than the file stores.
    element_count = sum(splats[name].numel() for name in SHAPES)
    if element_count > regular_file(path):
        refuse_larger(path, 4 * element_count, f"claims {count} Gaussians")
    return {name: splats[name].detach().float().contiguous() for name in SHAPES}
