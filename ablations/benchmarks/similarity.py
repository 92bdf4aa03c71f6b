"""What a fit's loss costs: SSIM and L1 with their compiled gradient against torch's autograd of the same loss.

    python -m ablations.benchmarks.similarity --size 270x480 --json similarity.json

The two run in turn, round after round; printed are the medians and the median of the ratios of neighbouring runs.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import gaussian_enhancer  # noqa: F401  # isort: skip  # before torch: it settles how idle OpenMP threads wait
import torch

from gaussian_enhancer.loss.terms import dssim
from gaussian_enhancer.metrics.provenance import this_commit, this_machine
from gaussian_enhancer.splat.fit.similarity import photometric_loss, prepare


def milliseconds(call: Callable[[], None]) -> float:
    """Wall time of one call."""
    begun = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - begun)


def main() -> None:
    """Read the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="270x480", help="HEIGHTxWIDTH")
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    height, width = (int(side) for side in options.size.split("x"))
    photo, start = torch.rand(2, 3, height, width, generator=torch.Generator().manual_seed(0))
    target = prepare(photo)

    def own() -> None:
        image = start.clone().requires_grad_()
        photometric_loss(image, target).backward()

    def autograd() -> None:
        image = start.clone().requires_grad_()
        unlike = dssim(image[None], photo[None]).mean()
        (0.8 * (image - photo).abs().mean() + 0.2 * unlike).backward()

    for call in (own, autograd, own, autograd):
        call()
    pairs = [(milliseconds(own), milliseconds(autograd)) for _ in range(options.rounds)]
    record = {
        "size": options.size,
        "own_ms": statistics.median(a for a, _ in pairs),
        "autograd_ms": statistics.median(b for _, b in pairs),
        "ratio": statistics.median(b / a for a, b in pairs),
        "rounds": options.rounds,
        "threads": torch.get_num_threads(),
        "machine": this_machine(),
        "commit": this_commit(),
    }
    print(json.dumps(record, indent=2))
    if options.json:
        options.json.write_text(json.dumps(record) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
