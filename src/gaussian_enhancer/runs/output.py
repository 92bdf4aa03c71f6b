"""Files that the job ``enhance`` writes: images, renders and photos for comparison, and the cost of each image.

Axes: h height, w width.
"""

import shutil
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write, to_write_error
from gaussian_enhancer.infer.enhancer import EnhancedView
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.runs.inputs import Task
from gaussian_enhancer.scene.high_resolution import ReadResized, resized_reader
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_header, resize
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView


def resize_to_photo(image: Float[Tensor, "3 h w"], view: RenderedView, scale: int) -> Float[Tensor, "3 _ _"]:
    """Resize an enhanced image to its high-resolution photo, whose size is ``scale`` times the render's up to rounding.

    Args:
        image: the enhanced image.
        view: the view that was enhanced.
        scale: upscaling factor of the network.
    """
    return image if scale == 1 or view.fine_size is None else resize(image, *view.fine_size)


def write_enhanced(
    views: Iterable[EnhancedView], folder: Path, rendered: RenderedSet, scale: int
) -> list[EnhancedView]:
    """Write each image as soon as it is computed, at the size of its photo; unchanged views are copies of their render.

    Args:
        views: enhanced views.
        folder: where images are written, under the renders' names.
        rendered: the set that was enhanced.
        scale: upscaling factor of the network.

    Returns:
        The views with empty images, to free their memory.

    Raises:
        InputError: an image cannot be written.
    """
    targets = {view.name: view for view in rendered.targets}
    written_views = []
    for enhanced in views:
        write_enhanced_view(enhanced, folder, targets[enhanced.name], scale)
        written_views.append(replace(enhanced, image=enhanced.image[:, :0, :0]))
    return written_views


def write_enhanced_view(enhanced: EnhancedView, folder: Path, view: RenderedView, scale: int) -> None:
    """Write an enhanced image, or copy the file of its render if enhancement changed nothing.

    Args:
        enhanced: the enhanced view.
        folder: folder of the images; the file has the render's name.
        view: the view that was enhanced.
        scale: upscaling factor of the network.

    Raises:
        InputError: the image cannot be written.
    """
    if enhanced.unchanged and view.read is not None:
        if not _copy_if_unmodified(view.read, folder / enhanced.name):
            write_image(folder / enhanced.name, view.read())
    else:
        write_image(folder / enhanced.name, resize_to_photo(enhanced.image, view, scale))


def write_sources(rendered: RenderedSet, folder: Path, scale: int) -> list[Path]:
    """Write renders and photos at the size of the enhanced images into the folders ``renders`` and ``gt``.

    Args:
        rendered: the targets; photos are written for targets that have one.
        folder: parent of the two folders, which also holds the folder of the enhanced images.
        scale: upscaling factor of the network; above 1, renders are enlarged bicubically.

    Returns:
        The files.

    Raises:
        InputError: a file cannot be read or written.
    """
    files = []
    for view in rendered.targets:
        read_photo = view.read_photo if scale == 1 else view.read_fine_photo
        for subfolder, read in (("renders", view.read), ("gt", read_photo)):
            if read is None:
                continue
            path = folder / subfolder / view.name
            if scale == 1 and _copy_if_unmodified(read, path):
                files.append(path)
                continue
            # A photo as a JPEG would lose what images are compared with; renders have the format of enhanced images.
            files.append(path.with_suffix(".png") if subfolder == "gt" else path)
            if scale == 1:
                write_image(files[-1], read())
            elif subfolder == "gt":
                write_image(files[-1], read_original_size(view))
            else:
                write_image(files[-1], resize_to_photo(upsample_bicubic(read()[None], scale)[0], view, scale))
    return files


def remove_other_files(folder: Path, kept: Collection[Path]) -> None:
    """Remove images that an earlier call of the same job wrote, of views or photos that its input no longer holds.

    Args:
        folder: parent of the folders ``renders``, ``enhanced`` and ``gt``.
        kept: the files that stay.

    Raises:
        InputError: a file cannot be removed.
    """
    for path in set(folder.glob("*/*")) - set(kept):
        try:
            path.unlink()
        except OSError as error:
            raise to_write_error(path, error) from error


def read_original_size(view: RenderedView) -> Float[Tensor, "3 _ _"]:
    """Read a view's high-resolution photo at its original size.

    Raises:
        InputError: the view has no such photo, or it cannot be read.
    """
    if view.read_fine_photo is None:
        raise InputError(
            view.name, "has no high-resolution photo", "give a scene with photos of 4 times the render's resolution"
        )
    if view.fine_size is None:
        return view.read_fine_photo()
    if isinstance(view.read_fine_photo, ReadResized):
        return view.read_fine_photo.read()
    return resized_reader(view.read_fine_photo, *view.fine_size)()


def cost_records(views: Iterable[EnhancedView], run_name: str, task: Task) -> list[Record]:
    """Records of the milliseconds that the network took for each image.

    Args:
        views: enhanced views.
        run_name: name of the run's folder.
        task: the task of the run.
    """
    label = run_name, task.rendered.name, f"ours_{task.step}"
    return [Record("cost", *label, view.name, "enhanced", {"milliseconds": view.enhancing}) for view in views]


def _copy_if_unmodified(read: Callable[[], Tensor], path: Path) -> bool:
    """Copy the image's file if it stores the same pixels in the path's format; otherwise, return False."""
    if not isinstance(read, ReadPhoto) or read.lens is not None or read.path.suffix != path.suffix:
        return False
    header = read_header(read.path)
    if header.has_alpha or (header.height, header.width) != (read.height, read.width):
        return False  # reading blends it with a background, or resizes it
    with atomic_write(path) as temporary:
        shutil.copyfile(read.path, temporary)
    return True
