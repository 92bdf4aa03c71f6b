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

from gaussian_enhancer.align.alignment import Aligned, Pixels
from gaussian_enhancer.align.exposure import match_exposure
from gaussian_enhancer.align.references import Pool, join, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.change_confidence import BANDS, BLOCK, ChangeConfidence, block_features, split_change
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.scene.renders import read_run, run_steps

LEAST = 1e-5
"""Mean squared error below which a render does not count as better."""
LEAST_OF_BLOCK = 1e-6
"""The same of a block, in which eight bits of colour leave little to lose."""
WORST = 3.0
"""Decibels beyond which the loss of a block does not count more."""
START = 0.75
"""The share that an untrained confidence gives."""
OVERFIT = 0.5
"""Share of the references' errors that a splat of more steps would not have."""
BATCH = 4096
"""Blocks of a step."""
NOISE = 0.4
"""Standard deviation of what is added to features in training, in theirs over all blocks."""


@dataclass(frozen=True)
class JudgedView:
    """Blocks of one enhanced view. Shares s of the bands of the change add s squared s - 2 s helpful to the error.

    Args:
        features: what describes each block (`block_features`).
        squared: mean products of the bands of the change in each block, as shares of the view's mean squared error.
        helpful: mean products of each band and of what the whole change should be, likewise.
        error: mean squared error of the render in each block, likewise.
    """

    features: Float[Tensor, "n f"]
    squared: Float[Tensor, "n k k"]
    helpful: Float[Tensor, "n k"]
    error: Float[Tensor, " n"]

    def added(self, shares: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        """Squared error that shares add to each block, as a share of the view's mean squared error."""
        return torch.einsum("nk,nkl,nl->n", shares, self.squared, shares) - 2 * (shares * self.helpful).sum(1)

    def lost_decibels(self, added: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Decibels that blocks lose by squared error that is added to them, from 0 to `WORST`."""
        return (10 * torch.log10((1 + added / self.error).clamp_min(1))).clamp_max(WORST)

    def select(self, chosen: Int[Tensor, " m"]) -> "JudgedView":
        """Some of the blocks."""
        return JudgedView(*(getattr(self, field.name)[chosen] for field in fields(self)))


def judge_views(folder: Path, enhancer: SetEnhancer) -> Iterator[JudgedView]:
    """Blocks of every held-out view of a fit, at each of its steps, in several variants of its references.

    Photos are brought to the colours of the render first: nothing tells a held-out photo's exposure.

    Args:
        folder: of the fit, with held-out photos.
        enhancer: applies the whole change.

    Raises:
        InputError: a view has no photo, camera or depth.
    """
    for step in run_steps(folder):
        rendered = read_run(folder, step)
        pool = Pool(rendered.references)
        for view in rendered.targets:
            if view.read_photo is None:
                raise InputError(view.name, "has no photo to learn from", "give fits with held-out photos")
            target, photo = read_target(view), view.read_photo()
            aligned = enhancer.reference_config.align(target, view, pool)
            truth = match_exposure(photo, target.image)
            for some in _variants(aligned):
                yield _judge(enhancer, target, some, truth - target.image)


def _variants(aligned: Aligned) -> list[Aligned]:
    """All references, fewer of them, all of a splat that fits them better, and all without the splat's renders of them.

    More steps and Gaussians better a splat's renders of its references, and hardly those of new views. Folders of
    finished renders come without any.
    """
    variants = _with_fewer(aligned)
    if aligned.renders is not None:
        better = torch.lerp(aligned.renders, aligned.references, OVERFIT)
        variants += [replace(aligned, renders=better), replace(aligned, renders=None)]
    return variants


def _with_fewer(aligned: Aligned) -> list[Aligned]:
    """References, and where there are three or more, all but the last and all but the first."""
    parts = [slice(None)] if len(aligned.names) < 3 else [slice(None), slice(None, -1), slice(1, None)]
    return [
        replace(
            aligned,
            references=aligned.references[part],
            visibility=aligned.visibility[part],
            names=aligned.names[part],
            renders=None if aligned.renders is None else aligned.renders[part],
        )
        for part in parts
    ]


def _judge(enhancer: SetEnhancer, target: Pixels, aligned: Aligned, wanted: Float[Tensor, "3 h w"]) -> JudgedView:
    views = join(target, aligned)
    enhanced = enhancer.enhance(views, aligned.names)
    change = enhanced[0] - target.image
    error = float(wanted.square().mean().clamp_min(LEAST))
    of_blocks = _mean_product(wanted, wanted).clamp_min(LEAST_OF_BLOCK)
    features = block_features(enhanced, views)[0].flatten(1).T.contiguous()
    bands = [band[0] for band in split_change(change[None])]
    squared = torch.stack([_mean_product(one, other) for one in bands for other in bands], dim=1)
    helpful = torch.stack([_mean_product(band, wanted) for band in bands], dim=1)
    return JudgedView(features, squared.unflatten(1, (BANDS, BANDS)) / error, helpful / error, of_blocks / error)


def _mean_product(first: Float[Tensor, "3 h w"], second: Float[Tensor, "3 h w"]) -> Float[Tensor, " n"]:
    return F.avg_pool2d((first * second).mean(0)[None, None], BLOCK, ceil_mode=True).flatten()


def train_confidence(
    fits: Sequence[Sequence[JudgedView]],
    hidden: int = 96,
    steps: int = 2000,
    harm: float = 0.5,
    block_harm: float = 0.2,
    seed: int = 0,
) -> ChangeConfidence:
    """Minimise the squared error that blocks are left with, relative to their view's, and the decibels that they lose.

    Squared error is that of the blocks in which a view is worst. Where the render is nearly right, blocks can lose much
    of their quality and hardly add to it: decibels tell that.

    Args:
        fits: what `judge_views` gives, fit by fit; each fit, and each view of a fit, counts as much as another.
        hidden: width of the layers.
        steps: of the optimiser.
        harm: what error that is added to a block counts beside error that is removed, more than 1 time.
        block_harm: weight of a decibel that a block loses (`JudgedView.lost_decibels`), as a share of the view's error.
        seed: of initial values and batches.
    """
    views = [view for fit in fits for view in fit]
    weights = torch.cat([torch.full_like(one.error, 1 / (len(one.error) * len(fit))) for fit in fits for one in fit])
    weights = weights / weights.mean()
    whole = JudgedView(*(torch.cat([getattr(view, field.name) for view in views]) for field in fields(JudgedView)))
    draw = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        confidence = ChangeConfidence(hidden)
        weight, bias = list(confidence.layers[-1].parameters())
        torch.nn.init.zeros_(weight)
        torch.nn.init.constant_(bias, START)
        confidence.centre.copy_(whole.features.mean(0))
        confidence.scale.copy_(whole.features.std(0) + 1e-3)
        optimizer = torch.optim.AdamW(confidence.parameters(), 4e-3, weight_decay=1e-2)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=steps)
        confidence.train()
        for _ in range(steps):
            chosen = torch.randint(len(weights), (BATCH,), generator=draw)
            chosen_views = whole.select(chosen)
            noisy = chosen_views.features + NOISE * confidence.scale * torch.randn_like(chosen_views.features)
            shares = confidence.predict_shares(noisy.T[None, :, None])[0, :, 0].T
            added = chosen_views.added(shares.clamp(-0.2, 1.4))
            cost = added + harm * added.clamp_min(0) + block_harm * chosen_views.lost_decibels(added)
            loss = (weights[chosen] * cost).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return confidence.eval()
