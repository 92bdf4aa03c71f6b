"""Measures settings in turn on the same views, as records of error against the photo, time and peak memory.

Targets and references are in memory, so times do not include reading. They include everything else: choosing and
aligning references, and the network.
"""

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig, open_dict
from rich.console import Console
from torch import Tensor

from ablations.study.cost import device_description, memory_description, peak_memory, quartiles
from ablations.study.missing import missing_record, reason_of
from ablations.suite.evaluation import StudyCell, compose_checked, fitted_cell
from ablations.tradeoff.methods import Enhance, SettingLoader
from ablations.tradeoff.settings import TradeoffStudy
from ablations.tradeoff.summary import HIGH, LOW, TIME
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.cost import time_interleaved
from gaussian_enhancer.metrics.lpips import PerceptualDistance
from gaussian_enhancer.metrics.pair import PROTOCOL, measure_pair
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.runs.inputs import read_task
from gaussian_enhancer.scene.in_memory import single_target_sets
from gaussian_enhancer.scene.rendered import RenderedSet

KIND = "tradeoff"


@dataclass(frozen=True)
class FirstCall:
    """Results of the first call of a setting on a view.

    Args:
        call: repeats the call.
        image: the enhanced view.
        megabytes: peak memory.
        compile_seconds: seconds of compilation; None if nothing was compiled.
    """

    call: Callable[[], object]
    image: Float[Tensor, "3 _ _"]
    megabytes: float
    compile_seconds: float | None


def study_records(
    cfg: DictConfig,
    study: TradeoffStudy,
    loader: SettingLoader,
    distances: Sequence[PerceptualDistance],
    console: Console,
) -> Iterator[Record]:
    """Measure every setting of a study on every view; a setting that cannot be measured gives a record with the reason.

    Args:
        cfg: conf/tradeoff.yaml, composed.
        study: what is measured.
        loader: loads the settings.
        distances: LPIPS distances.
        console: prints progress.
    """
    weights, missing_weights = _weights(study, loader)
    for cell in study.cells:
        console.print(f"{study.name}: {cell.scene}", highlight=False)
        reasons = dict(missing_weights)
        cell_records: list[Record] = []
        try:
            fit = fitted_cell(cfg, cell)
            enhance = dict(_enhancers(study, loader, weights, fit, reasons))
            for view in held_views(cfg, fit, study):
                first_calls = dict(_first_calls(study, enhance, view, loader.device, reasons))
                cell_records += _view_records(study, cell, fit, view, first_calls, loader.device, distances)
        except InputError as error:
            cell_records, reasons = [], {setting.name: str(error) for setting in study.settings}
        trained_settings = {setting.name for setting in study.settings if setting.train}
        for record in cell_records:
            name = record.variant.removeprefix(f"{study.name}/")
            if name not in reasons:
                train_source = {"train": Path(weights[name]).parent.name} if name in trained_settings else {}
                yield replace(record, sources={"fit": record.run, **train_source})
        for name, reason in reasons.items():
            print_line(console, f"{name} is missing: {reason}")
            yield missing_record(f"{study.name}/{name}", reason, scene=cell.scene, splat=cell.splat)


def held_views(cfg: DictConfig, fit: Path, study: TradeoffStudy) -> tuple[RenderedSet, ...]:
    """Single held-out views of a fit with all references, whose pixels stay in memory after the first read.

    Args:
        cfg: ``runs`` and ``runtime``.
        fit: folder of the fit.
        study: states the number of views, and whether they have photos of 4 times the resolution.
    """
    job = compose_checked("enhance", cfg, ())
    with open_dict(job):
        job.update({"run": str(fit), "earlier_step": None})
    task = read_task(job, "cpu", study.finer)
    if study.finer and task.note:
        raise InputError(fit, task.note, "give scenes with photos of 4 times the resolution")
    return single_target_sets(task.rendered, study.views)


def _weights(study: TradeoffStudy, loader: SettingLoader) -> tuple[dict[str, str], dict[str, str]]:
    """Weights by setting, and the reasons of settings without weights."""
    weights, reasons = {}, {}
    for setting in study.settings:
        try:
            weights[setting.name] = loader.weights(setting)
        except InputError as error:
            reasons[setting.name] = str(error)
    return weights, reasons


def _enhancers(
    study: TradeoffStudy, loader: SettingLoader, weights: Mapping[str, str], fit: Path, reasons: dict[str, str]
) -> Iterator[tuple[str, Enhance]]:
    """Enhancement functions by setting for a fit's views; reasons of failed settings are added to ``reasons``."""
    for setting in study.settings:
        if setting.name not in reasons:
            try:
                yield setting.name, loader.enhance(setting, weights[setting.name], fit)
            except InputError as error:
                reasons[setting.name] = str(error)


def _first_calls(
    study: TradeoffStudy,
    enhance: Mapping[str, Enhance],
    view: RenderedSet,
    device: torch.device,
    reasons: dict[str, str],
) -> Iterator[tuple[str, FirstCall]]:
    """The first call of every setting on a view, as warm-up; reasons of failed settings are added to ``reasons``."""
    compiled = {setting.name for setting in study.settings if setting.compiled}
    for name, enhance_view in enhance.items():
        if name in reasons:
            continue
        call = functools.partial(enhance_view, view)
        images: list[Tensor] = []
        try:
            if study.finer:
                call()  # loads the fine photos, whose memory is not the setting's
            compile_seconds = _compile_seconds(call, device) if name in compiled else None
            peak_bytes = peak_memory(functools.partial(_call_and_store, call, images), device)
            yield name, FirstCall(call, images[0], peak_bytes / 1e6, compile_seconds)
        except Exception as error:
            if name not in compiled:
                raise
            reasons[name] = f"is not compiled: {reason_of(error).splitlines()[0]}"


def _call_and_store(call: Callable[[], Tensor], images: list[Tensor]) -> None:
    images.append(call())


def _compile_seconds(call: Callable[[], object], device: torch.device) -> float:
    """Seconds of compilation: the time of a first call minus that of the second."""
    first, second = time_interleaved({"": call}, repeats=2, warm_up=0, device=device)[""].repeats
    return max(0.0, first - second) / 1e3


def _view_records(
    study: TradeoffStudy,
    cell: StudyCell,
    fit: Path,
    view: RenderedSet,
    first_calls: Mapping[str, FirstCall],
    device: torch.device,
    distances: Sequence[PerceptualDistance],
) -> Iterator[Record]:
    calls = {name: first_call.call for name, first_call in first_calls.items()}
    # Measuring peak memory returned memory to the system: a warm-up round allocates it again, as in long use.
    warm_up = time_interleaved(calls, repeats=1, warm_up=0, device=device)
    rounds = 1e3 * study.seconds / max(1e-6, sum(first_call.milliseconds for first_call in warm_up.values()))
    repeats = max(1, min(study.repeats, int(rounds)))
    times = time_interleaved(calls, repeats, 0, device)
    (target,) = view.targets
    protocol = f"{PROTOCOL}; {device_description(device)}: median and quartiles of {repeats} interleaved repeats "
    protocol += "after a warm-up, views in memory, references chosen and aligned anew; "
    protocol += f"peak memory {memory_description(device)}"
    for name, first_call in first_calls.items():
        read: Callable[[], torch.Tensor] | None = target.read_fine_photo if study.finer else target.read_photo
        if read is None:
            raise InputError(fit, f"has no photo of {target.name}", "fit it again")
        measured = measure_pair(first_call.image, read(), distances)
        size = (first_call.image.shape[-1], first_call.image.shape[-2])
        megapixels = size[0] * size[1] / 1e6
        lower, upper = quartiles(times[name])
        low, middle, high = (value / megapixels for value in (lower, times[name].milliseconds, upper))
        metrics = {**measured.metrics, TIME: middle, LOW: low, HIGH: high, "peak_memory_mb": first_call.megabytes}
        if first_call.compile_seconds is not None:
            metrics["compile_seconds"] = first_call.compile_seconds
        variant = f"{study.name}/{name}"
        yield Record(
            KIND, fit.name, cell.scene, cell.splat, target.name, variant, metrics, measured.reasons, size, protocol
        )
