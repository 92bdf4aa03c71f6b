"""Scenes of published datasets, by the conventions under which the field measures on them.

Mip-NeRF 360 comes with its photos downscaled by its authors (``images_2``, ``images_4``, ``images_8``); those files are
used, since photos that were downscaled otherwise change PSNR by up to 0.3 dB (gsplat, pull request 507). Every 8th
photo by name is held out. NeRF-Synthetic has a split of its own and lies over white.
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
        path: the scene's folder, as the job ``download`` leaves it.
        dataset: name of a file of ``conf/dataset``.
        name: the scene's name.
        photos: how many photos the published scene has; None to take what is there.
        downscale: factor that divides width and height; where the authors published several sizes, one of theirs.
        split: how to divide the photos; every 8th held out, or NeRF-Synthetic's own split, where None.
        missing: what to do with photos without a camera and cameras without a photo: "error" or "drop".
        background: colour under transparent photos; the dataset's where None.

    Raises:
        InputError: the dataset is unknown, files are not there (the command that fetches them is named), the number
            of photos is another one, or the layout's loader refuses them.
    """
    root = Path(path)
    absent = missing_parts(root, dataset, downscale)
    if absent:
        raise InputError(absent[0], "does not exist", download_command(root, dataset, name, downscale))
    facts = published_dataset(dataset)
    ground = facts.background if background is None else background
    if facts.layout == "transforms":
        scene = load_nerf_synthetic(
            root, downscale=downscale, split=split, missing=missing, background=ground, name=name
        )
    else:
        factor = 1 if facts.pyramid else downscale
        images = facts.photo_folder(downscale)
        scene = load_colmap(
            root, images=images, downscale=factor, split=split, missing=missing, background=ground, name=name
        )
    if photos not in (None, len(scene.photos)) and missing == "error":
        received = f"holds {len(scene.photos)} photos where the published scene has {photos}"
        raise InputError(root, received, "complete it, or pass scene.photos=null to measure on what is there")
    return scene


def missing_parts(path: Path, dataset: str, downscale: int | float = 1) -> tuple[Path, ...]:
    """Files and folders of a scene that are required and missing.

    Args:
        path: the scene's folder.
        dataset: name of a file of ``conf/dataset``.
        downscale: factor of the photos that are to be read.

    Raises:
        InputError: the dataset is unknown, or has no photos downscaled by that factor.
    """
    facts = published_dataset(dataset)
    if facts.layout == "transforms":
        needed = [
            f"{part}{side}{end}" for side in ("train", "test") for part, end in (("transforms_", ".json"), ("", ""))
        ]
        return tuple(path / part for part in needed if not (path / part).exists())
    images = path / facts.photo_folder(downscale)
    model = () if find_model(path) is not None else (path / MODEL_FOLDERS[0],)
    return (*(() if images.is_dir() else (images,)), *model)


def download_command(path: Path, dataset: str, name: str, downscale: int | float = 1) -> str:
    """The command line that fetches a scene, as the end of an error message.

    Args:
        path: the scene's folder.
        dataset: name of a file of ``conf/dataset``.
        name: the scene's name.
        downscale: factor of the photos that are to be read.
    """
    words = [f"gaussian-enhancer download dataset={dataset} scenes=[{name}]"]
    facts = published_dataset(dataset)
    if facts.pyramid:
        words.append(f"images=[{facts.photo_folder(downscale)}]")
    if path.parts[-2:] != (dataset, name):
        return f"fetch it ({' '.join(words)}) and give its folder as scene.path"
    return f"fetch it: {' '.join(words)} folder={path.parent.parent}"
