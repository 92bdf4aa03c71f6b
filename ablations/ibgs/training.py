"""Training of the residual network of IBGS on the training views of one fit; no view's own photo is among its sources.

Axes: b batch, h height, w width.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from ablations.ibgs.network import IBGSResidual, ResidualInput
from ablations.ibgs.sources import SourceChoice, Sources, exposure_map, mapped_colours
from gaussian_enhancer.align.references import ReferencePool, read_target
from gaussian_enhancer.checkpoint import build_and_load, parse_metadata, read_checkpoint, write_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.loss.terms import dssim
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.splat.fit.checkpoint import load_checkpoint, save_checkpoint

FORMAT = "gaussian-enhancer ibgs 1"


@dataclass(frozen=True)
class ResidualSettings:
    """How a residual network is trained.

    Args:
        steps: of the optimiser.
        crop: side of the crops, in pixels.
        batch: crops of a step.
        lr: of Adam at the first step; it falls to 0 along half a cosine.
        dissimilarity: weight of 1 - SSIM in the loss; that of the absolute difference is the rest.
        exposure: bring colours to the exposure of the nearest photo before the comparison, as IBGS does when splat and
            network are trained together. A finished fit was fitted without this step.
        save_every: steps between checkpoints.
        seed: of initial values and crops.
    """

    steps: int = 1500
    crop: int = 96
    batch: int = 2
    lr: float = 1e-3
    dissimilarity: float = 0.2
    exposure: bool = False
    save_every: int = 500
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "crop", "batch", "save_every"):
            if getattr(self, name) < 1:
                raise InputError(name, f"is {getattr(self, name)}", "give at least 1")
        if not 0 <= self.dissimilarity <= 1:
            raise InputError("dissimilarity", f"is {self.dissimilarity}", "give a number from 0 to 1")

    def lr_at(self, step: int) -> float:
        """The learning rate of a step."""
        return self.lr * 0.5 * (1 + math.cos(math.pi * step / self.steps))


@dataclass(frozen=True)
class TrainingView:
    """A training view: the network's input and the photo.

    Args:
        inputs: of the network, a batch of one.
        photo: the target of the training.
        exposure: colour map from the render to the nearest other photo.
    """

    inputs: ResidualInput
    photo: Float[Tensor, "3 h w"]
    exposure: Float[Tensor, "3 4"]


def training_views(rendered: RenderedSet, choice: SourceChoice, exposure: bool) -> list[TrainingView]:
    """The training views of a fit, with the other training views as their sources; held-out views are not read.

    Args:
        rendered: the fit's views.
        choice: of the sources.
        exposure: whether colours are brought to the exposure of the nearest photo.

    Raises:
        InputError: a view has no render, photo, camera or depth.
    """
    pool, samples = ReferencePool(rendered.references, capacity=len(rendered.references)), []
    for view in rendered.references:
        if view.read_photo is None:
            raise InputError(view.name, "has no photo", "give fits with their training photos")
        target = read_target(view)
        sources = choice.sources(view, target, pool)
        mapping = applied_exposure(target.image, sources, exposure)
        samples.append(
            TrainingView(ResidualInput.of(target.image, sources, choice.visible), view.read_photo(), mapping)
        )
    return samples


def applied_exposure(render: Float[Tensor, "3 h w"], sources: Sources, exposure: bool) -> Float[Tensor, "3 4"]:
    """The result of `exposure_map`, or the identity if exposure is not matched."""
    return exposure_map(render, sources) if exposure else torch.eye(3, 4)


def train_residual(
    views: Sequence[TrainingView],
    settings: ResidualSettings,
    folder: Path,
    progress: Callable[[int], None] = lambda step: None,
) -> IBGSResidual:
    """Train, or resume from the folder's checkpoint; the result is the same.

    Args:
        views: training views of one fit.
        settings: of the training.
        folder: of the checkpoint.
        progress: called with the number of finished steps.

    Raises:
        InputError: there is no view, or the checkpoint is damaged, of other settings, or cannot be written.
    """
    if not views:
        raise InputError(folder, "has no training views", "give fits with their training views")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        network = IBGSResidual().train()
    optimizer = torch.optim.Adam(network.parameters(), settings.lr)
    identity = json.dumps(asdict(settings), sort_keys=True)
    checkpoint = load_checkpoint(folder, identity)
    if checkpoint is not None:
        network.load_state_dict(checkpoint["network"])
        optimizer.load_state_dict(checkpoint["optimizer"])
    for step in range(checkpoint["step"] if checkpoint is not None else 0, settings.steps):
        for group in optimizer.param_groups:
            group["lr"] = settings.lr_at(step)
        optimizer.zero_grad()
        loss(network, drawn(views, settings, step), settings.dissimilarity).backward()
        optimizer.step()
        if (step + 1) % settings.save_every == 0 and step + 1 < settings.steps:
            state = {"network": network.state_dict(), "optimizer": optimizer.state_dict()}
            save_checkpoint(folder, {"identity": identity, "step": step + 1, **state})
        progress(step + 1)
    return network.eval()


CropBatch = tuple[ResidualInput, Float[Tensor, "b 3 h w"], Float[Tensor, "b 3 4"]]
"""A batch of crops: the network's input, the photos, and the colour map of each crop's view."""


def drawn(views: Sequence[TrainingView], settings: ResidualSettings, step: int) -> CropBatch:
    """Draw the crops of a step; the step's number and the seed determine them.

    Args:
        views: of one fit.
        settings: how many crops, and how large.
        step: of the training.
    """
    generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + step)
    side = min(settings.crop, *(length for view in views for length in view.photo.shape[-2:]))
    inputs, photos, maps = [], [], []
    for _ in range(settings.batch):
        view = views[int(torch.randint(len(views), (), generator=generator))]
        top, left = (int(torch.randint(length - side + 1, (), generator=generator)) for length in view.photo.shape[-2:])
        cut = (..., slice(top, top + side), slice(left, left + side))
        inputs.append({field.name: getattr(view.inputs, field.name)[cut] for field in fields(view.inputs)})
        photos.append(view.photo[cut])
        maps.append(view.exposure)
    batch = ResidualInput(**{name: torch.cat([crop[name] for crop in inputs]) for name in inputs[0]})
    return batch, torch.stack(photos), torch.stack(maps)


def loss(network: IBGSResidual, crops: CropBatch, dissimilarity: float) -> Float[Tensor, ""]:
    """(1 - dissimilarity) mean absolute difference + dissimilarity (1 - SSIM), as in 3DGS and IBGS.

    Args:
        network: in training.
        crops: from `drawn`.
        dissimilarity: weight of the second term.
    """
    inputs, photo, exposure = crops
    image = corrected(network, inputs, exposure)
    difference = (image - photo).abs().mean()
    return (1 - dissimilarity) * difference + dissimilarity * dssim(image, photo).mean()


def corrected(
    network: IBGSResidual, inputs: ResidualInput, exposure: Float[Tensor, "b 3 4"]
) -> Float[Tensor, "b 3 h w"]:
    """Render plus residual, at the exposure of the nearest photo; not clamped.

    Args:
        network: predicts the residual.
        inputs: input of the network.
        exposure: colour maps (`applied_exposure`).
    """
    has_bfloat16 = torch.cpu._is_avx512_bf16_supported()
    with torch.autocast("cpu", torch.bfloat16, enabled=has_bfloat16):
        residual = network(inputs)
    return mapped_colours(inputs.render + residual.float(), exposure)


@dataclass(frozen=True)
class TrainedResidual:
    """Content of a weights file.

    Args:
        network: the trained network.
        fit: folder name of the fit on whose training views it was trained.
        step: of the fit.
        settings: of the training.
        choice: of its sources.
    """

    network: IBGSResidual
    fit: str
    step: int
    settings: ResidualSettings
    choice: SourceChoice

    def save(self, path: Path) -> None:
        """Write it, in half precision.

        Args:
            path: ending in .safetensors.

        Raises:
            InputError: the file cannot be written.
        """
        card = {"fit": self.fit, "step": self.step, "settings": asdict(self.settings), "choice": asdict(self.choice)}
        write_checkpoint(path, self.network.state_dict(), {"format": FORMAT, "card": json.dumps(card)})

    @classmethod
    def load(cls, path: Path) -> "TrainedResidual":
        """Read it.

        Raises:
            InputError: the file is damaged or holds something else.
        """
        values, metadata = read_checkpoint(path, FORMAT)
        card: dict[str, Any] = parse_metadata(metadata, "card", path)
        network = build_and_load(IBGSResidual, {}, values, path).eval()
        settings, choice = ResidualSettings(**card["settings"]), SourceChoice(**card["choice"])
        return cls(network, str(card["fit"]), int(card["step"]), settings, choice)
