"""``gaussian-enhancer tradeoff``: error over run time of every method at several settings, of trainings, of kernels.

Diagrams and the page are made from the records alone. ``enhance budget_ms=`` chooses from the settings that were
measured on validation scenes. Frozen test scenes are refused there (docs/data.md).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from omegaconf import DictConfig
from rich.console import Console

from ablations.report.tradeoff import write_pages
from ablations.report.tradeoff_quality import TradeoffLimits
from ablations.study.engine import Study, job, refuse_narrowed
from ablations.study.pareto import pareto_front
from ablations.suite.evaluation import compose_checked
from ablations.tradeoff.interleaved import study_records
from ablations.tradeoff.methods import SettingLoader
from ablations.tradeoff.numerics import numeric_records
from ablations.tradeoff.settings import TradeoffStudy, read_studies
from ablations.tradeoff.summary import summarise
from ablations.tradeoff.trainings import training_records
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.presets import Preset, write_presets
from gaussian_enhancer.metrics.lpips import requested_distances
from gaussian_enhancer.metrics.records import Record, read_records
from gaussian_enhancer.runs.time_budget import BUDGET_KEYS
from gaussian_enhancer.scene.frozen import refuse_frozen

CONSOLE = Console(stderr=True)
KINDS = ("quality", "training", "numerics")
NARROWING = {"quality": "studies", "training": "training.pattern", "numerics": "numerics.cases"}
"""The option that names what is measured, by kind."""
OFFERING, CHOOSING = "lr", "validation/"
"""The study that `enhance budget_ms=` chooses from, and the scenes on which choices may be based."""


def output_path(cfg: DictConfig) -> Path:
    """The folder of records and diagrams."""
    return Path(cfg.results)


def studies(cfg: DictConfig, device: torch.device) -> list[Study[str]]:
    """One study per kind, whose settings or kernels are timed in turn in one process, and a report on all of them.

    Raises:
        InputError: a name is unknown, a limit is no number, a validation scene is a frozen test scene, or a part alone
            would replace the committed records of all.
    """
    if cfg.kind not in (*KINDS, "all"):
        raise InputError("kind", f"is {cfg.kind!r}", f"choose {', '.join(KINDS)} or all")
    limits = TradeoffLimits(
        _number("tradeoff.within", cfg.tradeoff.within, "dB", "0.1dB"),
        _number("tradeoff.budget_ms", cfg.tradeoff.budget_ms, "ms", "33"),
    )
    compared = read_studies(cfg)
    refuse_frozen_choices(cfg, compared)
    measure_kind = partial(measure, cfg, compared, device)
    kinds = () if cfg.records_only else KINDS if cfg.kind == "all" else (cfg.kind,)
    for kind, narrowing in NARROWING.items():
        if kind in kinds:
            refuse_narrowed("tradeoff", cfg, narrowing, "results", "results=FOLDER markdown=PAGE")
    folder = output_path(cfg)
    measured_studies = [
        Study((kind,), measure_kind, records=folder / f"{kind}.jsonl", replaces_file=True) for kind in kinds
    ]
    return [*measured_studies, Study((), measure_kind, report=lambda: write_report(cfg, compared, limits))]


run = job(studies)


def refuse_frozen_choices(cfg: DictConfig, compared: Sequence[TradeoffStudy]) -> None:
    """Refuse frozen test scenes among the scenes on which choices may be based.

    Raises:
        InputError: there is one.
    """
    for study in compared:
        for cell in study.cells:
            if cell.scene.startswith(CHOOSING):
                scene = compose_checked("fit", cfg, cell.fit).scene
                name = f"{scene.family}_{scene.seed}" if "family" in scene else Path(scene.path).name
                refuse_frozen([f"{scene.get('name') or name}-{cell.splat}"])


def measure(cfg: DictConfig, compared: Sequence[TradeoffStudy], device: torch.device, kind: str) -> Iterator[Record]:
    """The records of a kind, measured now.

    Args:
        cfg: conf/tradeoff.yaml, composed.
        compared: studies of the kind quality.
        device: where networks and kernels run.
        kind: one of `KINDS`.
    """
    CONSOLE.rule(kind, align="left")
    if kind == "training":
        yield from training_records(Path(cfg.runs), cfg.training.pattern, cfg.training.least_steps)
    elif kind == "numerics":
        numerics = int(cfg.numerics.repeats), cfg.numerics.cases
        yield from numeric_records(*numerics, device, CONSOLE, float(cfg.numerics.seconds))
    else:
        distances = requested_distances(cfg.lpips, cfg.backbones, device)
        with TemporaryDirectory() as folder:
            loader = SettingLoader(cfg, device, Path(folder))
            for study in compared:
                yield from study_records(cfg, study, loader, distances, CONSOLE)


def write_report(cfg: DictConfig, compared: Sequence[TradeoffStudy], limits: TradeoffLimits) -> None:
    """Write diagrams, the page, and, on request, the presets.

    Args:
        cfg: conf/tradeoff.yaml, composed.
        compared: studies of the kind quality.
        limits: limits of time and error that the page chooses settings for.

    Raises:
        InputError: a file cannot be read or written.
    """
    folder = output_path(cfg)
    records = {kind: read_records(file) for kind in KINDS if (file := folder / f"{kind}.jsonl").is_file()}
    titles = {study.name: study.title for study in compared}
    paths = list(write_pages(Path(cfg.markdown), folder, records, titles, limits))
    if cfg.settings:
        paths.append(Path(cfg.settings))
        write_presets(paths[-1], choose_presets(compared, records.get("quality", ())))
    for path in paths:
        print_line(CONSOLE, str(path))


def choose_presets(studies: Sequence[TradeoffStudy], records: Iterable[Record]) -> tuple[Preset, ...]:
    """The Pareto front, on validation scenes, of the settings that a budget may choose (`BUDGET_KEYS`).

    Args:
        studies: of conf/curves; presets are taken from `OFFERING`.
        records: of the kind quality.

    Raises:
        InputError: none was measured, or one was measured on a frozen test scene.
    """
    settings = {setting.name: setting for study in studies if study.name == OFFERING for setting in study.settings}
    candidates = []
    for record in records:
        study, _, name = record.variant.partition("/")
        usable = study == OFFERING and name in settings and settings[name].reproducible_by_enhance
        usable = usable and {option.partition("=")[0] for option in settings[name].enhance} <= set(BUDGET_KEYS)
        if usable and record.scene.startswith(CHOOSING):
            refuse_frozen([record.run])
            candidates.append(replace(record, variant=name))
    if not candidates:
        raise InputError("settings", "have no record to be made from", "gaussian-enhancer tradeoff kind=quality")
    source = candidates[0].machine, candidates[0].commit
    presets = []
    for summary in summarise(candidates)[0]:
        setting = settings[summary.name]
        preset = Preset(summary.name, setting.weights, setting.enhance, summary.milliseconds, summary.psnr, *source)
        presets.append(preset)
    front = {point.name for point in pareto_front(preset.point for preset in presets)}
    return tuple(preset for preset in presets if preset.name in front)


def _number(name: str, text: str | float | int, unit: str, example: str) -> float:
    """Parse a number, given with or without its unit; anything else and negative numbers are refused."""
    try:
        value = float(str(text).removesuffix(unit))
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise InputError(name, f"is {text!r}", f"give a number of {unit}, for instance {name}={example}")
    return value
