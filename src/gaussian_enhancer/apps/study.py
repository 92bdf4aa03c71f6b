"""``gaussian-enhancer study``: scenes x methods, each fitted, enhanced and measured, on one page of tables."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.apps.pipeline import enhanced, fitted, job_configuration, measured
from gaussian_enhancer.apps.run import write_text
from gaussian_enhancer.measure.compare import Pair, compare, gain_table, paired, view_table
from gaussian_enhancer.measure.records import HIGHER_IS_BETTER, Record, write_records

METRICS = ("psnr", "psnr_aligned", "ssim", "lpips_alex")


def run(cfg: DictConfig) -> float:
    """Run the study; what was done before is found again.

    Args:
        cfg: see ``conf/study.yaml``.

    Returns:
        Mean gain in colour-aligned PSNR over all views, dB.
    """
    console = Console(stderr=True)
    records: list[Record] = []
    for scene in cfg.scenes:
        for splat in cfg.splats:
            console.rule(f"{scene}, {splat}", align="left")
            records += _cell(cfg, scene, splat)
    pairs = paired(records)
    page = Path(cfg.page)
    write_text(page, _page(cfg, records, pairs))
    write_records(page.with_suffix(".jsonl"), records)
    console.print(f"{page}, {page.with_suffix('.jsonl')}", highlight=False, soft_wrap=True)
    return compare(pairs, "psnr_aligned").gain


def _cell(cfg: DictConfig, scene: str, splat: str) -> tuple[Record, ...]:
    """Fit, enhance and measure one scene by one method."""
    fit_folder = fitted(job_configuration("fit", cfg, [f"scene={scene}", f"splat={splat}", *cfg.fit]))
    folder = enhanced(job_configuration("enhance", cfg, cfg.enhance, run=str(fit_folder)))
    return measured(job_configuration("measure", cfg, cfg.measure, run=str(folder)), fit_folder)[0]


def _page(cfg: DictConfig, records: Sequence[Record], pairs: Sequence[Pair]) -> str:
    """The page: what was done, the table of gains, the table of views, where the numbers come from."""
    protocols = sorted({record.protocol for record in records})
    machines = sorted({record.machine for record in records})
    commits = sorted({record.commit for record in records})
    sections = [
        f"# {cfg.title}\n",
        f"{cfg.about}\n".rstrip() + "\n",
        f"Made by `{cfg.command}` from the records in the file beside this page. A gain is enhanced minus raw render: "
        "positive is better for PSNR and SSIM, negative is better for LPIPS. `psnr_aligned` is PSNR after the best "
        "affine colour map, fitted to raw and enhanced images alike.\n",
        "## Gains\n",
        gain_table(pairs, METRICS).markdown(),
        "## Frames made worse\n",
        _harm(pairs, cfg.allowed),
        "## Views\n",
        view_table(pairs, METRICS).markdown(),
        "## Where the numbers come from\n",
        f"- protocol: {'; '.join(protocols)}\n- machine: {'; '.join(machines)}\n- commit: {', '.join(commits)}\n",
    ]
    return "\n".join(sections)


def _harm(pairs: Sequence[Pair], allowed: DictConfig) -> str:
    """Frames that lose more than is allowed, each named, or that there are none."""
    lines = []
    for metric, limit in ((str(key), float(value)) for key, value in allowed.items()):
        gains = [(pair, gain) for pair in pairs if (gain := pair.gain(metric)) is not None]
        sign = 1 if HIGHER_IS_BETTER[metric] else -1
        worse = [(pair.baseline, gain) for pair, gain in gains if sign * gain < -limit]
        named = ", ".join(f"{r.scene} {r.splat} {r.view} ({gain:+.3f})" for r, gain in worse) or "none"
        lines.append(f"- more than {limit} in `{metric}`: {len(worse)} of {len(gains)}: {named}\n")
    return "".join(lines)
