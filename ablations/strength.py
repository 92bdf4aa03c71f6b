"""Which share of the network's change to apply: gains and losses on validation runs by strength.

    python ablations/strength.py WEIGHTS RUN [RUN ...] [--lpips FOLDER] [--json FILE]

The change is computed once per view and applied in part, so all strengths are compared on the same images. Runs must be
validation runs (docs/data.md): a strength chosen on test scenes would be worth nothing. `ablations/ship.py` writes the
strength that was chosen on the weights' card, and `gaussian-enhancer enhance` then applies it.
"""

import argparse
import json
import statistics
from pathlib import Path

import torch

from gaussian_enhancer.enhance.enhancer import Enhancer
from gaussian_enhancer.enhance.weights import Pretrained, load_weights
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.measure.pair import measure_pair
from gaussian_enhancer.measure.perceptual import PerceptualDistance, perceptual_distance
from gaussian_enhancer.scene.renders import read_run, run_steps

STRENGTHS = (0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
TOLERATED = {"psnr_aligned": -0.05, "ssim": -0.002, "lpips_alex": 0.005}
"""Losses of a single frame beyond which it counts as made worse."""


def gains(pretrained: Pretrained, run: Path, distances: list[PerceptualDistance]) -> list[dict[str, object]]:
    """Gain of every metric over the raw render, by view of the run's last step and strength."""
    rendered, rows = read_run(run, run_steps(run)[-1]), []
    for enhanced, view in zip(
        Enhancer(pretrained.network, pretrained.preparation)(rendered), rendered.targets, strict=True
    ):
        if view.read is None or view.read_photo is None:
            raise InputError(view.name, "has no photo to compare with", "give runs with held-out photos")
        raw, photo = view.read(), view.read_photo()
        before = measure_pair(raw, photo, distances).metrics
        for strength in STRENGTHS:
            mixed = torch.lerp(raw, enhanced.image, strength)
            after = measure_pair(mixed, photo, distances).metrics
            gain = {k: after[k] - before[k] for k in after if after[k] is not None and before[k] is not None}
            trained = {"weights": pretrained.card.get("run"), "steps": pretrained.card.get("steps")}
            rows.append({**trained, "run": run.name, "view": view.name, "strength": strength, **gain})
    return rows


def table(rows: list[dict], strengths: tuple[float, ...] = STRENGTHS) -> str:
    """Mean gains, the worst colour-aligned frame and the number of frames made worse, by strength."""
    metrics = [k for k in rows[0] if k not in ("weights", "steps", "run", "view", "strength")]
    lines = [
        "| strength | " + " | ".join(metrics) + " | worst psnr_aligned | frames made worse |",
        "|---" * (len(metrics) + 3) + "|",
    ]
    for strength in strengths:
        chosen = [row for row in rows if row["strength"] == strength]
        means = [f"{statistics.fmean(row[m] for row in chosen):+.4f}" for m in metrics]
        worse = sum(is_worse(row) for row in chosen)
        worst = min(row["psnr_aligned"] for row in chosen)
        lines.append(f"| {strength} | " + " | ".join(means) + f" | {worst:+.3f} | {worse} of {len(chosen)} |")
    return "\n".join(lines)


def is_worse(row: dict) -> bool:
    """Whether a frame loses more than is tolerated in any metric."""
    return any(
        row[metric] > limit if metric.startswith("lpips") else row[metric] < limit
        for metric, limit in TOLERATED.items()
        if metric in row
    )


def main() -> None:
    """Read the command line, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--lpips", type=Path, help="folder of LPIPS backbones")
    parser.add_argument("--json", type=Path, help="write every row there")
    options = parser.parse_args()
    torch.set_flush_denormal(True)
    pretrained = load_weights(options.weights)
    distances = [perceptual_distance("lpips_alex", options.lpips, torch.device("cpu"))] if options.lpips else []
    rows = [row for run in options.runs for row in gains(pretrained, run, distances)]
    print(table(rows))
    if options.json:
        options.json.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


if __name__ == "__main__":
    main()
