"""``gaussian-enhancer similarity``: run time of the loss of a fit.

SSIM and L1 with their compiled gradient are compared with torch's autograd of the same loss. Both run in turn, round
after round. The job prints the medians and the median of the ratios of neighbouring runs.
"""

from typing import Any

import torch
from omegaconf import DictConfig

from ablations.study.cost import times_faster
from ablations.study.engine import Study, job
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.loss.terms import dssim
from gaussian_enhancer.metrics.cost import time_interleaved
from gaussian_enhancer.splat.fit.similarity import photometric_loss, prepare


def measured(cfg: DictConfig) -> list[dict[str, Any]]:
    """One row: both losses at one size.

    Args:
        cfg: conf/similarity.yaml, composed.
    """
    photo, initial = torch.rand(2, 3, cfg.height, cfg.width, generator=torch.Generator().manual_seed(0))
    target = prepare(photo)

    def own() -> None:
        image = initial.clone().requires_grad_()
        photometric_loss(image, target).backward()

    def autograd() -> None:
        image = initial.clone().requires_grad_()
        dissimilarity = dssim(image[None], photo[None]).mean()
        (0.8 * (image - photo).abs().mean() + 0.2 * dissimilarity).backward()

    times = time_interleaved({"own": own, "autograd": autograd}, cfg.rounds)
    row = {
        "size": f"{cfg.height}x{cfg.width}",
        "own_ms": times["own"].milliseconds,
        "autograd_ms": times["autograd"].milliseconds,
        "ratio": times_faster(times["own"], times["autograd"])[0],
        "rounds": cfg.rounds,
        "threads": torch.get_num_threads(),
    }
    return [row]


def study(cfg: DictConfig, device: torch.device) -> Study[DictConfig]:
    """Both losses in turn."""
    refuse_gpu(device)
    return Study([cfg], measured, ("size",))


run = job(study)
