"""Conversion of the user's images, numpy or torch, to tensors and back.

Axes: b batch, h height, w width.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import background_colour

Array = np.ndarray | Tensor
BRIGHTEST = 8.0
"""Largest permitted value of a float image. Renders may slightly exceed 1; images not divided by 255 exceed this."""


@dataclass(frozen=True)
class ImageKind:
    """Library, type, device and axes of an input image, which the result shall have as well.

    Args:
        like: an empty array with the library, type and device of the input.
        batch: whether the input has a batch axis.
    """

    like: Array
    batch: bool

    def restore_kind(self, images: Float[Tensor, "b 3 h w"]) -> Array:
        """Convert images in [0, 1] to the form of the given image.

        Args:
            images: images on the CPU.
        """
        integer = _is_uint8(self.like)
        values = (images * 255).round().to(torch.uint8) if integer else images
        values = values if self.batch else values[0]
        if isinstance(self.like, Tensor):
            return values.to(self.like.device, self.like.dtype)
        axes = (0, 2, 3, 1) if self.batch else (1, 2, 0)
        return np.ascontiguousarray(values.permute(axes).numpy().astype(self.like.dtype, copy=False))


def read_background(background: Sequence[int | float] | Array) -> tuple[float, float, float]:
    """Convert a colour, as a sequence or an array, to a tuple.

    Raises:
        InputError: it does not consist of three numbers from 0 to 1.
    """
    values = background.tolist() if isinstance(background, np.ndarray | Tensor) else background
    if not isinstance(values, Sequence) or isinstance(values, str):
        return background_colour(values)
    return background_colour([value.item() if isinstance(value, np.generic | Tensor) else value for value in values])


def read_images(name: str, image: Any) -> tuple[Float[Tensor, "b 3 h w"], ImageKind]:
    """Convert one image or a batch to float32 in [0, 1] on the CPU.

    Args:
        name: name of the image, for messages.
        image: numpy (h, w, 3) or (b, h, w, 3), torch (3, h, w) or (b, 3, h, w); float in [0, 1] or uint8. Floats
            outside of [0, 1] are clamped.

    Raises:
        InputError: it is not such an array, is empty, or holds values that are not finite or exceed `BRIGHTEST`.
    """
    _check_type(name, image)
    channels = -3 if isinstance(image, Tensor) else -1
    if image.ndim not in (3, 4) or image.shape[channels] != 3 or 0 in image.shape:
        shapes = "(3, h, w) or (b, 3, h, w)" if isinstance(image, Tensor) else "(h, w, 3) or (b, h, w, 3)"
        library = "torch" if isinstance(image, Tensor) else "numpy"
        raise InputError(name, f"has shape {tuple(image.shape)}", f"give {library} images of shape {shapes}")
    if not (_is_uint8(image) or _is_float(image)):
        raise InputError(name, f"is of type {image.dtype}", "give float in [0, 1], or uint8")
    batch = image.ndim == 4
    values = _tensor(image)
    if channels == -1:
        values = values.movedim(-1, -3)
    values = values.float() / 255 if _is_uint8(image) else _in_range(name, values.float())
    return (values if batch else values[None]).contiguous(), ImageKind(image[..., :0], batch)


def read_planes(name: str, planes: Any, batch: bool) -> Float[Tensor, "b 1 h w"]:
    """Convert one map of depth or opacity, or a batch, to float32 on the CPU. Values that are not finite become 0.

    Args:
        name: name of the map, for messages.
        planes: (h, w), numpy (h, w, 1) or torch (1, h, w), float; with a leading batch axis where ``batch`` is true.
        batch: whether there is a batch axis.

    Raises:
        InputError: it is not such an array, or holds negative values.
    """
    _check_type(name, planes)
    if not _is_float(planes):
        raise InputError(
            name, f"is of type {planes.dtype}", "give float values: depth in scene units, opacity in [0, 1]"
        )
    is_torch, batch_axis = isinstance(planes, Tensor), "b, " if batch else ""
    values = _tensor(planes).float()
    if values.ndim == 3 + batch and values.shape[-3 if is_torch else -1] == 1:
        values = values.squeeze(-3 if is_torch else -1)
    if values.ndim != 2 + batch or 0 in values.shape:
        full_shape = f"({batch_axis}1, h, w)" if is_torch else f"({batch_axis}h, w, 1)"
        raise InputError(name, f"has shape {tuple(planes.shape)}", f"give shape ({batch_axis}h, w) or {full_shape}")
    values = torch.where(torch.isfinite(values), values, torch.zeros_like(values))
    if float(values.min()) < 0:
        raise InputError(name, f"has values down to {float(values.min()):g}", "give values of 0 or more")
    return (values if batch else values[None])[:, None]


def check_same_size(name: str, image: Tensor, other_name: str, other: Tensor) -> None:
    """Refuse two maps of one view that differ in size or number.

    Raises:
        InputError: size or number differ.
    """
    size, other_size = (tuple(tensor.shape[i] for i in (0, -2, -1)) for tensor in (image, other))
    if size != other_size:
        (count, height, width), (other_count, rows, columns) = size, other_size
        received = f"is {count} of {width}x{height} for {other_name} of {other_count} of {columns}x{rows}"
        raise InputError(name, received, "give one of the same height and width for each image")


def _check_type(name: str, value: Any) -> None:
    if not isinstance(value, np.ndarray | Tensor):
        raise InputError(name, f"is of type {type(value).__name__}", "give a numpy array or a torch tensor")


def _is_uint8(image: Array) -> bool:
    return image.dtype in (torch.uint8, np.dtype(np.uint8))


def _is_float(image: Array) -> bool:
    if isinstance(image, Tensor):
        return image.is_floating_point()
    return bool(np.issubdtype(image.dtype, np.floating))


def _tensor(image: Array) -> Tensor:
    """Convert an array to a tensor on the CPU that is detached from the autograd graph."""
    if isinstance(image, Tensor):
        return image.detach().cpu()
    native = image.astype(image.dtype.newbyteorder("="), copy=not image.flags.writeable)
    return torch.from_numpy(np.ascontiguousarray(native))


def _in_range(name: str, values: Tensor) -> Tensor:
    """Clamp colours to [0, 1]; refuse values that are not finite or exceed `BRIGHTEST`."""
    lowest, highest = (float(value) for value in values.aminmax())
    if not (np.isfinite(lowest) and np.isfinite(highest)):
        raise InputError(name, "has values that are not finite", "render it again, or replace them")
    if highest > BRIGHTEST:
        raise InputError(name, f"has values up to {highest:g}", "give float images in [0, 1], or uint8")
    return values.clamp(0, 1)


def one_per_image(name: str, values: Any, count: int, batch: bool) -> Sequence[Any]:
    """Return one value for each image.

    Args:
        name: name of the values, for messages.
        values: a sequence for a batch, a single value otherwise; None if there are no values.
        count: number of images.
        batch: whether there is a batch axis.

    Raises:
        InputError: a batch has no sequence of the same length.
    """
    if values is None:
        return [None] * count
    if not batch:
        return [values]
    if isinstance(values, str) or not isinstance(values, Sequence) or len(values) != count:
        received = f"has {len(values)} entries" if isinstance(values, list | tuple) else "is no list"
        raise InputError(name, f"{received} for a batch of {count}", "give a list with one for each image")
    return values
