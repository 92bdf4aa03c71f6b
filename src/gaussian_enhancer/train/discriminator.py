"""A critic of renders, for adversarial training of the simulator.

Axes: b batch, h height, w width, i and j rows and columns of verdicts.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.parametrizations import spectral_norm


class Discriminator(nn.Module):
    """Tells real renders of a photo from simulated ones, patch by patch.

    A patch discriminator (Isola et al., CVPR 2017) with spectral normalisation (Miyato et al., ICLR 2018). It sees the
    photo beside the render: a render must fit its photo, not merely look like some render.

    Args:
        width: channels at the finest resolution; doubled once.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        sizes = [
            (24, width, 3, 1),
            (width, 2 * width, 4, 2),
            (2 * width, 2 * width, 4, 2),
            (2 * width, 2 * width, 3, 1),
        ]
        self.layers = nn.ModuleList([spectral_norm(nn.Conv2d(a, b, k, stride=s, padding=1)) for a, b, k, s in sizes])
        self.verdict = spectral_norm(nn.Conv2d(2 * width, 1, 3, padding=1))

    def forward(
        self, photo: Float[Tensor, "b 3 h w"], render: Float[Tensor, "b 3 h w"]
    ) -> tuple[Float[Tensor, "b 1 i j"], list[Tensor]]:
        """Verdicts, positive where real, and the features that led to them.

        Args:
            photo: of the view.
            render: real or simulated.
        """
        x = F.pixel_unshuffle(torch.cat([render, render - photo], dim=1), 2)
        features = []
        for layer in self.layers:
            x = F.leaky_relu(layer(x), 0.2)
            features.append(x)
        return self.verdict(x), features


def critic_loss(real: Tensor, simulated: Tensor) -> Tensor:
    """Hinge loss of the discriminator (Lim and Ye, 2017)."""
    return F.relu(1 - real.float()).mean() + F.relu(1 + simulated.float()).mean()


def feature_distance(real: list[Tensor], simulated: list[Tensor]) -> Tensor:
    """Mean absolute difference of the discriminator's features (Wang et al., pix2pixHD, CVPR 2018)."""
    distances = [(a.detach() - b).abs().float().mean() for a, b in zip(real, simulated, strict=True)]
    return torch.stack(distances).mean()
