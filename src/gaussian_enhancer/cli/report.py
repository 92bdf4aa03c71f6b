"""The job ``report``: create an HTML page from a measured run."""

from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.console import print_line
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.report.measured_run import open_measured, write_contact_sheet, write_page
from gaussian_enhancer.runs.instantiate import require


def output_path(cfg: DictConfig) -> Path:
    """The folder of the page.

    Raises:
        InputError: ``measured`` is not given.
    """
    require(cfg)
    return Path(cfg.output or cfg.measured)


def run(cfg: DictConfig) -> None:
    """Write ``report.html``, and ``contact_sheet.png`` if it is requested.

    Args:
        cfg: see ``conf/report.yaml``.

    Raises:
        InputError: the folder holds no finished measurement of renders and enhanced renders, or cannot be written.
    """
    measured_run = open_measured(cfg.measured)
    path = output_path(cfg) / "report.html"
    write_page(path, measured_run, title=cfg.title, most_pictured=cfg.most_pictured)
    console = Console(stderr=True)
    print_line(console, f"{path}: {len(measured_run.views)} views")
    if cfg.contact_sheet:
        with atomic_write(path.with_name("contact_sheet.png")) as temporary:
            write_contact_sheet(temporary, measured_run.views)
