"""Attempts to make an enhancement faster: code before and after each change, failed attempts included.

Only this module keeps the code before. Both versions of a trial give the same image, up to rounding.
"""

import io
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from ablations.benchmarks.networks import example
from gaussian_enhancer.align.projection import ProjectedPixels, sample_projected, sample_projected_pair
from gaussian_enhancer.infer.change_confidence import (
    BLOCK,
    apply_shares_compiled,
    apply_shares_torch,
    block_products,
    products_compiled,
)
from gaussian_enhancer.infer.colour_completion import complete_compiled, complete_torch
from gaussian_enhancer.network.colour_clamping import clamp_compiled, clamp_torch
from gaussian_enhancer.network.halving import halve, pixel_unshuffle
from gaussian_enhancer.network.output_head import OUTPUTS, compose
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.ssif_sr import merge_torch
from gaussian_enhancer.scene.photos import normalise
from gaussian_enhancer.scene.png import encode_png
from gaussian_enhancer.types import NetworkInput

REFERENCES = 3


@dataclass(frozen=True)
class Trial:
    """A change that was tried.

    Args:
        change: description.
        expected: the expected effect, and its reason.
        before: the code before the change.
        after: the code after the change.
        kept: whether it was kept.
    """

    change: str
    expected: str
    before: Callable[[], object]
    after: Callable[[], object]
    kept: bool = True


def trials(height: int, width: int, photo: Float[Tensor, "3 _ _"]) -> Iterator[Trial]:
    """Everything that was tried.

    Args:
        height: of the views, even.
        width: of the views, even.
        photo: the image that is written as PNG.
    """
    views = example(height, width, REFERENCES)
    planes = torch.cat([views.references[0], views.visibility[0]], 1).repeat(1, 2, 1, 1).bfloat16()
    unshuffle = "pixel-unshuffle into channels-last memory"
    yield Trial(
        f"{unshuffle}, two pixels as one word",
        "a third of the time: one pass instead of two, half as many elements",
        lambda: unshuffled_before(planes),
        lambda: pixel_unshuffle(planes),
    )
    yield Trial(
        f"{unshuffle}, pixel by pixel",
        "half of the time: one pass instead of two",
        lambda: unshuffled_before(planes),
        lambda: unshuffled_pixel_by_pixel(planes),
        kept=False,
    )
    yield Trial(
        "means over 2x2 pixels, rows first",
        "a third of the time: rows are added by vector instructions",
        lambda: F.avg_pool2d(views.references[0], 2),
        lambda: halve(views.references[0]),
    )
    decoded, trust = torch.rand(1, OUTPUTS, height, width), torch.rand(1, REFERENCES, 1, height // 2, width // 2)
    yield Trial(
        "photos summed before the decoded gates weigh them",
        "two thirds of the time: 13 passes over images instead of 21",
        lambda: composed_before(decoded, views, trust),
        lambda: compose(decoded, views, trust),
    )
    yield from _compiled(views)
    pixels = np.ascontiguousarray((photo * 255).round().byte().permute(1, 2, 0).numpy())
    picture = Image.fromarray(pixels)
    yield Trial(
        "PNG compressed by run lengths alone",
        "a fifth of the time, somewhat larger files: no search for matches",
        lambda: picture.save(io.BytesIO(), "PNG"),
        lambda: picture.save(io.BytesIO(), "PNG", compress_type=zlib.Z_RLE),
    )
    yield Trial(
        "PNG filtered by a compiled kernel and compressed in strips",
        "half of the time: one filter instead of five, both cores",
        lambda: picture.save(io.BytesIO(), "PNG", compress_type=zlib.Z_RLE),
        lambda: encode_png(pixels),
    )


def fused(call: Callable[[], object]) -> object:
    """Wrap a call in bfloat16 inference, in which compiled kernels are used."""
    with torch.autocast("cpu", torch.bfloat16):
        return call()


def _compiled(views: NetworkInput) -> Iterator[Trial]:
    """Trials of compiled kernels against their twins on tensors."""
    height, width = views.render.shape[-2:]
    image = torch.rand(1, 3, height, width)
    opaque, visibility = torch.ones(1, 1, height, width), torch.ones(1, height, width)
    yield Trial(
        "colours clamped by a compiled kernel, a row at a time",
        "a third of the time: a window's limits stay in the cache instead of six passes a channel",
        lambda: clamp_torch(image, views, 1),
        lambda: clamp_compiled(image, views, 1),
    )
    cells = torch.rand(1, 13, 75, 100)
    yield Trial(
        "colours completed by a compiled kernel",
        "half of the time: the model's twelve planes are never written at full size",
        lambda: complete_torch(image, views.render, opaque, cells),
        lambda: complete_compiled(image, views.render, opaque, cells),
    )
    yield Trial(
        "products of a block for the confidence by a compiled kernel",
        "half of the time: blocks are gathered once, and pairs multiplied once",
        lambda: block_products(image, views),
        lambda: products_compiled(image, views),
    )
    shares = torch.rand(1, 2, -(-height // BLOCK), -(-width // BLOCK))
    yield Trial(
        "shares of the change applied by a compiled kernel",
        "a third of the time: shares and means are never written at full size",
        lambda: apply_shares_torch(image, views.render, shares),
        lambda: apply_shares_compiled(image, views.render, shares),
    )
    photos, smaller = views.references, halve(views.references)
    half_seen, trust = halve(views.visibility), torch.rand(1, REFERENCES, 1, height // 2, width // 2)

    def merge() -> tuple[Tensor | None, ...]:
        together, trusted = merge_torch(image, photos, smaller, half_seen, trust)
        return together.references, together.reference_renders, together.visibility, trusted

    yield Trial(
        "references of super-resolution merged by a compiled kernel",
        "a quarter of the time: weights and sums of a row stay in the cache",
        merge,
        lambda: fused(merge),
    )
    yield Trial(
        "images enlarged by 4 by a compiled kernel, axis by axis",
        "a third of the time: 8 products a pixel instead of 16, by vector instructions",
        lambda: F.interpolate(image, scale_factor=4, mode="bicubic"),
        lambda: upsample_bicubic(image, 4),
    )
    rows, columns = torch.meshgrid(torch.arange(height) + 0.8, torch.arange(width) + 0.7, indexing="ij")
    landing = ProjectedPixels(columns[None], rows[None], torch.ones(1, height, width))
    photo, render = views.references[0, 0], views.references[0, 1]

    def read(image: Tensor) -> Tensor:
        return sample_projected(image, landing, (height, width), visibility, "bicubic")

    yield Trial(
        "photo and render of a reference read together",
        "two thirds of the time: places and weights are computed once",
        lambda: (read(photo), read(render)),
        lambda: sample_projected_pair(photo, render, landing, (height, width), visibility, "bicubic"),
    )
    pixels = (photo.clamp(0, 1) * 255).byte().permute(1, 2, 0).contiguous().numpy()
    yield Trial(
        "8-bit photos divided by 255 channel by channel",
        "two thirds of the time: one image of floats is written instead of three",
        lambda: normalised_before(pixels),
        lambda: normalise(pixels, 255),
    )


def unshuffled_before(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 4*c i j"]:
    """Torch's pixel-unshuffle, then the conversion to channels-last memory that the convolution makes."""
    return F.pixel_unshuffle(image, 2).contiguous(memory_format=torch.channels_last)


def unshuffled_pixel_by_pixel(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 4*c i j"]:
    """The same as one permuted copy."""
    batch, channels, height, width = image.shape
    squares = image.view(batch, channels, height // 2, 2, width // 2, 2).permute(0, 2, 4, 1, 3, 5)
    return squares.reshape(batch, height // 2, width // 2, 4 * channels).permute(0, 3, 1, 2)


def normalised_before(pixels: UInt8[np.ndarray, "h w 3"]) -> Float[Tensor, "3 h w"]:
    """Conversion to floats, division and transposition, one after the other."""
    values = pixels.astype(np.float32) / np.float32(255)
    return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1)))


def composed_before(
    decoded: Float[Tensor, "b 6 h w"], views: NetworkInput, trust: Float[Tensor, "b r 1 i j"]
) -> Float[Tensor, "b 3 h w"]:
    """`compose` with the gates applied to each photo."""
    enhanced = views.render + torch.sigmoid(decoded[:, 3:4]) * decoded[:, :3]
    weight = F.interpolate(trust.flatten(0, 1), scale_factor=2, mode="bilinear")
    weight = weight.unflatten(0, views.visibility.shape[:2]) * (views.visibility > 0)
    for i in range(views.visibility.shape[1]):
        photo = views.references[:, i]
        weighted_change = decoded[:, 4:5] * (photo - views.render)
        if views.reference_renders is not None:
            weighted_change = weighted_change + decoded[:, 5:6] * (photo - views.reference_renders[:, i])
        enhanced = enhanced + weight[:, i] * weighted_change
    return enhanced
