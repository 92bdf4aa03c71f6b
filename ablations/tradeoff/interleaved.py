"""Settings measured in turn on the same views: error against the photo, time, peak memory, as records.

Nothing is read while time is taken: targets and references are in memory, and what is timed is the whole of the rest,
choosing and aligning references and the network.
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

from ablations.suite.evaluation import StudyCell, composed, fitted_cell
from ablations.tradeoff.methods import Enhance, SettingLoader
from ablations.tradeoff.settings import TradeoffStudy
from ablations.tradeoff.summary import HIGH, LOW, TIME
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError, reason_of
from gaussian_enhancer.metrics.cost import peak_memory, timed
from gaussian_enhancer.metrics.lpips import PerceptualDistance
from gaussian_enhancer.metrics.pair import PROTOCOL, measure_pair
from gaussian_enhancer.metrics.records import Record, missing_record
from gaussian_enhancer.runs.inputs import read_task
from gaussian_enhancer.scene.in_memory import single
from gaussian_enhancer.scene.rendered import RenderedSet

KIND = "tradeoff"


@dataclass(frozen=True)
class FirstCall:
    """What the first call of a setting on a view gave.

    Args:
        call: the same again.
        image: the enhanced view.
        megabytes: peak memory.
        compiling: seconds that compilation took; None where nothing was compiled.
    """

    call: Callable[[], object]
    image: Float[Tensor, "3 _ _"]
    megabytes: float
    compiling: float | None


def study_records(
    cfg: DictConfig,
    study: TradeoffStudy,
    ready: SettingLoader,
    distances: Sequence[PerceptualDistance],
    console: Console,
) -> Iterator[Record]:
    """The records of a study, every setting on every view; one that cannot be measured leaves a record that says why.

    Args:
        cfg: conf/tradeoff.yaml, composed.
        study: what is measured.
        ready: makes settings ready.
        distances: LPIPS distances.
        console: is told what is measured.
    """
    weights, absent = _weights(study, ready)
    for cell in study.cells:
        console.print(f"{study.name}: {cell.scene}", highlight=False)
        reasons = dict(absent)
        found: list[Record] = []
        try:
            fit = fitted_cell(cfg, cell)
            enhance = dict(_enhancers(study, ready, weights, fit, reasons))
            for view in held_views(cfg, fit, study):
                firsts = dict(_firsts(study, enhance, view, ready.device, reasons))
                found += _measured(study, cell, fit, view, firsts, ready.device, distances)
        except InputError as error:
            found, reasons = [], {one.name: str(error) for one in study.settings}
        trained = {one.name for one in study.settings if one.train}
        for record in found:
            name = record.variant.removeprefix(f"{study.name}/")
            if name not in reasons:
                train = {"train": Path(weights[name]).parent.name} if name in trained else {}
                yield replace(record, sources={"fit": record.run, **train})
        for name, reason in reasons.items():
            print_line(console, f"{name} is missing: {reason}")
            yield missing_record(f"{study.name}/{name}", reason, scene=cell.scene, splat=cell.splat)


def held_views(cfg: DictConfig, fit: Path, study: TradeoffStudy) -> tuple[RenderedSet, ...]:
    """Single views of a fit with all its references, whose pixels stay in memory once they were read.

    Args:
        cfg: ``runs`` and ``runtime``.
        fit: folder of the fit.
        study: says how many views, and whether photos 4 times as fine belong to them.
    """
    job = composed("enhance", cfg, ())
    with open_dict(job):
        job.run = str(fit)
    task = read_task(job, "cpu", study.finer)
    if study.finer and task.note:
        raise InputError(fit, task.note, "give scenes whose finer photos are known")
    return single(task.rendered, study.views)


def _weights(study: TradeoffStudy, ready: SettingLoader) -> tuple[dict[str, str], dict[str, str]]:
    """Weights by setting, and why others have none."""
    found, absent = {}, {}
    for setting in study.settings:
        try:
            found[setting.name] = ready.weights(setting)
        except InputError as error:
            absent[setting.name] = str(error)
    return found, absent


def _enhancers(
    study: TradeoffStudy, ready: SettingLoader, weights: Mapping[str, str], fit: Path, reasons: dict[str, str]
) -> Iterator[tuple[str, Enhance]]:
    """Settings that are not missing, ready for a fit's views; reasons of those that cannot be are added."""
    for setting in study.settings:
        if setting.name not in reasons:
            try:
                yield setting.name, ready.enhance(setting, weights[setting.name], fit)
            except InputError as error:
                reasons[setting.name] = str(error)


def _firsts(
    study: TradeoffStudy,
    enhance: Mapping[str, Enhance],
    view: RenderedSet,
    device: torch.device,
    reasons: dict[str, str],
) -> Iterator[tuple[str, FirstCall]]:
    """The first call of every setting on a view, which warms it up; reasons of those that fail are added."""
    compiled = {setting.name for setting in study.settings if setting.compiled}
    for name, one in enhance.items():
        if name in reasons:
            continue
        call = functools.partial(one, view)
        images: list[Tensor] = []
        try:
            if study.finer:
                call()  # draws photos, whose memory is not the setting's
            compiling = _compiling(call, device) if name in compiled else None
            peak = peak_memory(functools.partial(_kept, call, images), device)
            yield name, FirstCall(call, images[0], peak / 1e6, compiling)
        except Exception as error:
            if name not in compiled:
                raise
            reasons[name] = f"is not compiled: {reason_of(error).splitlines()[0]}"


def _kept(call: Callable[[], Tensor], images: list[Tensor]) -> None:
    images.append(call())


def _compiling(call: Callable[[], object], device: torch.device) -> float:
    """Seconds that a call takes beyond the next one."""
    first, second = timed({"": call}, repeats=2, warm_up=0, device=device)[""].repeats
    return max(0.0, first - second) / 1e3


def _measured(
    study: TradeoffStudy,
    cell: StudyCell,
    fit: Path,
    view: RenderedSet,
    firsts: Mapping[str, FirstCall],
    device: torch.device,
    distances: Sequence[PerceptualDistance],
) -> Iterator[Record]:
    calls = {name: one.call for name, one in firsts.items()}
    # Measuring memory has given it back to the system: a round in turn takes it anew, as long use would have it.
    warm = timed(calls, repeats=1, warm_up=0, device=device)
    rounds = 1e3 * study.seconds / max(1e-6, sum(one.milliseconds for one in warm.values()))
    repeats = max(1, min(study.repeats, int(rounds)))
    times = timed(calls, repeats, 0, device)
    (target,) = view.targets
    device_label = "GPU" if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads"
    memory = "allocated on the device" if device.type == "cuda" else "of the whole process"
    protocol = f"{PROTOCOL}; {device_label}: median and quartiles of {repeats} interleaved repeats after a warm-up, "
    protocol += f"views in memory, references chosen and aligned anew; peak memory {memory}"
    for name, one in firsts.items():
        read: Callable[[], torch.Tensor] | None = target.read_fine_photo if study.finer else target.read_photo
        if read is None:
            raise InputError(fit, f"has no photo of {target.name}", "fit it again")
        found = measure_pair(one.image, read(), distances)
        size = (one.image.shape[-1], one.image.shape[-2])
        megapixels = size[0] * size[1] / 1e6
        ends = times[name].quartiles
        low, middle, high = (value / megapixels for value in (ends[0], times[name].milliseconds, ends[1]))
        metrics = {**found.metrics, TIME: middle, LOW: low, HIGH: high, "peak_memory_mb": one.megabytes}
        if one.compiling is not None:
            metrics["compile_seconds"] = one.compiling
        variant = f"{study.name}/{name}"
        yield Record(
            KIND, fit.name, cell.scene, cell.splat, target.name, variant, metrics, found.reasons, size, protocol
        )
