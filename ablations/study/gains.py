"""Studies of gains: several enhancers compared with the raw renders on the same held-out views of fits."""

from collections.abc import Mapping
from pathlib import Path

import torch
from omegaconf import DictConfig

from ablations.study.engine import Study
from ablations.study.enhanced_views import enhanced_views
from ablations.study.fits import finished_fits, scene_of
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.metrics.lpips import requested_distances
from gaussian_enhancer.scene.renders import read_run

METRICS = ("psnr", "psnr_aligned", "ssim", "lpips_alex")
"""The metrics whose gains are reported."""


def gain_study(enhancers: Mapping[str, SetEnhancer], cfg: DictConfig, device: torch.device) -> Study[Path]:
    """The gain of every metric over the raw render, by enhancer and view of each run's last step.

    Args:
        enhancers: enhancers by their names in the column ``row``.
        cfg: ``runs``, ``every``, ``lpips`` and ``backbones`` as in conf/candidates.yaml.
        device: where LPIPS is measured.

    Raises:
        InputError: a pattern names no finished run.
    """
    distances = requested_distances(cfg.lpips, cfg.backbones, device)

    def measure(run: Path) -> list[dict[str, object]]:
        rows: list[dict[str, object]] = []
        for enhanced in enhanced_views(read_run(run), enhancers, distances, cfg.every):
            for row in enhancers:
                gains = {name: value for name, value in enhanced.gains(row).items() if name in METRICS}
                row_keys = {"row": row, "scene": scene_of(run), "run": run.name, "view": enhanced.view.name}
                rows.append({**row_keys, **gains, "raw_psnr": enhanced.raw.metrics["psnr"]})
        return rows

    return Study(finished_fits(cfg.runs), measure, ("row", "run", "view"))
