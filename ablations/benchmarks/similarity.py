"""``gaussian-enhancer similarity``: what a fit's loss costs.

SSIM and L1 with their compiled gradient, against torch's autograd of the same loss. The two run in turn, round after
round; printed are the medians and the median of the ratios of neighbouring runs.
"""

import json

import torch
from omegaconf import DictConfig

from gaussian_enhancer.files import write_text
from gaussian_enhancer.loss.terms import dssim
from gaussian_enhancer.metrics.cost import timed
from gaussian_enhancer.metrics.provenance import this_commit, this_machine
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.splat.fit.similarity import photometric_loss, prepare


def run(cfg: DictConfig) -> None:
    """Measure, print.

    Args:
        cfg: conf/similarity.yaml, composed.

    Raises:
        InputError: the record cannot be written.
    """
    start(cfg.runtime)
    photo, first = torch.rand(2, 3, cfg.height, cfg.width, generator=torch.Generator().manual_seed(0))
    target = prepare(photo)

    def own() -> None:
        image = first.clone().requires_grad_()
        photometric_loss(image, target).backward()

    def autograd() -> None:
        image = first.clone().requires_grad_()
        unlike = dssim(image[None], photo[None]).mean()
        (0.8 * (image - photo).abs().mean() + 0.2 * unlike).backward()

    times = timed({"own": own, "autograd": autograd}, cfg.rounds)
    record = {
        "size": f"{cfg.height}x{cfg.width}",
        "own_ms": times["own"].milliseconds,
        "autograd_ms": times["autograd"].milliseconds,
        "ratio": times["own"].times_faster(times["autograd"])[0],
        "rounds": cfg.rounds,
        "threads": torch.get_num_threads(),
        "machine": this_machine(),
        "commit": this_commit(),
    }
    print(json.dumps(record, indent=2))
    if cfg.records:
        write_text(cfg.records, json.dumps(record) + "\n")
