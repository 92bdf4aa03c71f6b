"""Projection of one camera's pixels into another, and bilinear sampling there.

Each of these has a readable form on tensors, for every device, precision and gradient, and a compiled one for single
precision on a processor, where it saves nine tenths of the time.

Axes: h height, w width of the target; p height, q width of a reference's image; m hypotheses of depth.
Coordinates are in pixels with the first pixel's centre at (0.5, 0.5).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from torch import Tensor

from gaussian_enhancer.types import Camera

IN_FRONT = 1e-6
"""Least z before a reference, as a share of the depth in the target: scenes have no common unit."""


Interpolation = Literal["bilinear", "bicubic"]
"""How an image is read between its pixels."""


@dataclass(frozen=True)
class ReferenceProjection:
    """The affine map from a target pixel's depth to homogeneous pixels of a reference.

    A point at depth z on the ray of pixel x lands at K' (z R' R^T K^-1 x + t'), that is at z (matrix x) + offset.

    Args:
        matrix: from homogeneous pixels of the target; computed in double precision whatever it is kept in.
        offset: of the reference's own camera.
        height: of the reference, in pixels.
        width: of the reference, in pixels.
    """

    matrix: Float[Tensor, "3 3"]
    offset: Float[Tensor, " 3"]
    height: int
    width: int

    @classmethod
    def between(cls, target: Camera, reference: Camera, like: Tensor) -> "ReferenceProjection":
        """The map from one camera's pixels to another's.

        Args:
            target: camera whose pixels are asked for.
            reference: camera that they are looked up in.
            like: a tensor of the device and type of the result; single or double, since half cannot address pixels.
        """
        pose, other = target.world_to_camera.double(), reference.world_to_camera.double()
        rotation = other[:3, :3] @ pose[:3, :3].T
        translation = other[:3, 3] - rotation @ pose[:3, 3]
        K = reference.K.double()
        matrix, offset = K @ rotation @ torch.linalg.inv(target.K.double()), K @ translation
        return cls(matrix.to(like), offset.to(like), reference.height, reference.width)

    def with_stride(self, step: int) -> "ReferenceProjection":
        """The map of every ``step``-th pixel of each row and column, from the first."""
        shift = (1 - step) / 2
        corner = self.matrix[:, 2] + shift * (self.matrix[:, 0] + self.matrix[:, 1])
        matrix = torch.stack([step * self.matrix[:, 0], step * self.matrix[:, 1], corner], dim=1)
        return replace(self, matrix=matrix)

    def slopes(self, height: int, width: int) -> Float[Tensor, "3 {height} {width}"]:
        """``matrix`` x for every pixel of the target."""
        like = {"dtype": self.matrix.dtype, "device": self.matrix.device}
        x, y = torch.arange(width, **like) + 0.5, torch.arange(height, **like)[:, None] + 0.5  # type: ignore[call-overload]
        return self.matrix[:, 0, None, None] * x + self.matrix[:, 1, None, None] * y + self.matrix[:, 2, None, None]


@dataclass(frozen=True)
class Landing:
    """Where pixels land in a reference.

    Args:
        x: columns in pixels of the reference.
        y: rows in pixels of the reference.
        inside: 1 within its image and in front of it, 0 elsewhere.
    """

    x: Float[Tensor, "m h w"]
    y: Float[Tensor, "m h w"]
    inside: Float[Tensor, "m h w"]


def land(projection: ReferenceProjection, depth: Float[Tensor, "m h w"]) -> Landing:
    """Where pixels at a depth, or at several, land.

    Args:
        projection: from the target to the reference.
        depth: z of the target, > 0 and finite.
    """
    if len(depth) != 1 or not can_use_kernels(depth):
        x, y, _, inside = _landing(projection, depth)
        return Landing(x, y, inside.to(depth.dtype))
    from gaussian_enhancer.align.reproject_kernels import land as kernel
    from gaussian_enhancer.splat.compiled import kernel_lock

    x, y, inside = (torch.empty_like(depth, memory_format=torch.contiguous_format) for _ in range(3))
    with kernel_lock:
        kernel(kernel_image(depth[0]), *kernel_projection(projection), x[0].numpy(), y[0].numpy(), inside[0].numpy())
    return Landing(x, y, inside)


def depth_consistency(
    projection: ReferenceProjection, depth: Float[Tensor, "1 h w"], seen: Float[Tensor, "1 _ _"], tolerance: float
) -> Float[Tensor, "1 h w"]:
    """exp(-((z - z') / (tolerance z))^2 / 2), z being a point's depth in the reference and z' what that renders there.

    Args:
        projection: from the target to the reference.
        depth: z of the target, > 0 and finite.
        seen: z that the reference renders, of any size, read at the nearest pixel; where it is 0 the result is 1.
        tolerance: relative depth difference of one standard deviation, > 0.
    """
    if not can_use_kernels(depth, seen):
        x, y, z, _ = _landing(projection, depth)
        rows, columns = seen.shape[-2:]
        sampled_depth = sample_image(seen, x * (columns / projection.width), y * (rows / projection.height), "nearest")[
            :, 0
        ]
        difference = (z - sampled_depth) / (tolerance * z.clamp_min(torch.finfo(z.dtype).tiny))
        return torch.where(sampled_depth > 0, torch.exp(-0.5 * difference**2), 1.0)
    from gaussian_enhancer.align.reproject_kernels import check
    from gaussian_enhancer.splat.compiled import kernel_lock

    result = torch.empty_like(depth, memory_format=torch.contiguous_format)
    with kernel_lock:
        check(
            kernel_image(depth[0]),
            *kernel_projection(projection),
            kernel_image(seen[0]),
            np.float32(tolerance),
            result[0].numpy(),
        )
    return result


def read_both(
    image: Float[Tensor, "3 p q"],
    other: Float[Tensor, "3 _ _"],
    landing: Landing,
    size: tuple[int, int],
    where: Float[Tensor, "1 h w"],
    interpolation: Interpolation = "bilinear",
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "3 h w"]]:
    """`read_at` of two images; where they are of one size, cubic convolution reads them together."""
    together = interpolation == "bicubic" and image.shape == other.shape
    if not (together and can_use_kernels(image, other, landing.x, where)):
        first, second = (read_at(one, landing, size, where, interpolation) for one in (image, other))
        return first, second
    from gaussian_enhancer.align.reproject_kernels import read_cubic_pair
    from gaussian_enhancer.splat.compiled import kernel_lock

    down, across = (np.float32(side / whole) for side, whole in zip(image.shape[-2:], size, strict=True))
    first, second = (image.new_empty(len(image), *where.shape[-2:]) for _ in range(2))
    positions = kernel_image(landing.x[0]), kernel_image(landing.y[0]), across, down, kernel_image(where[0])
    with kernel_lock:
        read_cubic_pair(kernel_image(image), kernel_image(other), *positions, first.numpy(), second.numpy())
    return first, second


def read_at(
    image: Float[Tensor, "c p q"] | UInt8[Tensor, "c p q"],
    landing: Landing,
    size: tuple[int, int],
    where: Float[Tensor, "1 h w"],
    interpolation: Interpolation = "bilinear",
) -> Float[Tensor, "c h w"]:
    """Read an image where pixels land; beyond it the border's colours, and 0 where they do not count.

    Args:
        image: what is read; what is read bilinearly may have 8 bits, whose values stay in [0, 255].
        landing: positions, in pixels of the reference.
        size: height and width of the reference, in those pixels; the image may be of another size.
        where: > 0 where pixels count.
        interpolation: "bilinear", or "bicubic" (cubic convolution, kept within [0, 1]), which blurs less.
    """
    down, across = image.shape[-2] / size[0], image.shape[-1] / size[1]
    eight_bit = image.dtype == torch.uint8
    if eight_bit and interpolation != "bilinear":
        raise ValueError("8-bit images are read bilinearly")
    if not ((eight_bit or can_use_kernels(image)) and can_use_kernels(landing.x, where)):
        values = image.to(landing.x) if eight_bit else image
        samples = sample_image(values, landing.x * across, landing.y * down, interpolation)[0]
        return (samples if interpolation == "bilinear" else samples.clamp(0, 1)) * (where > 0)
    from gaussian_enhancer.align.reproject_kernels import read, read_cubic
    from gaussian_enhancer.splat.compiled import kernel_lock

    result = where.new_empty(len(image), *where.shape[-2:])
    positions = kernel_image(landing.x[0]), kernel_image(landing.y[0]), np.float32(across), np.float32(down)
    with kernel_lock:
        kernel = read if interpolation == "bilinear" else read_cubic
        kernel(kernel_image(image), *positions, kernel_image(where[0]), result.numpy())
    return result


def sample_image(
    image: Float[Tensor, "c p q"], x: Float[Tensor, "m h w"], y: Float[Tensor, "m h w"], mode: str = "bilinear"
) -> Float[Tensor, "m c h w"]:
    """Read an image at pixel positions; outside, the border's colours.

    Args:
        image: what is read.
        x: columns in pixels of the image.
        y: rows in pixels of the image.
        mode: "bilinear", "bicubic" or "nearest".
    """
    count, height, width = x.shape
    rows, columns = image.shape[-2:]
    grid = torch.stack([2 * x / columns - 1, 2 * y / rows - 1], dim=-1).view(1, count * height, width, 2)
    samples = F.grid_sample(image[None].to(grid.dtype), grid, mode=mode, padding_mode="border", align_corners=False)
    return samples.view(-1, count, height, width).transpose(0, 1)


def can_use_kernels(*images: Tensor) -> bool:
    """Whether the compiled kernels can be used: single precision, on the CPU, and no gradient needed."""
    return all(
        image.device.type == "cpu"
        and image.dtype == torch.float32
        and not (image.requires_grad and torch.is_grad_enabled())
        for image in images
    )


def kernel_image(image: Tensor) -> np.ndarray:
    """An image as kernels read it."""
    return image.detach().contiguous().numpy()


def kernel_projection(
    projection: ReferenceProjection,
) -> tuple[np.ndarray, np.ndarray, np.float32, np.float32, np.float32]:
    """A projection as kernels read it: matrix, offset, width and height of the reference, and least z before it."""
    matrix, offset = (value.detach().float().contiguous().numpy() for value in (projection.matrix, projection.offset))
    return matrix, offset, np.float32(projection.width), np.float32(projection.height), np.float32(IN_FRONT)


def _landing(projection: ReferenceProjection, depth: Float[Tensor, "m h w"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Where pixels at a depth land in the reference: columns, rows, z there, and whether inside and in front."""
    slopes, offset = projection.slopes(*depth.shape[-2:]), projection.offset
    z = depth * slopes[2] + offset[2]
    in_front = z > IN_FRONT * depth
    safe = torch.where(in_front, z, torch.ones_like(z))
    x, y = ((depth * slopes[axis] + offset[axis]) / safe for axis in (0, 1))
    inside = (x >= 0) & (x <= projection.width) & (y >= 0) & (y <= projection.height) & in_front
    return x, y, z, inside
