"""SSIF-SR, the paper's super spatial information fusion to 4 times the render's resolution.

Axes: b batch, r references, c channels, h height, w width, H = 4 h, W = 4 w; i and j are half of a scale's sides, p and
q a quarter.
"""

import math
from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.bfloat16 import can_fuse, empty_features, kernel_lock, kernel_words, plane
from gaussian_enhancer.network.block import Block
from gaussian_enhancer.network.decode import Decoder, pixel_shuffle, upsample_with_skip
from gaussian_enhancer.network.deform import Unrefined
from gaussian_enhancer.network.depth_modulation import DepthModulated
from gaussian_enhancer.network.encode import computing_dtype, limit_colours
from gaussian_enhancer.network.fuse import Trust, weighted_sum
from gaussian_enhancer.network.halving import halve, pixel_unshuffle
from gaussian_enhancer.network.initialisation import zero_initialise
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.network.output_head import Gated, Output
from gaussian_enhancer.network.pyramid import pad_to_stride, upsample_bicubic
from gaussian_enhancer.network.stem import Choice, Gather
from gaussian_enhancer.types import NetworkInput, Region

UPSCALE = (2, 4)
TILE = 384
"""Largest side in render pixels of the tiles, apart from their halo, in which the finer scales of large images are
computed without gradients."""
MARGIN = 14
"""Margin of a tile in render pixels that the finer scales require, apart from that of their residual blocks."""


class SSIFSR(CachesReferences):
    """GaussianEnhancer++'s SSIF-SR (algorithm 2): the result at 1x is refined by fine references at 2x and 4x.

    S1 = output(T1), with T1 and features from decode(gather(views)), all at the render's resolution. S2 = output(T2)
    over base2 = up2(S1), with T2 from the upsampled features and the references' features at 2x. S4 = output(T4) over
    base4 = up4(S1) + up2(S2 - up2(S1)), with T4 from T2's upsampled features and the references at 4x, merged by T2's
    trust. up is bicubic. The exposure-tolerant term of `compose` passes on the detail that the references lose at half
    size. Untrained, every scale returns its upsampled render. Differences from the paper: the U-Net runs once, at 1x;
    finer scales are light and work at half their resolution; at 4x references are merged before they are encoded;
    coarser images are added instead of combined by convolution, so that no scale can lose them.

    Args:
        widths: channels at 1/2, 1/4, 1/8, ... of the render's resolution. The first number is also that at 2x, and
            three quarters of it that at 4x.
        blocks: number of residual blocks at each of these levels; the first number is also that of the finer scales.
        encoder_blocks: number of residual blocks of the encoders at 1x.
        refine: learned alignment of the references' features at 1x.
        fusion: fusion of references with the target, at 1x and 2x.
        modulation: modulation of the fused features by depth.
        output: output head, at each scale.
        reference_renders: use the splat's renders of the references' views if they are known.
    """

    scale = 4

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        encoder_blocks: int = 1,
        refine: Choice = Unrefined(),  # noqa: B008  (frozen values)
        fusion: Choice = Trust(),  # noqa: B008
        modulation: Choice = DepthModulated(),  # noqa: B008
        output: Output = Gated(),  # noqa: B008
        reference_renders: bool = True,
    ) -> None:
        super().__init__()
        self.describe(locals())
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        self.stride = 2 ** max(len(widths), 2)
        self.gather = Gather(widths[0], encoder_blocks, refine, fusion, modulation, reference_renders)
        self.decode = Decoder(widths, blocks, output.outputs)
        fine_channels = 3 * widths[0] // 4
        self.grow = nn.Conv2d(widths[0], 4 * widths[0], 1)
        self.middle = Middle(widths[0], blocks[0], fusion, output.outputs)
        self.grow_again = nn.Conv2d(widths[0], 4 * fine_channels, 1)
        self.tail = Tail(fine_channels, blocks[0], output.outputs)
        self.output = output

    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r c _ _"], ...]:
        """Features of the references at 1x and 2x; `forward` can reuse them if references are not warped."""
        views = pad_to_stride(views, self.stride)
        photos, visibility = fine_references(views)
        return self.gather.encode(views), self.middle.encode(halve(photos.to(views.render)), visibility)

    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r c _ _"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """Enhanced images at 1, 2 and 4 times the render's size; without fine references, from the render alone."""
        height, width = views.render.shape[-2:]
        views = pad_to_stride(views, self.stride)
        fused, trust = self.gather(views, None if encoded is None else encoded[0])
        features = self.decode.features(fused)
        image = self.output(self.decode.outputs(features), views, trust)
        features = F.pixel_shuffle(self.grow(features), 2)
        first_stage = image, features, *fine_references(views), *(() if encoded is None else encoded[1:])
        if torch.is_grad_enabled() or torch.compiler.is_compiling() or max(views.render.shape[-2:]) <= TILE:
            images = image, *self._finer_scales(*first_stage)
        else:
            images = image, *self._finer_tiled(first_stage)
        return tuple(image[..., : n * height, : n * width] for n, image in zip((1, *UPSCALE), images, strict=True))

    def _finer_scales(
        self,
        image: Float[Tensor, "b 3 h w"],
        features: Float[Tensor, "b c h w"],
        photos: Float[Tensor, "b r 3 H W"],
        visibility: Float[Tensor, "b r 1 h w"],
        encoded: Float[Tensor, "b r c h w"] | None = None,
    ) -> tuple[Float[Tensor, "b 3 _ _"], Float[Tensor, "b 3 H W"]]:
        """Compute S2 and S4 of the whole image or of a tile.

        Args:
            image: S1.
            features: features of T1, upsampled.
            photos: the references at 4x, possibly in half precision.
            visibility: visibility of the references.
            encoded: features of the references at 2x; None computes them.
        """
        photos = photos.to(image)  # of a tile, since the whole in single precision would take twice the memory
        half = halve(photos)
        encoded = self.middle.encode(half, visibility) if encoded is None else encoded
        features, decoded, trust = self.middle(features, encoded, visibility)
        base = upsample_bicubic(image, 2)
        second = self.output(decoded, *merge_torch(base, half, halve(half), visibility, trust))
        fine_visibility = _repeat_2x(visibility)
        base = upsample_bicubic(image, 4) + upsample_bicubic(second - base, 2)
        merged, trust = merge_torch(base, photos, half, fine_visibility, _upsample_2x(trust) * (fine_visibility > 0))
        decoded = self.tail(self.grow_again(features), merged, trust)
        return second, self.output(decoded, merged, trust)

    def _finer_tiled(
        self, full_images: tuple[Tensor, ...]
    ) -> tuple[Float[Tensor, "b 3 _ _"], Float[Tensor, "b 3 H W"]]:
        """Compute `_finer_scales` by tiles, to limit memory; equal to the result for the whole up to rounding.

        All tiles have the same size, so that freed memory is used again.
        """
        batch, _, height, width = full_images[0].shape
        halo = MARGIN + 3 * len(self.tail.blocks)
        second, fourth = (full_images[0].new_empty(batch, 3, n * height, n * width) for n in UPSCALE)
        for (top, bottom), (first_row, end_row) in _spans(height, halo):
            for (left, right), (first_column, end_column) in _spans(width, halo):
                inner, outer = Region(top, left, bottom, right), Region(first_row, first_column, end_row, end_column)
                tiles = self._finer_scales(*(outer.crop(image, image.shape[-1] // width) for image in full_images))
                for n, result, tile in zip(UPSCALE, (second, fourth), tiles, strict=True):
                    inner.crop(result, n).copy_(inner.relative_to(outer).crop(tile, n))
        return second, fourth


def _spans(length: int, halo: int) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """First and last (exclusive) pixel of each part of a side, and of its tile, which has one size for all parts.

    A tile is its part with a halo on both sides; at the image's border it reaches further inwards instead.
    """
    part = math.ceil(length / math.ceil(length / TILE))
    size = min(length, part + 2 * halo)
    for start in range(0, length, part):
        first = min(max(0, start - halo), length - size)
        yield (start, min(start + part, length)), (first, first + size)


class Middle(nn.Module):
    """T2: fuses the fine references' features with those of the coarser scale, at half the scale's resolution.

    Args:
        channels: number of feature channels.
        blocks: number of residual blocks.
        fusion: fusion of references with the target.
        outputs: number of decoded channels.
    """

    def __init__(self, channels: int, blocks: int, fusion: Choice, outputs: int) -> None:
        super().__init__()
        self.encode_reference = nn.Conv2d(13, channels, 3, padding=1)
        self.fuse = fusion.build(channels)
        self.blocks = nn.Sequential(*(Block(channels) for _ in range(blocks)))
        self.head = nn.Conv2d(channels, 4 * outputs, 3, padding=1)
        zero_initialise(self.head)

    def encode(
        self, photos: Float[Tensor, "b r 3 h w"], visibility: Float[Tensor, "b r 1 i j"]
    ) -> Float[Tensor, "b r c i j"]:
        """Features of the references of this scale.

        Args:
            photos: the references on this scale's grid.
            visibility: visibility of the references at half its resolution.
        """
        if photos.shape[1] == 0:
            return photos.new_zeros(len(photos), 0, self.head.in_channels, *visibility.shape[-2:])
        dtype = computing_dtype(self.encode_reference)
        x = pixel_unshuffle(limit_colours(photos.flatten(0, 1)).to(dtype) - 0.5)
        features = self.encode_reference(torch.cat([x, visibility.flatten(0, 1).to(dtype)], dim=1))
        return features.unflatten(0, photos.shape[:2])

    def forward(
        self,
        features: Float[Tensor, "b c i j"],
        encoded: Float[Tensor, "b r c i j"],
        visibility: Float[Tensor, "b r 1 i j"],
    ) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b o h w"], Float[Tensor, "b r 1 i j"]]:
        """Features for the next scale, decoded values, and the trust of each reference.

        Args:
            features: features of the coarser scale, upsampled.
            encoded: features of the references, from `encode`.
            visibility: visibility of the references.
        """
        fused, trust = self.fuse(features, encoded.to(features.dtype), visibility)
        features = self.blocks(fused)
        return features, pixel_shuffle(self.head(features)), trust


class Tail(nn.Module):
    """T4, light: fuses the merged references at 4 times the render's size with the coarser scale's features.

    Args:
        channels: number of feature channels.
        blocks: number of residual blocks.
        outputs: number of decoded channels.
    """

    def __init__(self, channels: int, blocks: int, outputs: int) -> None:
        super().__init__()
        self.read = nn.Conv2d(25, channels, 3, padding=1)
        self.blocks = nn.Sequential(*(Block(channels) for _ in range(blocks)))
        self.head = nn.Conv2d(channels, 4 * outputs, 3, padding=1)
        zero_initialise(self.head)

    def forward(
        self, features: Float[Tensor, "b c p q"], views: NetworkInput, trust: Float[Tensor, "b _ 1 i j"]
    ) -> Float[Tensor, "b o h w"]:
        """Compute the decoded values.

        Args:
            features: features of the coarser scale, before the pixel-shuffle to twice its resolution.
            views: the base and the merged reference, or no reference.
            trust: trust of the merged reference.
        """
        merged = _pack_merged(views, trust, computing_dtype(self.read))
        features = upsample_with_skip(features, self.read(merged))
        return pixel_shuffle(self.head(self.blocks(features)))


def _pack_merged(
    views: NetworkInput, trust: Float[Tensor, "b _ 1 i j"], dtype: torch.dtype
) -> Float[Tensor, "b 25 i j"]:
    """Difference of the merged reference from the base, the base, and the reference's trust, pixel-unshuffled.

    Args:
        views: the base and the merged reference, or no reference.
        trust: trust of the merged reference.
        dtype: of the result.
    """
    base = views.render
    if views.references.shape[1] and can_fuse(base, views.references, views.visibility, trust):
        return _pack_compiled(views, trust)
    residual, trust_sum = torch.zeros_like(base), base.new_zeros(len(base), 1, *trust.shape[-2:])
    if views.references.shape[1]:
        residual, trust_sum = (views.references[:, 0] - base) * views.visibility[:, 0], trust[:, 0]
    stacked = torch.cat([residual.to(dtype), (base - 0.5).to(dtype)], dim=1)
    return torch.cat([F.pixel_unshuffle(stacked, 2), trust_sum.to(dtype)], dim=1)


def _pack_compiled(views: NetworkInput, trust: Float[Tensor, "b _ 1 i j"]) -> Float[Tensor, "b 25 i j"]:
    """Compiled version of `_pack_merged` in one pass over memory, where `can_fuse` holds."""
    from gaussian_enhancer.network.ssif_sr_kernels import pack_merged

    result = empty_features(len(trust), 25, *trust.shape[-2:])
    with kernel_lock:
        for b, words in enumerate(kernel_words(result)):
            inputs = views.render[b], views.references[b, 0], views.visibility[b, 0, 0], trust[b, 0, 0]
            pack_merged(*(plane(image) for image in inputs), words)
    return result


def fine_references(views: NetworkInput) -> tuple[Float[Tensor, "b r 3 _ _"], Float[Tensor, "b r 1 h w"]]:
    """The references at 4 times the render's size, empty if they are not given, and their visibility.

    Visibility has the render's resolution, so that averaged squares never mix visible and invisible pixels.
    """
    fine = views.fine_references
    if fine is None:
        batch, _, height, width = views.render.shape
        fine = views.render.new_zeros(batch, 0, 3, 4 * height, 4 * width)
    return fine, views.visibility[:, : fine.shape[1]]


def merge_torch(
    base: Float[Tensor, "b 3 h w"],
    photos: Float[Tensor, "b r 3 h w"],
    halved: Float[Tensor, "b r 3 i j"],
    visibility: Float[Tensor, "b r 1 i j"],
    trust: Float[Tensor, "b r 1 i j"],
) -> tuple[NetworkInput, Float[Tensor, "b _ 1 i j"]]:
    """Merge references: their mean weighted by trust, and the sum of their trust.

    Its ``reference_renders`` are the mean's content at half resolution, so that the term photo minus render of
    `compose` passes on detail only, which a difference in exposure does not affect. Merging costs less than processing
    each reference.

    Args:
        base: image in place of the render at this scale.
        photos: references on the base's grid.
        halved: references averaged to half that resolution.
        visibility: visibility of the references.
        trust: trust of each reference; 0 where it is not visible.
    """
    if photos.shape[1] == 0:
        return NetworkInput(base, photos, photos[:, :, :1]), trust
    if can_fuse(base, photos, halved, visibility, trust):
        return _merge_compiled(base, photos, halved, visibility, trust)
    trust = trust.to(base.dtype)
    weight = _upsample_2x(trust) * _repeat_2x(visibility > 0)
    total = weight.sum(1)
    mean = weighted_sum(weight, photos) / total.clamp_min(1e-6)
    trust_sum = trust.sum(1, keepdim=True)
    soft = _upsample_2x(torch.cat([weighted_sum(trust, halved), trust_sum[:, 0]], dim=1)[:, None])[:, 0]
    soft = soft[:, :3] / soft[:, 3:].clamp_min(1e-6)
    return NetworkInput(
        base, mean[:, None], (total > 0).to(base.dtype)[:, None], reference_renders=soft[:, None]
    ), trust_sum


def _merge_compiled(
    base: Float[Tensor, "b 3 h w"],
    photos: Float[Tensor, "b r 3 h w"],
    halved: Float[Tensor, "b r 3 i j"],
    visibility: Float[Tensor, "b r 1 i j"],
    trust: Float[Tensor, "b r 1 i j"],
) -> tuple[NetworkInput, Float[Tensor, "b _ 1 i j"]]:
    """Compiled version of `merge_torch` in one pass over memory, where `can_fuse` holds."""
    from gaussian_enhancer.network.ssif_sr_kernels import merge

    mean, soft = (torch.empty(base.shape) for _ in range(2))
    mask, trust_sum = torch.empty(base[:, :1].shape), torch.empty(trust[:, 0].shape)
    with kernel_lock:
        for b in range(len(base)):
            inputs = photos[b], halved[b], visibility[b, :, 0], trust[b, :, 0]
            outputs = mean[b], mask[b, 0], soft[b], trust_sum[b, 0]
            merge(*(plane(image) for image in inputs), *(image.numpy() for image in outputs))
    return NetworkInput(base, mean[:, None], mask[:, None], reference_renders=soft[:, None]), trust_sum[:, None]


def _upsample_2x(planes: Float[Tensor, "b r c i j"]) -> Float[Tensor, "b r c h w"]:
    """Planes upsampled by 2."""
    if planes.shape[1] == 0:
        return _repeat_2x(planes)
    flat = F.interpolate(planes.flatten(1, 2), scale_factor=2, mode="bilinear", align_corners=False)
    return flat.unflatten(1, planes.shape[1:3])


def _repeat_2x(planes: Tensor) -> Tensor:
    return planes.repeat_interleave(2, dim=-2).repeat_interleave(2, dim=-1)
