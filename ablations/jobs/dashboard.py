"""``gaussian-enhancer dashboard``: an interactive page of the suite's results, made from descriptions and records."""

from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from ablations.jobs.plan_study import aims_of
from ablations.report.dashboard.folder import all_records, read_folder
from ablations.report.dashboard.page import document
from ablations.report.dashboard.pictures import ShownImages, copy_pictures
from ablations.report.dashboard.runs import source_runs
from ablations.report.dashboard.studies import read_study
from ablations.suite.evaluation import compose_checked
from gaussian_enhancer.console import print_line
from gaussian_enhancer.files import write_text
from gaussian_enhancer.runs.instantiate import require


def output_path(cfg: DictConfig) -> Path:
    """The folder of page and pictures."""
    return Path(cfg.output or Path(cfg.runs) / "dashboard")


def run(cfg: DictConfig) -> float | None:
    """Write ``dashboard.html`` and its pictures.

    Args:
        cfg: see ``conf/dashboard.yaml``.

    Raises:
        InputError: the folder holds no table, a file in it is damaged, or the output cannot be written.
    """
    require(cfg)
    folder, runs = Path(cfg.folder), Path(cfg.runs)
    output = output_path(cfg)
    tables = read_folder(folder)
    sources = source_runs(runs, all_records(tables))
    views = int(cfg.images_per_scene)
    pictures = copy_pictures(tables, runs, output, views) if views > 0 else ShownImages()
    title = cfg.title or f"GaussianEnhancer suite · {folder.name}"
    path = output / "dashboard.html"
    aims = aims_of(compose_checked("plan_study", cfg, ()))
    studies = [
        read_study(str(name), Path(study.records), Path(study.diagrams), output, aims)
        for name, study in cfg.studies.items()
    ]
    write_text(path, document(title, tables, sources, pictures, studies))
    absent = sum(bool(source.absent) for source in sources)
    counts = f"{len(tables)} tables, {len(all_records(tables))} records, {len(pictures.shown)} views with pictures"
    counts += f", {absent} of {len(sources)} runs not on this machine in full" if absent else ""
    print_line(Console(stderr=True), f"{path}: {counts}")
    return None
