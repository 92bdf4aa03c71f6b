"""The stages of the paper's networks: Encoder, DeformableConv, feature fusion and Combine.

Axes: b batch, r references (at most two), c channels, h height, w width, i = h / 2, j = w / 2.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.align.depth_normalisation import depth_unit, normalised_inverse_depth
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.network.block import Block
from gaussian_enhancer.network.initialisation import zero_initialise
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.stem import Choice
from gaussian_enhancer.types import NetworkInput, usable_depth

ADJACENT = 2
"""Number of references that the paper uses: t-1 and t+1."""


class ImageEncoder(nn.Module):
    """F = Encoder(image): features at half the image's resolution.

    Args:
        planes: number of image channels.
        channels: number of feature channels.
        blocks: number of residual blocks.
    """

    def __init__(self, planes: int, channels: int, blocks: int) -> None:
        super().__init__()
        self.stem = nn.Conv2d(4 * planes, channels, 3, padding=1)
        self.blocks = nn.Sequential(*(Block(channels) for _ in range(blocks)))

    def forward(self, image: Float[Tensor, "b p h w"]) -> Float[Tensor, "b c i j"]:
        """Encode an image with values around 0; height and width are even."""
        return self.blocks(self.stem(F.pixel_unshuffle(image, 2)))

    def encode_each(self, images: Float[Tensor, "b r p h w"]) -> Float[Tensor, "b r c i j"]:
        """Encode several images separately with the same weights."""
        if images.shape[1] == 0:
            batch, _, _, height, width = images.shape
            return images.new_zeros(batch, 0, self.stem.out_channels, height // 2, width // 2)
        return self(images.flatten(0, 1)).unflatten(0, images.shape[:2])


class DeformableConv(nn.Module):
    """DeformableConv(F[t-1], F[t], F[t+1]): references are aligned to the target, then all three are fused.

    F_fused = join(F[t], deform(F[t-1]), deform(F[t+1])), where the offsets of each reference are predicted from it and
    the target. A missing reference is replaced by zeros.

    Args:
        channels: number of feature channels.
        refine: the deformable convolution.
        outputs: number of output channels.
    """

    def __init__(self, channels: int, refine: Choice, outputs: int) -> None:
        super().__init__()
        self.align = refine.build(channels)
        self.join = nn.Conv2d((1 + ADJACENT) * channels, outputs, 3, padding=1)

    def forward(
        self,
        target: Float[Tensor, "b c i j"],
        references: Float[Tensor, "b r c i j"],
        visibility: Float[Tensor, "b r 1 i j"],
    ) -> Float[Tensor, "b o i j"]:
        """Align and fuse.

        Args:
            target: features of the degraded target.
            references: features of t-1 and t+1.
            visibility: 0 where a reference is missing.
        """
        aligned = self.align(references, target) if references.shape[1] else references
        return self.join(torch.cat([target, *adjacent_features(aligned, visibility)], dim=1))


class FeatureFusion(nn.Module):
    """The paper's circled plus: features are concatenated and convolved.

    Args:
        channels: number of channels of each input and of the result.
        parts: number of inputs.
    """

    def __init__(self, channels: int, parts: int) -> None:
        super().__init__()
        self.join = nn.Conv2d(parts * channels, channels, 3, padding=1)

    def forward(self, *features: Float[Tensor, "b c i j"]) -> Float[Tensor, "b c i j"]:
        """Fuse features of the same resolution."""
        return self.join(torch.cat(features, dim=1))


class LearnedCombine(nn.Module):
    """Combine and Fuse of the algorithms: a scale's image is combined with the upsampled images of coarser scales.

    E = T + c(T, up E_1, up E_2, ...), where c is two convolutions, of which the last is zero at initialisation.

    Args:
        coarser: number of coarser scales.
        width: number of internal channels.
    """

    def __init__(self, coarser: int, width: int) -> None:
        super().__init__()
        self.join = nn.Conv2d(12 * (1 + coarser), width, 3, padding=1)
        self.head = nn.Conv2d(width, 12, 3, padding=1)
        zero_initialise(self.head)

    def forward(self, fine: Float[Tensor, "b 3 h w"], *coarser: Float[Tensor, "b 3 _ _"]) -> Float[Tensor, "b 3 h w"]:
        """Combine images.

        Args:
            fine: the image of this scale; height and width are even.
            coarser: the images of the coarser scales, whose sides divide those of this one.
        """
        images = [fine, *(upsample_bicubic(image, fine.shape[-1] // image.shape[-1]) for image in coarser)]
        x = F.relu(self.join(F.pixel_unshuffle(torch.cat([image - 0.5 for image in images], dim=1), 2)))
        return fine + F.pixel_shuffle(self.head(x), 2).to(fine.dtype)


def adjacent_features(
    references: Float[Tensor, "b r c i j"], visibility: Float[Tensor, "b r 1 i j"]
) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b c i j"]]:
    """The features of t-1 and t+1; a missing reference is replaced by zeros.

    Raises:
        InputError: there are more than two references.
    """
    count = references.shape[1]
    if count > ADJACENT:
        raise InputError("references", f"are {count} for a network of two", "ask for 2, or choose mode=ours")
    visible_references = references * visibility.to(references.dtype)
    missing = [torch.zeros_like(references.sum(1))] * (ADJACENT - count)
    first, second = [*visible_references.unbind(1), *missing]
    return first, second


def halved_visibility(views: NetworkInput) -> Float[Tensor, "b r 1 i j"]:
    """Visibility of the references at half the resolution."""
    visibility = views.visibility
    if visibility.shape[1] == 0:
        return visibility.new_zeros(*visibility.shape[:3], *(side // 2 for side in visibility.shape[-2:]))
    return F.avg_pool2d(visibility.flatten(0, 1), 2).unflatten(0, visibility.shape[:2])


def depth_planes(views: NetworkInput) -> Float[Tensor, "b 2 h w"]:
    """D as input of the networks: normalised inverse depth, and the mask of usable depth; zeros without depth."""
    if views.depth is None:
        return torch.zeros_like(views.render[:, :2])
    unit = depth_unit(views.depth) if views.depth_unit is None else views.depth_unit
    known_depth = usable_depth(views.depth)
    return torch.cat([normalised_inverse_depth(views.depth, unit), known_depth], dim=1).to(views.render.dtype)
