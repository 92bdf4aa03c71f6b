"""Can a classifier tell simulated renders from real ones? A two-sample test on patches.

A small network is trained on patches of some scenes and tested on others. An accuracy of 50% means that it found no
difference; the higher the accuracy, the easier simulated renders are to recognise. After Lopez-Paz and Oquab,
Revisiting classifier two-sample tests, ICLR 2017; here the interval comes from resampling views, since patches of one
view are not independent.
Axes: n places, m patches (simulated and real ones of every place), c channels, s side of a patch.
"""

import copy
import itertools
import statistics
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int64
from scipy import stats
from torch import Tensor, nn
from torch.nn.utils import skip_init

from ablations.realism.patches import Patches
from ablations.study.statistics import expanded_bca
from gaussian_enhancer.errors import InputError


@dataclass(frozen=True)
class TwoSample:
    """How well the classifier separates simulated from real renders of unseen scenes.

    Args:
        accuracy: share of the test patches that were classified correctly; half of the patches are simulated.
        low: lower end of the accuracy's 95% bootstrap interval over test views (`expanded_bca`).
        high: upper end.
        auc: area under the ROC curve: the probability that the classifier rates a simulated patch higher than a real
            one. It does not depend on the threshold, which may differ between scenes.
        n: number of test patches.
        views: number of test views.
        seeds: number of classifiers, over which accuracy and auc are means.
        deviation: standard deviation (ddof 1) of the accuracy over classifiers; None for a single one.
    """

    accuracy: float
    low: float
    high: float
    auc: float
    n: int
    views: int
    seeds: int
    deviation: float | None


class Classifier(nn.Module):
    """Four strided 3x3 convolutions, the mean over all places, one number: positive means simulated.

    Args:
        channels: of the input: 3 for renders, 6 for renders with their photos.
        generator: source of the initial weights.
    """

    def __init__(self, channels: int, generator: torch.Generator) -> None:
        super().__init__()
        widths = (channels, 24, 48, 48, 48)
        layers: list[nn.Module] = []
        for narrow, wide in itertools.pairwise(widths):
            convolution = skip_init(nn.Conv2d, narrow, wide, 3, stride=2, padding=1, bias=False)
            nn.init.kaiming_normal_(convolution.weight, nonlinearity="relu", generator=generator)
            layers += [convolution, nn.BatchNorm2d(wide), nn.ReLU()]
        self.features = nn.Sequential(*layers)
        self.decide = skip_init(nn.Linear, widths[-1], 1)
        nn.init.zeros_(self.decide.weight)
        nn.init.zeros_(self.decide.bias)

    def forward(self, patches: Float[Tensor, "m c s s"]) -> Float[Tensor, " m"]:
        """Evidence that patches, in [-1, 1], are simulated."""
        return self.decide(self.features(patches).mean(dim=(2, 3)))[:, 0]


BATCH = 32
"""Places in a batch; each gives a simulated and a real patch."""
RATE = 2e-3
"""Adam's learning rate."""
PATIENCE = 4
"""Epochs without progress on the held-out share after which training ends."""


def two_sample_test(
    train: Patches, test: Patches, *, conditional: bool = False, seeds: int = 3, epochs: int = 12, first_seed: int = 0
) -> TwoSample:
    """Train classifiers on patches of some scenes and measure them on others.

    A fifth of the training scenes (of their views below four scenes) is held out. The weights with the
    best result on it are kept, and training stops early when the result does not improve.

    Args:
        train: patches to learn from.
        test: patches of other scenes.
        conditional: show the classifier each patch beside its photo, a stricter test, since the change is visible.
        seeds: number of classifiers, each with its own initial weights, order and held-out share.
        epochs: passes over the training patches at most.
        first_seed: seed of the first classifier; the others have the following ones.

    Raises:
        InputError: a scene is in both sets, or the training patches show a single view.
    """
    shared_scenes = set(train.scenes) & set(test.scenes)
    if shared_scenes:
        raise InputError(sorted(shared_scenes)[0], "is a training scene and a test scene", "keep the scenes apart")
    correct, areas = [], []
    for seed in range(first_seed, first_seed + seeds):
        generator = torch.Generator().manual_seed(seed)
        learn, held_out = _split(train, generator)
        network = Classifier(6 if conditional else 3, generator).to(memory_format=torch.channels_last)
        network = _trained(network, learn, held_out, conditional, generator, epochs)
        simulated, real = (_evidence(network, test, kind, conditional) for kind in ("simulated", "real"))
        correct.append(((simulated > 0).float() + (real <= 0).float()) / 2)
        areas.append(area_under_curve(simulated, real))
    by_seed = [seed_correct.mean().item() for seed_correct in correct]
    mean = torch.stack(correct).mean(dim=0)
    low, high = view_interval(mean, test.view)
    deviation = statistics.stdev(by_seed) if seeds > 1 else None
    views = int(test.view.unique().numel())
    return TwoSample(mean.mean().item(), low, high, statistics.fmean(areas), 2 * len(test), views, seeds, deviation)


def view_interval(correct: Float[Tensor, " n"], view: Int64[Tensor, " n"]) -> tuple[float, float]:
    """Bootstrap interval (`expanded_bca`) of a mean over places, with whole views drawn again.

    Below `statistics.MIN_UNITS` views it reaches about as far as the resamples do.

    Args:
        correct: the share of correct answers at each place.
        view: the view that each place belongs to.

    Returns:
        Lower and upper end; the mean itself where all views agree, or there is only one.
    """
    _, number = view.unique(return_inverse=True)
    count = torch.bincount(number).double()
    total = torch.bincount(number, weights=correct.double())
    mean = float(total.sum() / count.sum())
    if len(count) < 2 or bool((total / count == total[0] / count[0]).all()):
        return mean, mean
    totals = torch.stack([total, count], dim=-1).numpy()
    return expanded_bca([np.arange(len(count))], lambda drawn: totals[drawn[0]])


def area_under_curve(positive: Float[Tensor, " n"], negative: Float[Tensor, " n"]) -> float:
    """Area under the ROC curve: the probability that a positive value exceeds a negative one; ties count half.

    It is the statistic of the Mann-Whitney test divided by the number of pairs.
    """
    test = stats.mannwhitneyu(positive.double().numpy(), negative.double().numpy(), method="asymptotic")
    return float(test.statistic) / (len(positive) * len(negative))


def _split(train: Patches, generator: torch.Generator) -> tuple[Patches, Patches]:
    """Split patches for training and for early stopping, without a scene (or a view) in common."""
    group = train.scene if len(train.scenes) >= 4 else train.view
    groups = group.unique()
    if len(groups) < 2:
        raise InputError("training patches", "show a single view", "give renders of more views")
    shuffled = groups[torch.randperm(len(groups), generator=generator)]
    held_out = torch.isin(group, shuffled[: max(1, round(len(groups) / 5))])
    return train[~held_out], train[held_out]


def _trained(
    network: Classifier, learn: Patches, held_out: Patches, conditional: bool, generator: torch.Generator, epochs: int
) -> Classifier:
    optimiser = torch.optim.Adam(network.parameters(), lr=RATE, weight_decay=1e-4)
    best, best_loss, since = copy.deepcopy(network.state_dict()), float("inf"), 0
    for _ in range(epochs):
        network.train()
        for chosen in torch.randperm(len(learn), generator=generator).split(BATCH):
            if len(chosen) < 2:
                continue  # the statistics of one place are no batch
            places = learn[chosen]
            inputs = torch.cat([_inputs(places, kind, conditional) for kind in ("simulated", "real")])
            loss = _loss(_run(network, turned(inputs, generator)))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        evidence = torch.cat([_evidence(network, held_out, kind, conditional) for kind in ("simulated", "real")])
        held_out_loss = _loss(evidence).item()
        since += 1
        if held_out_loss < best_loss:
            best, best_loss, since = copy.deepcopy(network.state_dict()), held_out_loss, 0
        if since >= PATIENCE:
            break
    network.load_state_dict(best)
    return network


def turned(patches: Float[Tensor, "m c s s"], generator: torch.Generator) -> Float[Tensor, "m c s s"]:
    """A batch after one of the square's eight symmetries."""
    quarters, flip = torch.randint(4, (), generator=generator), torch.randint(2, (), generator=generator)
    patches = patches.rot90(int(quarters), dims=(2, 3))
    return patches.flip(3) if flip else patches


def _inputs(places: Patches, kind: str, conditional: bool) -> Float[Tensor, "n c s s"]:
    image = getattr(places, kind).float() / 127.5 - 1
    return torch.cat([image, places.photo.float() / 127.5 - 1], dim=1) if conditional else image


def _run(network: Classifier, inputs: Float[Tensor, "m c s s"]) -> Float[Tensor, " m"]:
    with torch.autocast(inputs.device.type, torch.bfloat16):
        return network(inputs.contiguous(memory_format=torch.channels_last)).float()


def _loss(evidence: Float[Tensor, " m"]) -> Float[Tensor, ""]:
    """Cross entropy of patches whose first half is simulated and whose second half is real."""
    half = len(evidence) // 2
    label = torch.cat([torch.ones(half), torch.zeros(half)]).to(evidence)
    return F.binary_cross_entropy_with_logits(evidence, label)


@torch.no_grad()
def _evidence(network: Classifier, places: Patches, kind: str, conditional: bool) -> Float[Tensor, " n"]:
    network.eval()
    batches = torch.arange(len(places)).split(256)
    return torch.cat([_run(network, _inputs(places[index], kind, conditional)) for index in batches])
