"""Open a capture of any known layout."""

from collections.abc import Callable
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import reader
from gaussian_enhancer.scene.colmap import find_model, load_colmap
from gaussian_enhancer.scene.opensfm import find_reconstruction, load_opensfm
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.transforms import load_nerf_synthetic, load_transforms


@reader
def open_capture(
    path: str | Path,
    *,
    downscale: int | float = 1,
    split: Split | None = None,
    missing: str = "error",
    background: tuple[float, float, float] | None = None,
    name: str = "",
) -> Scene:
    """Open a scene from a folder in any of the known layouts.

    Layouts are tried in this order: ``transforms_train.json`` (NeRF-Synthetic), ``transforms.json`` (nerfstudio,
    instant-ngp), a COLMAP model, OpenSfM's ``reconstruction.json``. Options of a single layout, such as another photo
    folder or file name, are available in its loader only.

    Args:
        path: the capture's folder.
        downscale: factor that divides width and height of the photos read.
        split: how to divide the photos. Where None, the capture's own split is used or, without one, every 8th photo is
            held out.
        missing: what to do with photos without a camera and cameras without a photo: "error" or "drop".
        background: colour under transparent photos; where None, the layout's default (white for NeRF-Synthetic, else
            black).
        name: the scene's name; the folder's where empty.

    Raises:
        InputError: the folder is missing or has an unknown layout, or the layout's loader refuses it.
    """
    load = _loader(Path(path))
    optional_arguments = {} if background is None else {"background": background}
    return load(path, downscale=downscale, split=split, missing=missing, name=name, **optional_arguments)


def _loader(root: Path) -> Callable[..., Scene]:
    if not root.is_dir():
        raise InputError(root, "is no folder", "name the capture's folder")
    if (root / "transforms_train.json").is_file():
        return load_nerf_synthetic
    if (root / "transforms.json").is_file():
        return load_transforms
    if find_model(root) is not None:
        return load_colmap
    if find_reconstruction(root) is not None:
        return load_opensfm
    content = ", ".join(sorted(p.name for p in root.iterdir())[:6]) or "nothing"
    remedy = (
        "give a COLMAP folder (sparse/0), a transforms.json, transforms_train.json or OpenSfM's reconstruction.json"
    )
    raise InputError(root, f"is no capture that can be recognised (it holds {content})", remedy)
