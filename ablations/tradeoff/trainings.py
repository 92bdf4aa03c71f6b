"""Validation error of trainings over wall-clock time and over samples, from their logs."""

import json
from collections.abc import Iterator
from pathlib import Path

from omegaconf import DictConfig

from ablations.report.dashboard.runs import Curve, read_curves
from ablations.study.missing import missing_record
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.runs.instantiate import plain_values
from gaussian_enhancer.runs.run import digest_of

KIND = "training"
CLOCK = "time/seconds"
"""Column of the log: seconds of all steps so far, including waiting for data, without validations."""

SPREAD = "seconds: the card's minutes, spread evenly over the steps, since this training logged none"


def training_records(runs: Path, pattern: str, least_steps: int) -> Iterator[Record]:
    """One record per validation of every finished training; a training without one has a record with the reason.

    Args:
        runs: folder of the runs.
        pattern: of the trainings' folder names.
        least_steps: shorter trainings are left out as trial runs.

    Raises:
        InputError: an existing log or card cannot be read.
    """
    folders = [path for path in sorted((runs / "train").glob(pattern)) if (path / "config.yaml").is_file()]
    configs = {path: DictConfig(read_configuration(path / "config.yaml")) for path in folders}
    long_trainings = {path: cfg for path, cfg in configs.items() if _steps(cfg) >= least_steps}
    groups: dict[str, set[str]] = {}
    for cfg in long_trainings.values():
        groups.setdefault(str(cfg.label), set()).add(_digest_without_seeds(cfg))
    for path, cfg in long_trainings.items():
        label_is_ambiguous = len(groups[str(cfg.label)]) > 1
        yield from _records(
            path, cfg, f"{cfg.label}, {_digest_without_seeds(cfg)}" if label_is_ambiguous else str(cfg.label)
        )


def _steps(cfg: DictConfig) -> int:
    return int(cfg.trainer.max_steps) if "trainer" in cfg and "label" in cfg else 0


def _digest_without_seeds(cfg: DictConfig) -> str:
    """The digest of a training's configuration without its seeds."""
    values = plain_values(cfg)
    if "loading" in values["data"]:
        values["data"]["loading"].pop("seed", None)
    return digest_of({key: value for key, value in values.items() if key != "seed"})


def _records(folder: Path, cfg: DictConfig, variant: str) -> Iterator[Record]:
    seed, sources = int(cfg.seed), {"train": folder.name}
    log, card = folder / "log" / "metrics.csv", folder / "card.json"
    curves = {curve.name: curve for curve in read_curves(log)} if log.is_file() else {}
    reason = "" if card.is_file() else "is not finished"
    if not reason and "gain/psnr" not in curves:
        reason = "logged no validation"
    if not reason and "loading" not in cfg.data:
        reason = "was trained by an earlier version with an unsupported configuration; train again"
    if reason:
        yield missing_record(variant, reason, run=folder.name, seed=seed, sources=sources)
        return
    minutes = _minutes(card)
    batch, steps = int(cfg.data.loading.batch_size), int(cfg.trainer.max_steps)
    gains, ssim_gains, seconds_by_step = (_points(curves.get(name)) for name in ("gain/psnr", "gain/ssim", CLOCK))
    # A validation between steps is logged with the index of the step before it, the final one with the number of
    # steps. Of two with equal numbers of finished steps, the later one is taken.
    for finished_steps, step in {min(steps, step + 1): step for step in sorted(gains)}.items():
        logged_step = max((logged for logged in seconds_by_step if logged <= step), default=None)
        seconds = 60 * minutes * finished_steps / steps if logged_step is None else seconds_by_step[logged_step]
        metrics: dict[str, float | None] = {
            "gain_psnr": gains[step],
            "samples": float(batch * finished_steps),
            "seconds": seconds,
        }
        if step in ssim_gains:
            metrics["gain_ssim"] = ssim_gains[step]
        protocol = (
            f"gains over the raw render of validation runs; {SPREAD if logged_step is None else 'seconds as logged'}"
        )
        place = (KIND, folder.name, "validation", "", str(int(finished_steps)), variant)
        yield Record(*place, metrics, protocol=protocol, seed=seed, sources=sources)


def _points(curve: Curve | None) -> dict[float, float]:
    """Value by step; the last of several at one step."""
    return {} if curve is None else dict(zip(curve.steps, curve.values, strict=True))


def _minutes(card: Path) -> float:
    try:
        return float(json.loads(card.read_text(encoding="utf-8"))["minutes"])
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(card, f"is no card of a training ({error})", "train again") from error
