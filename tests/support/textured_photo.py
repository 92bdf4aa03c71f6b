"""A photo with structure at every scale."""

import torch
import torch.nn.functional as F


def textured_photo(size: tuple[int, int], seed: int = 0, layers: int = 6) -> torch.Tensor:
    """A photo, (3, h, w), of layers of noise: the finest has a number every pixel, each other is half as fine."""
    generator = torch.Generator().manual_seed(seed)
    noise = [
        F.interpolate(torch.rand(1, 3, size[0] // k + 1, size[1] // k + 1, generator=generator), size, mode="bilinear")
        for k in (2**layer for layer in range(layers))
    ]
    return (torch.stack(noise).mean(0)[0] * 2 - 0.5).clamp(0, 1)
