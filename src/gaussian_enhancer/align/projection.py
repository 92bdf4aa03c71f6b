"""Projection of one camera's pixels into another camera, and sampling of images at the projected positions.

Each operation has a readable version on tensors, for any device and precision and with gradients, and a compiled
version for single precision on the CPU, which saves 90% of the time.

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

from gaussian_enhancer.types import Camera, numpy_view

MIN_RELATIVE_Z = 1e-6
"""Least z in a reference's camera, relative to the depth in the target, since scenes have no common unit."""


Interpolation = Literal["bilinear", "bicubic"]
"""Interpolation of an image between its pixels."""


@dataclass(frozen=True)
class ReferenceProjection:
    """The affine map from a target pixel's depth to homogeneous pixels of a reference.

    A pixel x of the target at depth z projects to K' (z R' R^T K^-1 x + t'), which is z (matrix x) + offset.

    Args:
        matrix: applied to homogeneous pixels of the target; always computed in double precision.
        offset: K' t', the part that does not depend on the pixel.
        height: height of the reference in pixels.
        width: width of the reference in pixels.
    """

    matrix: Float[Tensor, "3 3"]
    offset: Float[Tensor, " 3"]
    height: int
    width: int

    @classmethod
    def between(cls, target: Camera, reference: Camera, like: Tensor) -> "ReferenceProjection":
        """Build the map from the pixels of one camera to those of another.

        Args:
            target: camera whose pixels are projected.
            reference: camera into which they are projected.
            like: a tensor with the device and type of the result; single or double precision, since half precision
                cannot represent pixel coordinates.
        """
        target_pose, reference_pose = target.world_to_camera.double(), reference.world_to_camera.double()
        rotation = reference_pose[:3, :3] @ target_pose[:3, :3].T
        translation = reference_pose[:3, 3] - rotation @ target_pose[:3, 3]
        K = reference.K.double()
        matrix, offset = K @ rotation @ torch.linalg.inv(target.K.double()), K @ translation
        return cls(matrix.to(like), offset.to(like), reference.height, reference.width)

    def with_stride(self, step: int) -> "ReferenceProjection":
        """The map for every ``step``-th pixel of each row and column, starting with the first."""
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
class ProjectedPixels:
    """Positions of projected pixels in a reference.

    Args:
        x: columns in pixels of the reference.
        y: rows in pixels of the reference.
        inside: 1 inside the image and in front of the camera, 0 elsewhere.
    """

    x: Float[Tensor, "m h w"]
    y: Float[Tensor, "m h w"]
    inside: Float[Tensor, "m h w"]


def project_pixels(projection: ReferenceProjection, depth: Float[Tensor, "m h w"]) -> ProjectedPixels:
    """Project pixels at one depth, or at several depths.

    Args:
        projection: projection from the target to the reference.
        depth: z of the target, positive and finite.
    """
    if len(depth) != 1 or not can_use_kernels(depth):
        x, y, _, inside = _project_pixels(projection, depth)
        return ProjectedPixels(x, y, inside.to(depth.dtype))
    from gaussian_enhancer.align.reproject_kernels import project_pixels as kernel
    from gaussian_enhancer.compiled import kernel_lock

    x, y, inside = (torch.empty_like(depth, memory_format=torch.contiguous_format) for _ in range(3))
    with kernel_lock:
        kernel(numpy_view(depth[0]), *kernel_projection(projection), x[0].numpy(), y[0].numpy(), inside[0].numpy())
    return ProjectedPixels(x, y, inside)


def depth_consistency(
    projection: ReferenceProjection,
    depth: Float[Tensor, "1 h w"],
    reference_depth: Float[Tensor, "1 _ _"],
    tolerance: float,
) -> Float[Tensor, "1 h w"]:
    """exp(-((z - z') / (tolerance z))^2 / 2) for a point's depth z in the reference and the rendered depth z' there.

    Args:
        projection: projection from the target to the reference.
        depth: z of the target, positive and finite.
        reference_depth: rendered z of the reference, of any size, sampled at the nearest pixel; where it is 0, the
            result is 1.
        tolerance: relative depth difference of one standard deviation, > 0.
    """
    if not can_use_kernels(depth, reference_depth):
        x, y, z, _ = _project_pixels(projection, depth)
        rows, columns = reference_depth.shape[-2:]
        x, y = x * (columns / projection.width), y * (rows / projection.height)
        sampled_depth = sample_image(reference_depth, x, y, "nearest")[:, 0]
        difference = (z - sampled_depth) / (tolerance * z.clamp_min(torch.finfo(z.dtype).tiny))
        return torch.where(sampled_depth > 0, torch.exp(-0.5 * difference**2), 1.0)
    from gaussian_enhancer.align.reproject_kernels import depth_agreement
    from gaussian_enhancer.compiled import kernel_lock

    result = torch.empty_like(depth, memory_format=torch.contiguous_format)
    with kernel_lock:
        depth_agreement(
            numpy_view(depth[0]),
            *kernel_projection(projection),
            numpy_view(reference_depth[0]),
            np.float32(tolerance),
            result[0].numpy(),
        )
    return result


def sample_projected_pair(
    first: Float[Tensor, "3 p q"],
    second: Float[Tensor, "3 _ _"],
    projected: ProjectedPixels,
    size: tuple[int, int],
    where: Float[Tensor, "1 h w"],
    interpolation: Interpolation = "bilinear",
) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "3 h w"]]:
    """Apply `sample_projected` to two images; images of the same size are sampled together by bicubic interpolation."""
    interleaved = interpolation == "bicubic" and first.shape == second.shape
    if not (interleaved and can_use_kernels(first, second, projected.x, where)):
        options = projected, size, where, interpolation
        return sample_projected(first, *options), sample_projected(second, *options)
    from gaussian_enhancer.align.reproject_kernels import sample_bicubic_pair
    from gaussian_enhancer.compiled import kernel_lock

    down, across = np.float32(first.shape[-2] / size[0]), np.float32(first.shape[-1] / size[1])
    samples = first.new_empty(2, len(first), *where.shape[-2:])
    positions = numpy_view(projected.x[0]), numpy_view(projected.y[0]), across, down, numpy_view(where[0])
    with kernel_lock:
        sample_bicubic_pair(numpy_view(first), numpy_view(second), *positions, samples[0].numpy(), samples[1].numpy())
    return samples[0], samples[1]


def sample_projected(
    image: Float[Tensor, "c p q"] | UInt8[Tensor, "c p q"],
    projected: ProjectedPixels,
    size: tuple[int, int],
    where: Float[Tensor, "1 h w"],
    interpolation: Interpolation = "bilinear",
) -> Float[Tensor, "c h w"]:
    """Sample an image at projected pixels: border colours outside the image, 0 where ``where`` is not positive.

    Args:
        image: the image; for bilinear interpolation it may be 8-bit, and values stay in [0, 255].
        projected: positions in pixels of the reference.
        size: height and width of the reference in those pixels; the image may have another size.
        where: positive at pixels that are sampled.
        interpolation: "bilinear", or "bicubic" (cubic convolution, clamped to [0, 1]), which blurs less.
    """
    down, across = image.shape[-2] / size[0], image.shape[-1] / size[1]
    eight_bit = image.dtype == torch.uint8
    if eight_bit and interpolation != "bilinear":
        raise ValueError("8-bit images are read bilinearly")
    if not ((eight_bit or can_use_kernels(image)) and can_use_kernels(projected.x, where)):
        values = image.to(projected.x) if eight_bit else image
        samples = sample_image(values, projected.x * across, projected.y * down, interpolation)[0]
        return (samples if interpolation == "bilinear" else samples.clamp(0, 1)) * (where > 0)
    from gaussian_enhancer.align.reproject_kernels import sample_bicubic, sample_bilinear
    from gaussian_enhancer.compiled import kernel_lock

    result = where.new_empty(len(image), *where.shape[-2:])
    positions = numpy_view(projected.x[0]), numpy_view(projected.y[0]), np.float32(across), np.float32(down)
    with kernel_lock:
        kernel = sample_bilinear if interpolation == "bilinear" else sample_bicubic
        kernel(numpy_view(image), *positions, numpy_view(where[0]), result.numpy())
    return result


def sample_image(
    image: Float[Tensor, "c p q"], x: Float[Tensor, "m h w"], y: Float[Tensor, "m h w"], mode: str = "bilinear"
) -> Float[Tensor, "m c h w"]:
    """Sample an image at pixel positions, with the border's colours outside the image.

    Args:
        image: the image.
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
    """Whether the compiled kernels can be used: single precision, on the CPU, no gradient required, and no tracing."""
    if torch.compiler.is_compiling() or torch.jit.is_tracing():
        return False
    return all(
        image.device.type == "cpu"
        and image.dtype == torch.float32
        and not (image.requires_grad and torch.is_grad_enabled())
        for image in images
    )


def kernel_projection(
    projection: ReferenceProjection,
) -> tuple[np.ndarray, np.ndarray, np.float32, np.float32, np.float32]:
    """Arguments of the kernels: matrix, offset, width and height of the reference, and least z relative to depth."""
    matrix, offset = (numpy_view(value.float()) for value in (projection.matrix, projection.offset))
    return matrix, offset, np.float32(projection.width), np.float32(projection.height), np.float32(MIN_RELATIVE_Z)


def _project_pixels(
    projection: ReferenceProjection, depth: Float[Tensor, "m h w"]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Project pixels at a depth: columns, rows and z in the reference, and whether inside and in front."""
    slopes, offset = projection.slopes(*depth.shape[-2:]), projection.offset
    z = depth * slopes[2] + offset[2]
    in_front = z > MIN_RELATIVE_Z * depth
    divisor = torch.where(in_front, z, torch.ones_like(z))
    x, y = ((depth * slopes[axis] + offset[axis]) / divisor for axis in (0, 1))
    inside = (x >= 0) & (x <= projection.width) & (y >= 0) & (y <= projection.height) & in_front
    return x, y, z, inside
