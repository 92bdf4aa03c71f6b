"""Simulated and real renders of the same views, and patches cut from both at the same places.

Every place gives a patch of each kind, so the content of a patch does not distinguish the kinds; only its origin does.
Axes: c channels, h height, w width, n patches, s side of a patch.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64, UInt8
from torch import Tensor

from gaussian_enhancer.errors import InputError

FLAT = 2.0
"""Standard deviation of a photo's patch, in steps of 1/255, up to which the patch counts as plain background."""


@dataclass(frozen=True)
class RenderPair:
    """A photographed view, its simulated render and a real one, rounded to 8 bits.

    Args:
        scene: the scene's name, by which training and test scenes are separated.
        view: the view's name within the scene; a view may come with several renders.
        photo: the photo.
        simulated: simulated render of the view.
        real: real render of the view.

    Raises:
        InputError: the sizes differ.
    """

    scene: str
    view: str
    photo: UInt8[Tensor, "3 _ _"]
    simulated: UInt8[Tensor, "3 _ _"]
    real: UInt8[Tensor, "3 _ _"]

    def __post_init__(self) -> None:
        for name, image in (("simulated", self.simulated), ("real", self.real)):
            if image.shape != self.photo.shape:
                received = f"is {tuple(image.shape)} beside a photo of {tuple(self.photo.shape)}"
                raise InputError(f"{name} render of {self.view}", received, "give images of one size")


@dataclass(frozen=True)
class Patches:
    """Patches of simulated and real renders, place by place.

    Args:
        simulated: patches of simulated renders.
        real: patches of real renders at the same places of the same views.
        photo: patches of the photos there.
        view: which of ``views`` each place belongs to.
        views: names of scene and view.
    """

    simulated: UInt8[Tensor, "n 3 s s"]
    real: UInt8[Tensor, "n 3 s s"]
    photo: UInt8[Tensor, "n 3 s s"]
    view: Int64[Tensor, " n"]
    views: tuple[tuple[str, str], ...]

    def __len__(self) -> int:
        return self.view.shape[0]

    def __getitem__(self, index: Int64[Tensor, " m"] | Bool[Tensor, " n"]) -> "Patches":
        """The places that indices or a mask select."""
        return Patches(self.simulated[index], self.real[index], self.photo[index], self.view[index], self.views)

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes, sorted."""
        return tuple(sorted({scene for scene, _ in self.views}))

    @property
    def scene(self) -> Int64[Tensor, " n"]:
        """Which of ``scenes`` each place belongs to."""
        number = {name: i for i, name in enumerate(self.scenes)}
        return torch.tensor([number[scene] for scene, _ in self.views])[self.view]


def eight_bit(image: Float[Tensor, "*batch h w"]) -> UInt8[Tensor, "*batch h w"]:
    """The image as stored in an 8-bit file: clamped to [0, 1] and rounded to 255 steps."""
    return (image.clamp(0, 1) * 255).round().to(torch.uint8)


def patch_places(
    photo: UInt8[Tensor, "3 h w"], size: int, count: int, generator: torch.Generator
) -> list[tuple[int, int]]:
    """Upper left corners of patches that do not overlap, on a grid of random phase, in random order.

    Places that are plain background are left out.

    Args:
        photo: the photo.
        size: side of a patch in pixels.
        count: number of places at most.
        generator: source of randomness.
    """
    height, width = photo.shape[-2:]
    if min(height, width) < size:
        raise InputError("photo", f"is {width}x{height} pixels", f"choose patches smaller than {size} pixels")
    top, left = (int(torch.randint(side % size + 1, (), generator=generator)) for side in (height, width))
    grid = [(y, x) for y in range(top, height - size + 1, size) for x in range(left, width - size + 1, size)]
    order = torch.randperm(len(grid), generator=generator).tolist()
    shuffled = [grid[i] for i in order]
    textured = [(y, x) for y, x in shuffled if _spread(photo[:, y : y + size, x : x + size]) > FLAT]
    return textured[:count]


def cut_patches(pairs: Iterable[RenderPair], size: int = 64, per_pair: int = 8, seed: int = 0) -> Patches:
    """Cut patches from pairs of renders; with one seed, the places are the same whatever the renders look like.

    Args:
        pairs: simulated and real renders.
        size: side of a patch in pixels.
        per_pair: number of places in a pair at most.
        seed: of the places.

    Raises:
        InputError: no pair has a place that is not plain background.
    """
    patches_by_kind: dict[str, list[Tensor]] = {"simulated": [], "real": [], "photo": []}
    view = []
    views: dict[tuple[str, str], int] = {}
    for number, pair in enumerate(pairs):
        generator = torch.Generator().manual_seed(seed * 1_000_003 + number)
        for y, x in patch_places(pair.photo, size, per_pair, generator):
            for kind, patches in patches_by_kind.items():
                patches.append(getattr(pair, kind)[:, y : y + size, x : x + size])
            view.append(views.setdefault((pair.scene, pair.view), len(views)))
    if not view:
        raise InputError("pairs", "have no patch that shows anything", "give renders of textured views")
    stacked = {kind: torch.stack(patches) for kind, patches in patches_by_kind.items()}
    return Patches(**stacked, view=torch.tensor(view), views=tuple(views))


def _spread(patch: UInt8[Tensor, "3 s s"]) -> float:
    """Largest standard deviation of a channel."""
    return patch.float().flatten(1).std(dim=1).max().item()
