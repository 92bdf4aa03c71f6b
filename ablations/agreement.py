"""How far a reference may differ from the render: gains on validation runs by the limit of `Reprojected.agreement`.

    python ablations/agreement.py WEIGHTS RUN [RUN ...] [--views N] [--json FILE]

Runs must be validation runs (docs/data.md). Each run counts by N of its held-out views, evenly spread.
"""

import argparse
import json
import statistics
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch

from gaussian_enhancer.enhance.enhancer import Enhancer
from gaussian_enhancer.enhance.weights import Pretrained, load_weights
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.measure.pair import measure_pair
from gaussian_enhancer.scene.renders import read_run

LIMITS = (None, 0.3, 0.2, 0.15, 0.1)
METRICS = ("psnr", "psnr_aligned", "ssim")


def gains(pretrained: Pretrained, run: Path, views: int) -> Iterator[dict[str, object]]:
    """Gain of every metric over the raw render, by view and limit."""
    rendered = read_run(run)
    rendered = replace(rendered, targets=rendered.targets[:: max(1, len(rendered.targets) // views)][:views])
    for limit in LIMITS:
        warp = replace(pretrained.preparation.warp, agreement=limit)
        enhancer = Enhancer(pretrained.network, replace(pretrained.preparation, warp=warp))
        for enhanced, view in zip(enhancer(rendered), rendered.targets, strict=True):
            if view.read is None or view.read_photo is None:
                raise InputError(view.name, "has no photo to compare with", "give runs with held-out photos")
            before, after = (measure_pair(image, view.read_photo()).metrics for image in (view.read(), enhanced.image))
            gain = {name: (after[name] or 0.0) - (before[name] or 0.0) for name in METRICS}
            yield {"run": run.name, "view": view.name, "agreement": limit, **gain}


def main() -> None:
    """Read the command line, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--views", type=int, default=4, help="of each run")
    parser.add_argument("--json", type=Path, help="write every row there")
    options = parser.parse_args()
    torch.set_flush_denormal(True)
    pretrained = load_weights(options.weights)
    rows = [row for run in options.runs for row in gains(pretrained, run, options.views)]
    print("| agreement | " + " | ".join(METRICS) + " |\n" + "|---" * (len(METRICS) + 1) + "|")
    for limit in LIMITS:
        own = [row for row in rows if row["agreement"] == limit]
        means = (f"{statistics.fmean(float(str(row[metric])) for row in own):+.4f}" for metric in METRICS)
        print(f"| {limit} | " + " | ".join(means) + " |")
    if options.json:
        options.json.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


if __name__ == "__main__":
    main()
