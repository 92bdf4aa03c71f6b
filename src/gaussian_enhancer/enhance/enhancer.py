"""From a set of renders to enhanced images.

Axes: b batch, h height, w width, H, W the same times the network's scale.
"""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.enhance.alignment import Unwarped
from gaussian_enhancer.enhance.cache import ReferenceFeatures
from gaussian_enhancer.enhance.network import Network, Remembering
from gaussian_enhancer.enhance.prepare import Pool, Preparation, join, read_target
from gaussian_enhancer.enhance.pyramid import enlarged
from gaussian_enhancer.enhance.tiles import enhance_tiled
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.types import Views, usable


@dataclass(frozen=True)
class Enhanced:
    """One enhanced view.

    Args:
        name: the render's file name.
        image: of the render's size, or finer by the network's scale, [0, 1].
        preparing: milliseconds spent on choosing, reading and warping references.
        enhancing: milliseconds spent in the network.
        references: names of the references that were used, best first.
    """

    name: str
    image: Float[Tensor, "3 _ _"]
    preparing: float
    enhancing: float
    references: tuple[str, ...]


class Enhancer:
    """Enhances the targets of a set one by one.

    Where references are not warped and a target fits in one tile, references are encoded once for all targets.

    Args:
        network: maps views to enhanced images.
        preparation: how references are chosen and aligned.
        device: where the network runs.
        precision: of the network's convolutions; "auto" is bfloat16 on processors and float16 on graphics cards
            that compute in it, float32 elsewhere.
        tile: side of the tiles that larger images are cut into, a multiple of 16.
        halo: pixels around a tile that are computed and thrown away, a multiple of 16.
        strength: share of the network's change that is applied, in [0, 1]; 0 returns the render.

    Raises:
        InputError: precision or strength is out of range.
    """

    def __init__(
        self,
        network: Network,
        preparation: Preparation,
        device: torch.device | None = None,
        precision: str = "auto",
        tile: int = 1024,
        halo: int = 96,
        strength: float = 1.0,
    ) -> None:
        if not 0 <= strength <= 1:
            raise InputError("strength", f"is {strength}", "use a number from 0 (the render) to 1")
        self.device = torch.device("cpu") if device is None else device
        self.network = network.eval().to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.preparation = preparation
        self.dtype = choose_precision(precision, self.device)
        self.tile, self.halo, self.strength = tile, halo, strength

    def __call__(self, rendered: RenderedSet) -> Iterator[Enhanced]:
        """Enhance each target of a set, in its order.

        Raises:
            InputError: a view cannot be read, or lacks what the preparation needs.
        """
        if not rendered.targets:
            raise InputError(rendered.name, "has no render to enhance", "render held-out views first")
        pool = Pool(rendered.references)
        kept = None
        if isinstance(self.network, Remembering) and isinstance(self.preparation.warp, Unwarped):
            kept = ReferenceFeatures(self.network)
        for view in rendered.targets:
            started = time.perf_counter()
            target = read_target(view)
            aligned = self.preparation.align(target, view, pool)
            prepared = time.perf_counter()
            image = self.enhance(join(target, aligned), aligned.names, kept)[0]
            ended = time.perf_counter()
            yield Enhanced(view.name, image, 1e3 * (prepared - started), 1e3 * (ended - prepared), aligned.names)

    @torch.inference_mode()
    def enhance(
        self, views: Views, names: Sequence[str] = (), kept: ReferenceFeatures | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """Run the network, in tiles where the image is large; the result is on the CPU, in [0, 1].

        Args:
            views: what is known of the target.
            names: of the references.
            kept: features of references that are kept between targets; without effect where there are several tiles.
        """
        views = views.to(self.device)
        if views.depth is not None and not bool(usable(views.depth).any()):
            views = dataclasses.replace(views, depth=None, depth_unit=None)
        with torch.autocast(self.device.type, self.dtype, enabled=self.dtype != torch.float32):
            if kept is not None and max(views.render.shape[-2:]) <= self.tile:
                enhanced = kept.network(views, kept(views, names))
            else:
                enhanced = enhance_tiled(self.network, views, self.tile, self.halo, scale=self.network.scale)
        enhanced = enhanced.float()
        if self.strength < 1:
            start = enlarged(views.render, self.network.scale)
            enhanced = start + self.strength * (enhanced - start)
        return enhanced.clamp(0, 1).cpu()


def choose_precision(precision: str, device: torch.device) -> torch.dtype:
    """The type that convolutions compute in.

    Raises:
        InputError: the name is unknown.
    """
    names = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
    if precision in names:
        return names[precision]
    if precision != "auto":
        raise InputError("precision", f"is {precision!r}", f"choose auto, {', '.join(names)}")
    if device.type == "cuda":
        return torch.float16
    # Emulated bfloat16 is slower than float32, so only processors that have it use it.
    return torch.bfloat16 if torch.cpu._is_avx512_bf16_supported() else torch.float32
