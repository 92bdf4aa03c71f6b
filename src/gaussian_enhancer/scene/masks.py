"""Object masks on disk, for PSNR within the object.

In photos of an object on white most pixels are background. An image that reproduces only the white gains decibels.
"""

from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.scene import Scene


def write_masks(scene: Scene, folder: str | Path) -> tuple[Path, ...]:
    """Write the coverage of each held-out photo as an 8-bit grey PNG with the photo's name.

    Args:
        scene: a scene whose photos have an alpha channel, such as NeRF-Synthetic's or a procedural object.
        folder: output folder; pass it as ``masks`` to the job ``measure``.

    Returns:
        The paths written, in the order of the held-out photos.

    Raises:
        InputError: a held-out photo has no alpha channel, or a file cannot be written.
    """
    files = []
    for photo in scene.test_photos:
        if photo.read_alpha is None:
            raise InputError(f"photo {photo.name} of {scene.name}", "has no alpha channel", "measure it without masks")
        path = Path(folder) / f"{Path(photo.name).stem}.png"
        write_image(path, photo.read_alpha())
        files.append(path)
    return tuple(files)
