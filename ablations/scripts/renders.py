"""``gaussian-enhancer renders``: which training renders make the better enhancer.

Gains of the rows of conf/ablation/renders on the same views.
Rows are trained by ``gaussian-enhancer train -m +recipe=renders +ablation/renders=real,naive,...``; this enhances the
held-out views of the runs' last steps with each row's weights, at full strength, and measures the gain over the raw
render. The default is decided on validation runs; test runs are reported (docs/data.md).
"""

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig

from ablations.realism.realism import finished_fits, scene_of
from ablations.study.enhanced_views import enhanced_views
from ablations.study.markdown import frame, markdown
from ablations.study.sample import ScoreSample
from ablations.study.statistics import interval
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json_lines
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.metrics.lpips import PerceptualDistance, asked_distances
from gaussian_enhancer.metrics.provenance import provenance
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.renders import read_run

METRICS = ("psnr", "psnr_aligned", "ssim", "lpips_alex")


def trained(row: str, runs: Path) -> Path:
    """The weights of a row; the one finished training with its label.

    Raises:
        InputError: there is none, or more than one.
    """
    found = sorted(folder for folder in (runs / "train").glob(f"renders_{row}-*") if (folder / "done").is_file())
    if len(found) != 1:
        remedy = f"run: gaussian-enhancer train +recipe=renders +ablation/renders={row}"
        raise InputError(f"row {row}", f"has {len(found)} finished trainings", remedy)
    return found[0] / "weights.safetensors"


def enhancers(rows: Sequence[str], runs: Path, device: torch.device | None = None) -> dict[str, SetEnhancer]:
    """The rows' networks, at full strength.

    Raises:
        InputError: rows were trained with different preparations, so that their views could not be shared.
    """
    loaded = {row: load_weights(trained(row, runs)) for row in rows}
    configs = [one.reference_config for one in loaded.values()]
    if any(config != configs[0] for config in configs):
        raise InputError("rows", "prepare their references differently", "train them with the same recipe")
    return {row: SetEnhancer(one.network, one.reference_config, device) for row, one in loaded.items()}


def gains(
    made: Mapping[str, SetEnhancer], run: Path, distances: list[PerceptualDistance], every: int = 1
) -> list[dict[str, object]]:
    """Gain of every metric over the raw render, by every n-th view of the run's last step and row."""
    found: list[dict[str, object]] = []
    for one in enhanced_views(read_run(run), made, distances, every):
        for row in made:
            gain = {name: value for name, value in one.gains(row).items() if name in METRICS}
            where: dict[str, object] = {"row": row, "scene": scene_of(run), "run": run.name, "view": one.view.name}
            found.append({**where, **gain, "raw_psnr": one.raw.metrics["psnr"]})
    return found


def measured(made: Mapping[str, SetEnhancer], cfg: DictConfig, device: torch.device) -> list[dict]:
    """`gains` of every finished run with where and when they were measured; the file is written again after each run.

    Args:
        made: the rows.
        cfg: ``runs``, ``every``, ``lpips``, ``backbones`` and ``records`` as in conf/renders.yaml.
        device: where LPIPS is measured.

    Raises:
        InputError: a pattern names no finished run, or the records cannot be written.
    """
    distances = asked_distances(cfg.lpips, cfg.backbones, device)
    rows: list[dict] = []
    for fit in finished_fits(cfg.runs):
        where = provenance(timed=True)
        rows += [{**found, **where} for found in gains(made, fit, distances, cfg.every)]
        if cfg.records:
            write_json_lines(cfg.records, rows)
    return rows


def table(rows: list[dict], head: str = "training renders") -> str:
    """Mean gains by row over all views, the colour-aligned one with its interval and worst view, then that by scene."""
    names, scenes = list(dict.fromkeys(r["row"] for r in rows)), sorted({r["scene"] for r in rows})
    metrics = [name for name in METRICS if name in rows[0]]
    heads = [head, *metrics, "95% of psnr_aligned", "worst view", "views worse", *scenes]
    lines: list[list[str]] = []
    for name in names:
        mine = [r for r in rows if r["row"] == name]
        aligned = [r["psnr_aligned"] for r in mine]
        views = {f"{r['run']} {r['view']}": r["psnr_aligned"] for r in mine}
        low, high = interval(ScoreSample((("all", "all"),), (None,), {(("all", "all"), None): views}))
        worse = sum(value < 0 for value in aligned)
        means = [f"{statistics.fmean(r[m] for r in mine):+.4f}" for m in metrics]
        by_scene = [f"{statistics.fmean(r['psnr_aligned'] for r in mine if r['scene'] == s):+.3f}" for s in scenes]
        between = "too few views" if math.isnan(low) else f"{low:+.3f} to {high:+.3f}"
        spread = [between, f"{min(aligned):+.3f}", f"{worse} of {len(mine)}"]
        lines.append([name, *means, *spread, *by_scene])
    return markdown(frame(heads, lines))


def run(cfg: DictConfig) -> None:
    """Enhance, measure, print.

    Args:
        cfg: conf/renders.yaml, composed.

    Raises:
        InputError: a row was not trained, runs cannot be compared, or the records cannot be written.
    """
    require(cfg)
    device = start(cfg.runtime)
    print(table(measured(enhancers(cfg.rows, Path(cfg.folder), device), cfg, device)), end="")
