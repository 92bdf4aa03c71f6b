"""What the job ``enhance`` leaves on disk: images, the renders and photos beside them, and the cost of each image.

Axes: h height, w width.
"""

import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.infer.enhancer import Enhanced
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.runs.inputs import Task
from gaussian_enhancer.scene.high_resolution import ReadResized, resized_reader
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_header, resize
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView


def resize_to_photo(image: Float[Tensor, "3 h w"], view: RenderedView, scale: int) -> Float[Tensor, "3 _ _"]:
    """An enhanced image at the size of its finer photo, which differs from ``scale`` times the render's by rounding.

    Args:
        image: the enhanced image.
        view: what was enhanced.
        scale: how many times finer the image is than the render.
    """
    return image if scale == 1 or view.fine_size is None else resize(image, *view.fine_size)


def write_enhanced(views: Iterable[Enhanced], folder: Path, rendered: RenderedSet, scale: int) -> list[Enhanced]:
    """Write each image as soon as it is made, at the size of its photo. What is unchanged is the render's own file.

    Args:
        views: enhanced views.
        folder: where images are written, under the renders' names.
        rendered: what was enhanced.
        scale: how many times finer the images are than the renders.

    Returns:
        The views without their pixels.

    Raises:
        InputError: an image cannot be written.
    """
    targets = {view.name: view for view in rendered.targets}
    written = []
    for one in views:
        write_one(one, folder, targets[one.name], scale)
        written.append(replace(one, image=one.image[:, :0, :0]))
    return written


def write_one(one: Enhanced, folder: Path, view: RenderedView, scale: int) -> None:
    """Write an enhanced image, or copy the file of its render where nothing was changed.

    Args:
        one: the enhanced view.
        folder: where it is written, under the render's name.
        view: what was enhanced.
        scale: how many times finer the image is than the render.

    Raises:
        InputError: the image cannot be written.
    """
    if one.unchanged and view.read is not None:
        _copy_or_write(view.read, folder / one.name)
    else:
        write_image(folder / one.name, resize_to_photo(one.image, view, scale))


def keep_sources(rendered: RenderedSet, side: Path, scale: int) -> None:
    """Write renders and photos of the enhanced images' size into the folders ``renders`` and ``gt``.

    Args:
        rendered: the targets; their photos are written where they are known.
        side: folder that also holds the enhanced images.
        scale: how many times finer the enhanced images are than the renders. Above 1, renders are enlarged bicubically.

    Raises:
        InputError: a file cannot be read or written.
    """
    for view in rendered.targets:
        if scale == 1:
            for part, read_image in (("renders", view.read), ("gt", view.read_photo)):
                if read_image is not None:
                    _copy_or_write(read_image, side / part / view.name)
            continue
        if view.read is not None:
            enlarged = upsample_bicubic(view.read()[None], scale)[0]
            write_image(side / "renders" / view.name, resize_to_photo(enlarged, view, scale))
        if view.read_fine_photo is not None:
            write_image(side / "gt" / view.name, read_own_size(view))


def read_own_size(view: RenderedView) -> Float[Tensor, "3 _ _"]:
    """A view's finer photo at its own size.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    if view.read_fine_photo is None:
        raise InputError(view.name, "has no finer photo", "give a scene with finer photos")
    if view.fine_size is None:
        return view.read_fine_photo()
    if isinstance(view.read_fine_photo, ReadResized):
        return view.read_fine_photo.read()
    return resized_reader(view.read_fine_photo, *view.fine_size)()


def cost_records(written: Iterable[Enhanced], run_name: str, task: Task) -> list[Record]:
    """The milliseconds that each image took in the network.

    Args:
        written: enhanced views.
        run_name: name of the run's folder.
        task: what was enhanced.
    """

    def record(one: Enhanced) -> Record:
        values: dict[str, float | None] = {"milliseconds": one.enhancing}
        return Record("cost", run_name, task.rendered.name, f"ours_{task.step}", one.name, "enhanced", values)

    return [record(one) for one in written]


def _copy_or_write(read: object, path: Path) -> None:
    """Copy the file of an image where it has one that holds it as it is; write the image elsewhere."""
    if isinstance(read, ReadPhoto) and _as_stored(read) and read.path.suffix == path.suffix:
        with whole_file(path) as temporary:
            shutil.copyfile(read.path, temporary)
    else:
        write_image(path, read())  # type: ignore[operator]


def _as_stored(read: ReadPhoto) -> bool:
    """Whether what is read is what the file holds."""
    header = read_header(read.path)
    return read.lens is None and not header.has_alpha and (header.height, header.width) == (read.height, read.width)
