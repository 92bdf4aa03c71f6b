"""The job ``measure``: compare images on disk with their photos; write records and tables."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.progress import track

from gaussian_enhancer.console import hides_progress
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.comparison import (
    Table,
    VariantPair,
    compare,
    gain_table,
    mean_table,
    pair_records,
    record_table,
    view_table,
)
from gaussian_enhancer.metrics.image_folders import ImageFiles, Label, measure_files, pair_folders, pair_run
from gaussian_enhancer.metrics.lpips import PerceptualDistance, requested_distances
from gaussian_enhancer.metrics.records import Record, write_records
from gaussian_enhancer.runs.arguments import refuse_without_effect
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.photos import background_colour


def run(cfg: DictConfig) -> float | None:
    """Measure a folder of images, two folders of images in comparison, or a run.

    Nothing is written before all images are measured.

    Args:
        cfg: see ``conf/measure.yaml``.

    Returns:
        The mean gain in colour-aligned PSNR if two variants were measured, else the mean colour-aligned PSNR, in dB;
        None if no view has a finite value.

    Raises:
        InputError: images and photos differ in names or sizes, or a file cannot be read or written.
    """
    records, folder = write_measurement(cfg)
    pairs = _pairs(records)
    print(_tables(records, pairs)["summary"].markdown(), end="")
    print(f"{len(records)} records in {folder / 'records.jsonl'}")
    return _score(records, pairs)


def write_measurement(cfg: DictConfig) -> tuple[tuple[Record, ...], Path]:
    """Measure the images that the configuration names, and write records and tables.

    Args:
        cfg: see ``conf/measure.yaml``.

    Returns:
        The records and the folder that holds them.

    Raises:
        InputError: images and photos differ in names or sizes, or a file cannot be read or written.
    """
    files = _files(cfg)
    device = start(cfg.runtime)
    distances = requested_distances(cfg.lpips, cfg.backbones, device)
    records = _measure(files, distances, cfg)
    tables = _tables(records, _pairs(records))
    job = open_run(cfg, "measure", files[0].label.run)
    write_records(job.folder / "records.jsonl", records)
    for name, table in tables.items():
        for ending, text in ((".md", table.markdown()), (".csv", table.csv())):
            write_text(job.folder / f"{name}{ending}", text)
    job.finish()
    return records, job.folder


def _pairs(records: Sequence[Record]) -> tuple[VariantPair, ...]:
    return pair_records(records) if {record.variant for record in records} == {"raw", "enhanced"} else ()


def _files(cfg: DictConfig) -> tuple[ImageFiles, ...]:
    """The images that the configuration names, paired with their photos."""
    if cfg.run is not None and (cfg.images is not None or cfg.photos is not None or cfg.raw is not None):
        raise InputError("run", "was given together with images, photos or raw", "give either")
    if cfg.run is not None:
        defaults = {"masks": None, "variant": "enhanced", "unmatched": "refuse"}
        refuse_without_effect((name for name, default in defaults.items() if cfg[name] != default), "run")
        return pair_run(cfg.run, cfg.step, scene=_text(cfg.scene_name), splat=_text(cfg.splat_name))
    if cfg.images is None or cfg.photos is None:
        raise InputError("measure", "was given no images to measure", "add images=FOLDER photos=FOLDER, or run=FOLDER")
    refuse_without_effect(["step"] if cfg.step is not None else [], "images")
    if cfg.raw is not None and cfg.variant != "enhanced":
        raise InputError("variant", f"is {cfg.variant!r} beside raw", "leave it out: gains are those of 'enhanced'")
    name = Path(cfg.images).resolve().name
    files: list[ImageFiles] = []
    for folder, variant in ((cfg.raw, "raw"), (cfg.images, cfg.variant)):
        if folder is not None:
            label = Label(name, _text(cfg.scene_name) or name, _text(cfg.splat_name), str(variant))
            files += pair_folders(folder, cfg.photos, label, masks=cfg.masks, unmatched=cfg.unmatched)
    return tuple(files)


def _text(value: object) -> str:
    """A name of the configuration, which may consist of digits, as text; empty if there is none."""
    return "" if value is None else str(value)


def _measure(
    files: Sequence[ImageFiles], distances: Sequence[PerceptualDistance], cfg: DictConfig
) -> tuple[Record, ...]:
    steps = measure_files(files, distances, background_colour(cfg.background))
    console = Console(stderr=True)
    hidden = hides_progress(cfg, console)
    return tuple(track(steps, "measuring", total=len(files), console=console, disable=hidden))


def _tables(records: Sequence[Record], pairs: Sequence[VariantPair]) -> dict[str, Table]:
    if pairs:
        return {"summary": gain_table(pairs), "views": view_table(pairs)}
    return {"summary": mean_table(records), "views": record_table(records)}


def _score(records: Sequence[Record], pairs: Sequence[VariantPair]) -> float | None:
    """The mean gain of pairs, else the mean of records, in colour-aligned PSNR; None without a finite value."""
    if pairs:
        comparison = compare(pairs, "psnr_aligned")
        return comparison.gain if comparison.count else None
    values = [record.metrics["psnr_aligned"] for record in records]
    finite = [value for value in values if value is not None and value != float("inf")]
    return sum(finite) / len(finite) if finite else None
