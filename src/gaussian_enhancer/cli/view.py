"""The job ``view``: show a splat in the browser, raw and enhanced."""

from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.viewer.address import library, refuse_taken
from gaussian_enhancer.viewer.modes import Mode
from gaussian_enhancer.viewer.page import PageSettings
from gaussian_enhancer.viewer.saved import SavedFiles
from gaussian_enhancer.viewer.serve import served
from gaussian_enhancer.viewer.source import open_session

STOPPED = 130
"""Exit code of a program that Ctrl-C ended."""


def run(cfg: DictConfig) -> None:
    """Serve the viewer's page until Ctrl-C. Only what the user saves on the page is written.

    Args:
        cfg: see ``conf/view.yaml``.

    Raises:
        InputError: the input cannot be used, an option is out of range, viser is missing, or the port is in use.
        SystemExit: the user pressed Ctrl-C.
    """
    console = Console(stderr=True)

    def told(line: str) -> None:
        console.print(line, highlight=False, soft_wrap=True, markup=False)

    library()
    settings = PageSettings(Mode(cfg.show, float(cfg.wipe)), cfg.width, cfg.moving_width)
    refuse_taken(cfg.host, cfg.port)
    session = open_session(cfg, start(cfg.runtime))
    saved = SavedFiles(Path(cfg.output) if cfg.output else Path(cfg.runs) / "view" / session.name)
    try:
        with served(session, saved, settings, (cfg.host, cfg.port), told) as (page, address):
            told(f"{address} shows {session.name}; Ctrl-C ends it")
            page.worker.wait()
    except KeyboardInterrupt:
        told(f"stopped; {saved.folder} holds {saved.count} saved views and paths")
        raise SystemExit(STOPPED) from None
