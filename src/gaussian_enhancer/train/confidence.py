"""Training of a change confidence on the held-out views of finished fits.

Axes: f features, n blocks, k bands, h height, w width.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from gaussian_enhancer.align.alignment import AlignedReferences, LoadedView
from gaussian_enhancer.align.exposure import match_exposure
from gaussian_enhancer.align.references import ReferencePool, build_network_input, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.change_confidence import BANDS, BLOCK, ChangeConfidence, block_features, split_change
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.scene.renders import read_run, run_steps

MIN_ERROR = 1e-5
"""Lower limit of a view's mean squared error where it is a divisor."""
MIN_BLOCK_ERROR = 1e-6
"""Lower limit of a block's mean squared error: 8-bit colours leave little to lose below it."""
MAX_LOSS_DB = 3.0
"""Upper limit of the loss of a block, in dB."""
INITIAL_SHARE = 0.75
"""Share that the confidence predicts before training."""
OVERFIT_SHARE = 0.5
"""Share of the references' errors that a splat of more steps is assumed not to have."""
BATCH = 4096
"""Blocks per training step."""
NOISE = 0.4
"""Standard deviation of the noise added to each feature in training, in units of the feature's own over all blocks."""


@dataclass(frozen=True)
class ViewBlocks:
    """Blocks of one enhanced view.

    Applying shares s of the bands of the change adds s^T squared s - 2 s^T helpful to the squared error. All errors
    and products are divided by the view's mean squared error.

    Args:
        features: features of each block (`block_features`).
        squared: mean products of every two bands of the change in each block.
        helpful: mean product of each band and the ideal change (photo - render) in each block.
        error: mean squared error of the render in each block.
    """

    features: Float[Tensor, "n f"]
    squared: Float[Tensor, "n k k"]
    helpful: Float[Tensor, "n k"]
    error: Float[Tensor, " n"]

    def added_error(self, shares: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        """Squared error that the shares add to each block, divided by the view's mean squared error."""
        return torch.einsum("nk,nkl,nl->n", shares, self.squared, shares) - 2 * (shares * self.helpful).sum(1)

    def lost_decibels(self, added_error: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Loss of each block in dB due to added squared error, from 0 to `MAX_LOSS_DB`."""
        return (10 * torch.log10((1 + added_error / self.error).clamp_min(1))).clamp_max(MAX_LOSS_DB)

    def select(self, block_indices: Int[Tensor, " m"]) -> "ViewBlocks":
        """The blocks with these indices."""
        return ViewBlocks(*(getattr(self, field.name)[block_indices] for field in fields(self)))


def measure_views(folder: Path, enhancer: SetEnhancer) -> Iterator[ViewBlocks]:
    """Blocks of every held-out view of a fit, at each of its steps, with several variants of the references.

    Each held-out photo is first matched to the exposure of its render, because no input tells the photo's exposure.

    Args:
        folder: folder of the fit, with held-out photos.
        enhancer: enhancer that applies the whole change.

    Raises:
        InputError: a view has no photo, camera or depth.
    """
    for step in run_steps(folder):
        rendered = read_run(folder, step)
        pool = ReferencePool(rendered.references)
        for view in rendered.targets:
            if view.read_photo is None:
                raise InputError(view.name, "has no ground-truth photo", "give fits with held-out photos")
            target, photo = read_target(view), view.read_photo()
            aligned = enhancer.reference_config.align(target, view, pool)
            matched_photo = match_exposure(photo, target.image)
            for variant in _variants(aligned):
                yield _measure_blocks(enhancer, target, variant, matched_photo - target.image)


def _variants(aligned: AlignedReferences) -> list[AlignedReferences]:
    """All references, fewer of them, all with better renders of their views, and all without these renders.

    Better renders imitate a splat of more steps and Gaussians, which improves the renders of its training views but
    hardly those of new views. Folders of finished renders have no renders of the references' views.
    """
    variants = _with_fewer(aligned)
    if aligned.renders is not None:
        better_renders = torch.lerp(aligned.renders, aligned.references, OVERFIT_SHARE)
        variants += [replace(aligned, renders=better_renders), replace(aligned, renders=None)]
    return variants


def _with_fewer(aligned: AlignedReferences) -> list[AlignedReferences]:
    """All references, and with three or more also all but the last, and all but the first."""
    selections = [slice(None)] if len(aligned.names) < 3 else [slice(None), slice(None, -1), slice(1, None)]
    return [
        replace(
            aligned,
            references=aligned.references[selection],
            visibility=aligned.visibility[selection],
            names=aligned.names[selection],
            renders=None if aligned.renders is None else aligned.renders[selection],
        )
        for selection in selections
    ]


def _measure_blocks(
    enhancer: SetEnhancer, target: LoadedView, aligned: AlignedReferences, ideal_change: Float[Tensor, "3 h w"]
) -> ViewBlocks:
    """Blocks of one view, enhanced with these references; the ideal change is photo - render."""
    views = build_network_input(target, aligned)
    enhanced = enhancer.enhance(views, aligned.names)
    change = enhanced[0] - target.image
    error = float(ideal_change.square().mean().clamp_min(MIN_ERROR))
    block_error = _mean_product(ideal_change, ideal_change).clamp_min(MIN_BLOCK_ERROR)
    features = block_features(enhanced, views)[0].flatten(1).T.contiguous()
    bands = [band[0] for band in split_change(change[None])]
    squared = torch.stack([_mean_product(first, second) for first in bands for second in bands], dim=1)
    helpful = torch.stack([_mean_product(band, ideal_change) for band in bands], dim=1)
    return ViewBlocks(features, squared.unflatten(1, (BANDS, BANDS)) / error, helpful / error, block_error / error)


def _mean_product(first: Float[Tensor, "3 h w"], second: Float[Tensor, "3 h w"]) -> Float[Tensor, " n"]:
    """Mean over the pixels and channels of each block of the product of two images."""
    return F.avg_pool2d((first * second).mean(0)[None, None], BLOCK, ceil_mode=True).flatten()


def train_confidence(
    fits: Sequence[Sequence[ViewBlocks]],
    hidden: int = 96,
    steps: int = 2000,
    harm: float = 0.5,
    block_harm: float = 0.2,
    seed: int = 0,
) -> ChangeConfidence:
    """Train a confidence to minimise each block's squared error, relative to its view's, and its loss in dB.

    Squared error is dominated by the blocks in which a view is worst. Where the render is nearly right, a block can
    lose much of its quality and add hardly any squared error; the loss in dB covers this case.

    Args:
        fits: for each fit, the blocks of its views (`measure_views`). Fits have equal weight, and so have the views of
            a fit.
        hidden: width of the hidden layers.
        steps: steps of the optimiser.
        harm: extra weight of added error: error added to a block counts 1 + ``harm`` times, error removed once.
        block_harm: weight of each dB that a block loses (`ViewBlocks.lost_decibels`), relative to the view's mean
            squared error.
        seed: seed of initial weights, batches and noise.
    """
    views = [view for fit in fits for view in fit]
    weights = torch.cat([torch.full_like(view.error, 1 / (len(view.error) * len(fit))) for fit in fits for view in fit])
    weights = weights / weights.mean()
    blocks = ViewBlocks(*(torch.cat([getattr(view, field.name) for view in views]) for field in fields(ViewBlocks)))
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        confidence = ChangeConfidence(hidden)
        weight, bias = list(confidence.layers[-1].parameters())
        torch.nn.init.zeros_(weight)
        torch.nn.init.constant_(bias, INITIAL_SHARE)
        confidence.centre.copy_(blocks.features.mean(0))
        confidence.scale.copy_(blocks.features.std(0) + 1e-3)
        optimizer = torch.optim.AdamW(confidence.parameters(), 4e-3, weight_decay=1e-2)
        scheduler = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=steps)
        confidence.train()
        for _ in range(steps):
            indices = torch.randint(len(weights), (BATCH,), generator=generator)
            batch = blocks.select(indices)
            noisy_features = batch.features + NOISE * confidence.scale * torch.randn_like(batch.features)
            shares = confidence.predict_shares(noisy_features.T[None, :, None])[0, :, 0].T
            added = batch.added_error(shares.clamp(-0.2, 1.4))
            cost = added + harm * added.clamp_min(0) + block_harm * batch.lost_decibels(added)
            loss = (weights[indices] * cost).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            scheduler.step()
    return confidence.eval()
