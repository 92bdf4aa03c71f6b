"""The share of a network's change to apply, block by block, predicted from the references.

A network changes a render where warped photos differ from it. Where depth is wrong, photos differ by misalignment, and
the change does harm. Where the light moved with the camera, or the object was turned under it, photos differ in shade:
their detail is right, but their mean is wrong. So the change is split into its means over blocks and the remaining
detail, and a separate share of each is applied. Aligned photos agree with the change and with each other. If the errors
of two photos are independent, the mean product of their differences from the render estimates the render's squared
error (the "three-cornered hat" of Gray and Allan, 1974). A small network predicts the shares of each block from such
products, of means and of details. The job ``train_confidence`` trains it.

Axes: b batch, r references, k bands (means, details), h height, w width, i j blocks, v vectors of a block, n their
values, f features.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from gaussian_enhancer.align.projection import can_use_kernels
from gaussian_enhancer.types import NetworkInput, numpy_view

BLOCK = 8
"""Side of a block, in pixels."""
STEP = 2
"""Step between the sampled rows and columns of pixels; a step of 1 takes four times as long."""
SAMPLES = BLOCK // STEP
"""Samples along a side of a block."""
STRIP = 64
"""Number of rows of blocks that are processed at a time, to limit the memory for large images."""
MIN_VISIBLE_SHARE = 0.1
"""Share of a block's pixels above which a reference's features of the block are used."""
EPSILON = 1e-6
"""Added to squared colour differences in denominators."""
BANDS = 2
"""Parts of the change with separate shares: block means, and details."""
OF_IMAGE, OF_REFERENCE, OF_PAIR = 3, 7, 3
"""Numbers of features: of the image, and in each band of a reference and of a pair of references."""
FEATURES = OF_IMAGE + BANDS * (1 + 3 * (OF_REFERENCE + OF_PAIR))
"""Features of a block. Those of references and of pairs are reduced to their mean, minimum and maximum."""
INPUTS = 3 * FEATURES
"""Inputs of the network: the block's features, their means over 3x3 blocks, and their means over the image."""


class ChangeConfidence(nn.Module):
    """The shares of a network's change to apply at each pixel: of its means over blocks, and of its details.

    Args:
        hidden: width of the two hidden layers.
    """

    centre: Tensor
    scale: Tensor

    def __init__(self, hidden: int = 96) -> None:
        super().__init__()
        self.hidden = hidden
        self.register_buffer("centre", torch.zeros(INPUTS))
        self.register_buffer("scale", torch.ones(INPUTS))
        self.layers = nn.Sequential(
            nn.Conv2d(INPUTS, hidden, 1),
            nn.ReLU(),
            nn.Dropout(0.1),
            nn.Conv2d(hidden, hidden, 1),
            nn.ReLU(),
            nn.Conv2d(hidden, BANDS, 1),
        )

    def predict_shares(self, features: Float[Tensor, "b f i j"]) -> Float[Tensor, "b k i j"]:
        """The shares of each block, not clamped; see `block_features`."""
        standard = (features - self.centre[:, None, None]) / self.scale[:, None, None]
        shares: Tensor = self.layers(standard.clamp(-4, 4))
        return shares

    def forward(self, enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Float[Tensor, "b 3 h w"]:
        """The render plus the predicted share of each band of the change.

        Args:
            enhanced: the network's output, in [0, 1].
            views: the render and its references.
        """
        return apply_shares(enhanced, views.render, self.shares(enhanced, views))

    def shares(self, enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Float[Tensor, "b k i j"]:
        """The shares of each block, from 0 to 1.

        Args:
            enhanced: the network's output, in [0, 1].
            views: the render and its references.
        """
        return self.predict_shares(block_features(enhanced, views)).clamp(0, 1)


def apply_shares(
    enhanced: Float[Tensor, "b 3 h w"], render: Float[Tensor, "b 3 h w"], shares: Float[Tensor, "b k i j"]
) -> Float[Tensor, "b 3 h w"]:
    """`apply_shares_torch`, by the compiled kernel where it can be used."""
    apply = apply_shares_compiled if can_use_kernels(enhanced, render, shares) else apply_shares_torch
    return apply(enhanced, render, shares)


def apply_shares_torch(
    enhanced: Float[Tensor, "b 3 h w"], render: Float[Tensor, "b 3 h w"], shares: Float[Tensor, "b k i j"]
) -> Float[Tensor, "b 3 h w"]:
    """The render plus each block's shares of the bands of the change. Readable twin of the compiled kernel.

    Args:
        enhanced: the network's output, in [0, 1].
        render: the render.
        shares: shares of the change's means and of its details, interpolated linearly between the blocks' centres.
    """
    means, details = split_change(enhanced - render)
    fine = interpolate_blocks(shares, *render.shape[-2:])
    return (render + fine[:, :1] * means + fine[:, 1:] * details).clamp(0, 1)


def apply_shares_compiled(
    enhanced: Float[Tensor, "b 3 h w"], render: Float[Tensor, "b 3 h w"], shares: Float[Tensor, "b k i j"]
) -> Float[Tensor, "b 3 h w"]:
    """Compiled version of `apply_shares_torch`."""
    from gaussian_enhancer.compiled import kernel_lock
    from gaussian_enhancer.infer.change_confidence_kernels import apply_shares

    result = torch.empty_like(render, memory_format=torch.contiguous_format)
    with kernel_lock:
        for b, image in enumerate(result):
            apply_shares(numpy_view(enhanced[b]), numpy_view(render[b]), numpy_view(shares[b]), BLOCK, image.numpy())
    return result


def split_change(change: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 3 h w"]]:
    """Means of a change over blocks, interpolated linearly between the blocks' centres, and the remaining detail."""
    height, width = change.shape[-2:]
    means = interpolate_blocks(F.avg_pool2d(change, BLOCK, ceil_mode=True), height, width)
    return means, change - means


def interpolate_blocks(
    blocks: Float[Tensor, "b c i j"], height: int, width: int
) -> Float[Tensor, "b c {height} {width}"]:
    """Values of blocks at each pixel, interpolated linearly between the blocks' centres."""
    fine = F.interpolate(blocks, scale_factor=BLOCK, mode="bilinear", align_corners=False)
    return fine[..., :height, :width]


def block_features(enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Float[Tensor, "b f i j"]:
    """Features of each block from the change and the references, and their means over 3x3 blocks and over the image.

    Args:
        enhanced: the network's output.
        views: the render, its references, their visibility and the splat's renders of their views.
    """
    inputs: tuple[Tensor, ...] = enhanced, views.render, views.references, views.visibility
    if views.reference_renders is not None:
        inputs = *inputs, views.reference_renders
    products = products_compiled if can_use_kernels(*inputs) else block_products
    of_means, of_details, visible_share, change = products(enhanced, views)
    features = _block_descriptions((of_means, of_details), visible_share, change)
    neighbourhood_means = F.avg_pool2d(features, 3, 1, 1, count_include_pad=False)
    return torch.cat([features, neighbourhood_means, features.mean((2, 3), keepdim=True).expand_as(features)], dim=1)


Products = tuple[
    Float[Tensor, "b v v i j"], Float[Tensor, "b v v i j"], Float[Tensor, "b r i j"], Float[Tensor, "b 3 i j"]
]


def block_products(enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Products:
    """Inner products of each block's vectors, for means and for details, visible shares, and mean changes.

    The vectors are listed in `_block_descriptions`. Products are means over pixels and channels. Readable twin of the
    compiled kernel, on any device.
    """
    image, render, photos, visibility = (
        image[..., ::STEP, ::STEP].float() for image in (enhanced, views.render, views.references, views.visibility)
    )
    visible, change = (visibility > 0).float(), image - render
    render_residuals = (photos - render[:, None]) * visible
    reference_residuals = render_residuals
    if views.reference_renders is not None:
        reference_residuals = (photos - views.reference_renders[..., ::STEP, ::STEP].float()) * visible
    change_and_render = change[:, None], render[:, None]
    vectors = torch.cat([*change_and_render, change[:, None] * visible, render_residuals, reference_residuals], dim=1)
    strips = [_products(vectors[..., y : y + STRIP * SAMPLES, :]) for y in range(0, vectors.shape[-2], STRIP * SAMPLES)]
    of_means, of_details = (torch.cat(band, dim=-2) for band in zip(*strips, strict=True))
    visible_share = _block_means(visible.flatten(0, 1)).unflatten(0, visible.shape[:2])[:, :, 0]
    return of_means, of_details, visible_share, _block_means(change)


def products_compiled(enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Products:
    """Compiled version of `block_products`."""
    from gaussian_enhancer.compiled import kernel_lock
    from gaussian_enhancer.infer.change_confidence_kernels import block_products as kernel

    batch, count, _, height, width = views.references.shape
    vectors, size = 2 + 3 * count, (-(-height // BLOCK), -(-width // BLOCK))
    means, details = enhanced.new_empty(2, batch, vectors, vectors, *size)
    visible_share, change = enhanced.new_empty(batch, count, *size), enhanced.new_empty(batch, 3, *size)
    has_renders = views.reference_renders is not None
    renders = views.references if views.reference_renders is None else views.reference_renders
    inputs = enhanced, views.render, views.references, renders, views.visibility
    with kernel_lock:
        for b in range(batch):
            outputs = (array[b].numpy() for array in (means, details, visible_share, change))
            kernel(*(numpy_view(image[b]) for image in inputs), np.float32(has_renders), BLOCK, STEP, *outputs)
    return means, details, visible_share, change


def _block_means(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c i j"]:
    """Means over blocks; in blocks that the border cuts, over the pixels inside the image."""
    return F.avg_pool2d(image, SAMPLES, ceil_mode=True)


def _products(images: Float[Tensor, "b v 3 h w"]) -> tuple[Float[Tensor, "b v v i j"], Float[Tensor, "b v v i j"]]:
    """Mean products of each two images in each block: of their block means, and of their details."""
    height, width = images.shape[-2:]
    padding = 0, -width % SAMPLES, 0, -height % SAMPLES
    blocks = F.pad(images, padding).unflatten(-1, (-1, SAMPLES)).unflatten(-3, (-1, SAMPLES))
    values = blocks.permute(0, 3, 5, 1, 2, 4, 6).flatten(5)  # b i j v 3 n
    filled = F.avg_pool2d(F.pad(torch.ones_like(images[:1, 0, :1]), padding), SAMPLES)[0, 0, ..., None, None]
    means = values.mean(-1) / filled
    flat = values.flatten(4)
    mean_products = flat @ flat.transpose(-1, -2) / (3 * SAMPLES**2 * filled)
    of_means = means @ means.transpose(-1, -2) / 3
    return of_means.permute(0, 3, 4, 1, 2), (mean_products - of_means).permute(0, 3, 4, 1, 2)


def _block_descriptions(
    bands: tuple[Float[Tensor, "b v v i j"], Float[Tensor, "b v v i j"]],
    visible_share: Float[Tensor, "b r i j"],
    change: Float[Tensor, "b 3 i j"],
) -> Float[Tensor, "b f i j"]:
    """Features of blocks.

    The vectors of a block are the change, the render and, where a reference is visible, for each reference the change,
    photo - render, and photo - the splat's render of its view.

    Args:
        bands: mean products of the vectors' block means, and of their details.
        visible_share: share of each block in which each reference is visible.
        change: mean change of each block.
    """
    means, details = (products[:, 0, 0].clamp_min(0) for products in bands)
    texture = bands[1][:, 1, 1].clamp_min(0).sqrt()
    features = [torch.stack([change.mean(1).abs(), means / (means + details + EPSILON), texture], dim=1)]
    for products in bands:
        features += [products[:, :1, 0].clamp_min(0).sqrt(), *_reference_evidence(products, visible_share)]
    stacked = torch.cat(features, dim=1)
    return stacked.sign() * torch.log1p(20 * stacked.abs())


def _reference_evidence(
    products: Float[Tensor, "b v v i j"], visible_share: Float[Tensor, "b r i j"]
) -> list[Float[Tensor, "b f i j"]]:
    """Mean, minimum and maximum of the features of references, and of pairs of references, in one band."""
    count = visible_share.shape[1]
    reference_features, pair_features = [], []
    for i in range(count):
        c, d, s = 2 + i, 2 + count + i, 2 + 2 * count + i
        share, change_energy = visible_share[:, i].clamp_min(MIN_VISIBLE_SHARE), products[:, c, c] + EPSILON
        squares = (
            products[:, d, d],
            products[:, d, d] + products[:, c, c] - 2 * products[:, c, d],
            products[:, s, s],
            products[:, d, d] + products[:, s, s] - 2 * products[:, d, s],
        )
        reference_features.append(
            torch.stack(
                [
                    products[:, c, d] / change_energy,
                    products[:, c, s] / change_energy,
                    *((square.clamp_min(0) / share).sqrt() for square in squares),
                    visible_share[:, i],
                ],
                dim=1,
            )
        )
        for j in range(i):
            e = 2 + count + j
            product = products[:, d, e]
            distance = (products[:, d, d] + products[:, e, e] - 2 * product).clamp_min(0).sqrt()
            lengths = products[:, d, d].clamp_min(0) * products[:, e, e].clamp_min(0)
            correlation = product / (lengths.sqrt() + EPSILON)
            pair_features.append(torch.stack([distance, product, correlation], dim=1))
    is_valid = [visible_share[:, i] > MIN_VISIBLE_SHARE for i in range(count)]
    pair_is_valid = [is_valid[i] & is_valid[j] for i in range(count) for j in range(i)]
    zeros = torch.zeros_like(products[:, :1, 0])
    return [
        *_summary(reference_features, is_valid, zeros, OF_REFERENCE),
        *_summary(pair_features, pair_is_valid, zeros, OF_PAIR),
    ]


def _summary(
    values: list[Float[Tensor, "b f i j"]],
    is_valid: list[Bool[Tensor, "b i j"]],
    zeros: Float[Tensor, "b 1 i j"],
    count: int,
) -> list[Float[Tensor, "b f i j"]]:
    """Mean, minimum and maximum of the valid values; zeros where none is valid."""
    if not values:
        return [torch.zeros_like(zeros).expand(-1, 3 * count, -1, -1)]
    stacked, valid = torch.stack(values), torch.stack(is_valid)[:, :, None]
    valid_count = valid.sum(0)
    mean = torch.where(valid, stacked, 0.0).sum(0) / valid_count.clamp_min(1)
    minimum = torch.where(valid, stacked, torch.inf).amin(0)
    maximum = torch.where(valid, stacked, -torch.inf).amax(0)
    return [torch.where(valid_count > 0, statistic, 0.0) for statistic in (mean, minimum, maximum)]
