"""``gaussian-enhancer tradeoff``: error over run time of every method at several settings, of trainings, of kernels.

Records come first, and diagrams and the page from these alone. What was found on validation scenes is what
``enhance budget_ms=`` chooses from.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from omegaconf import DictConfig
from rich.console import Console

from ablations.report.tradeoff import write_pages
from ablations.report.tradeoff_quality import TradeoffLimits
from ablations.tradeoff.interleaved import study_records
from ablations.tradeoff.methods import SettingLoader
from ablations.tradeoff.numerics import numeric_records
from ablations.tradeoff.settings import TradeoffStudy, read_studies
from ablations.tradeoff.trainings import training_records
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.presets import Preset, write_presets
from gaussian_enhancer.metrics.backbones import with_backbones
from gaussian_enhancer.metrics.lpips import asked_distances
from gaussian_enhancer.metrics.records import Record, read_records, write_records
from gaussian_enhancer.metrics.tradeoff import front, summarised
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.runtime import start

KINDS = ("quality", "training", "numerics")
OFFERING, CHOOSING = "lr", "validation/"
"""The study that `enhance budget_ms=` chooses from, and the scenes that choices may be made on."""


def written(cfg: DictConfig) -> Path:
    """The folder of records and diagrams."""
    return Path(cfg.results)


def run(cfg: DictConfig) -> None:
    """Measure, and write records, diagrams and the page.

    Args:
        cfg: conf/tradeoff.yaml, composed.

    Raises:
        InputError: a name is unknown, a limit is no number, or a file cannot be read or written.
    """
    cfg = with_backbones(cfg)
    require(cfg)
    if cfg.kind not in (*KINDS, "all"):
        raise InputError("kind", f"is {cfg.kind!r}", f"choose {', '.join(KINDS)} or all")
    asked = TradeoffLimits(decibels(cfg.tradeoff.within), milliseconds(cfg.tradeoff.budget_ms))
    studies, console, folder = read_studies(cfg), Console(stderr=True), Path(cfg.results)
    for kind in KINDS if cfg.kind == "all" else (cfg.kind,):
        if not cfg.records_only:
            console.rule(kind, align="left")
            write_records(folder / f"{kind}.jsonl", list(measured(cfg, kind, studies, console)))
    records = {kind: read_records(file) for kind in KINDS if (file := folder / f"{kind}.jsonl").is_file()}
    titles = {study.name: study.title for study in studies}
    for path in write_pages(Path(cfg.markdown), folder, records, titles, asked):
        console.print(str(path), highlight=False, soft_wrap=True)
    if cfg.settings:
        write_presets(Path(cfg.settings), offered(studies, records.get("quality", ())))
        console.print(str(cfg.settings), highlight=False, soft_wrap=True)


def measured(cfg: DictConfig, kind: str, studies: tuple[TradeoffStudy, ...], console: Console) -> Iterator[Record]:
    """The records of a kind, measured now.

    Args:
        cfg: conf/tradeoff.yaml, composed.
        kind: one of `KINDS`.
        studies: of the kind quality.
        console: is told what is measured.
    """
    device = start(cfg.runtime)
    if kind == "training":
        yield from training_records(Path(cfg.runs), cfg.training.pattern, cfg.training.least_steps)
    elif kind == "numerics":
        limits = int(cfg.numerics.repeats), cfg.numerics.cases
        yield from numeric_records(*limits, device, console, float(cfg.numerics.seconds))
    else:
        distances = asked_distances(cfg.lpips, cfg.backbones, device)
        with TemporaryDirectory() as folder:
            ready = SettingLoader(cfg, device, Path(folder))
            for study in studies:
                yield from study_records(cfg, study, ready, distances, console)


def offered(studies: Sequence[TradeoffStudy], records: Iterable[Record]) -> tuple[Preset, ...]:
    """The Pareto front of the settings that the job enhance can be asked for, on validation scenes.

    Args:
        studies: of conf/curves; offers are taken from `OFFERING`.
        records: of the kind quality.

    Raises:
        InputError: none was measured.
    """
    settings = {f"{OFFERING}/{own.name}": own for one in studies if one.name == OFFERING for own in one.settings}
    able = {name for name, one in settings.items() if one.can_be_asked_for}
    own = [record for record in records if record.variant in able and record.scene.startswith(CHOOSING)]
    if not own:
        raise InputError("settings", "have no record to be made from", "gaussian-enhancer tradeoff kind=quality")
    presets = []
    for one in summarised(replace(record, variant=record.variant.removeprefix(f"{OFFERING}/")) for record in own)[0]:
        setting = settings[f"{OFFERING}/{one.name}"]
        found = (setting.weights, setting.enhance, one.milliseconds, one.psnr, own[0].machine, own[0].commit)
        presets.append(Preset(one.name, *found))
    kept = {point.name for point in front(offer.point for offer in presets)}
    return tuple(offer for offer in presets if offer.name in kept)


def decibels(asked: str | float | int) -> float:
    """So many decibels, given as a number or with the unit.

    Raises:
        InputError: it is neither, or negative.
    """
    return _number("tradeoff.within", asked, "dB", "0.1dB")


def milliseconds(asked: str | float | int) -> float:
    """So many milliseconds, given as a number or with the unit.

    Raises:
        InputError: it is neither, or negative.
    """
    return _number("tradeoff.budget_ms", asked, "ms", "33")


def _number(name: str, asked: str | float | int, unit: str, example: str) -> float:
    try:
        value = float(str(asked).removesuffix(unit))
    except ValueError:
        value = -1.0
    if not 0 <= value < float("inf"):
        raise InputError(name, f"is {asked!r}", f"give a number of {unit}, for instance {name}={example}")
    return value
