"""Loader of published datasets' scenes, following the field's evaluation conventions.

Mip-NeRF 360 includes photos downscaled by its authors (``images_2``, ``images_4``, ``images_8``). Those files are used,
since another downscaling changes PSNR by up to 0.3 dB (gsplat, pull request 507). Every 8th photo by name is held out.
NeRF-Synthetic has its own split and a white background.
"""

from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.colmap import MODEL_FOLDERS, find_model, load_colmap
from gaussian_enhancer.scene.datasets import published_dataset
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.transforms import load_nerf_synthetic


def load_published(
    path: str | Path,
    *,
    dataset: str,
    name: str,
    photos: int | None = None,
    downscale: int | float = 1,
    split: Split | None = None,
    missing: str = "error",
    background: tuple[float, float, float] | None = None,
) -> Scene:
    """A scene of a published dataset.

    Args:
        path: the scene's folder, as created by the job ``download``.
        dataset: name of a file in ``conf/dataset``.
        name: the scene's name.
        photos: number of photos of the published scene; None accepts any number.
        downscale: factor that divides width and height; one of the authors' factors where they published several sizes.
        split: how to divide the photos; where None, every 8th is held out, or NeRF-Synthetic's own split is used.
        missing: what to do with photos without a camera and cameras without a photo: "error" or "drop".
        background: colour under transparent photos; the dataset's where None.

    Raises:
        InputError: the dataset is unknown, files are missing (the message gives the command that downloads them), the
            number of photos differs while ``missing`` is "error", or the layout's loader refuses the files.
    """
    root = Path(path)
    absent_paths = missing_parts(root, dataset, downscale)
    if absent_paths:
        raise InputError(absent_paths[0], "does not exist", download_command(root, dataset, name, downscale))
    description = published_dataset(dataset)
    background_colour = description.background if background is None else background
    if description.layout == "transforms":
        scene = load_nerf_synthetic(
            root, downscale=downscale, split=split, missing=missing, background=background_colour, name=name
        )
    else:
        factor = 1 if description.pyramid else downscale
        images = description.photo_folder(downscale)
        scene = load_colmap(
            root, images=images, downscale=factor, split=split, missing=missing, background=background_colour, name=name
        )
    if photos not in (None, len(scene.photos)) and missing == "error":
        received = f"holds {len(scene.photos)} photos where the published scene has {photos}"
        raise InputError(root, received, "complete it, or pass scene.photos=null to use the existing photos")
    return scene


def missing_parts(path: Path, dataset: str, downscale: int | float = 1) -> tuple[Path, ...]:
    """Required files and folders of a scene that are not on disk.

    Args:
        path: the scene's folder.
        dataset: name of a file in ``conf/dataset``.
        downscale: downscaling factor of the photos to read.

    Raises:
        InputError: the dataset is unknown, or has no photos downscaled by that factor.
    """
    description = published_dataset(dataset)
    if description.layout == "transforms":
        required_paths = (path / name for side in ("train", "test") for name in (f"transforms_{side}.json", side))
        return tuple(required for required in required_paths if not required.exists())
    images = path / description.photo_folder(downscale)
    missing_model = () if find_model(path) is not None else (path / MODEL_FOLDERS[0],)
    return (*(() if images.is_dir() else (images,)), *missing_model)


def download_command(path: Path, dataset: str, name: str, downscale: int | float = 1) -> str:
    """Remedy for an error message: the command line that downloads a scene.

    Args:
        path: the scene's folder.
        dataset: name of a file in ``conf/dataset``.
        name: the scene's name.
        downscale: downscaling factor of the photos to read.
    """
    arguments = [f"gaussian-enhancer download dataset={dataset} scenes=[{name}]"]
    description = published_dataset(dataset)
    if description.pyramid:
        arguments.append(f"images=[{description.photo_folder(downscale)}]")
    if path.parts[-2:] != (dataset, name):
        return f"fetch it ({' '.join(arguments)}) and give its folder as scene.path"
    return f"fetch it: {' '.join(arguments)} folder={path.parent.parent}"
