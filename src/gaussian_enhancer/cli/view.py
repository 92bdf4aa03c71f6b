"""The job ``view``: show a splat in the browser, raw and enhanced."""

from functools import partial
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import INTERRUPTED
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.viewer.address import load_viser, refuse_taken
from gaussian_enhancer.viewer.modes import Mode
from gaussian_enhancer.viewer.page import PageSettings
from gaussian_enhancer.viewer.saved import SavedFiles
from gaussian_enhancer.viewer.serve import serve_page
from gaussian_enhancer.viewer.source import open_session


def run(cfg: DictConfig) -> None:
    """Serve the viewer's page until Ctrl-C. Only files that the user saves on the page are written.

    Args:
        cfg: see ``conf/view.yaml``.

    Raises:
        InputError: the input cannot be used, an option is out of range, viser is missing, or the port is in use.
        SystemExit: the user pressed Ctrl-C.
    """
    log = partial(print_line, Console(stderr=True))
    load_viser()
    settings = PageSettings(Mode(cfg.show, float(cfg.wipe)), cfg.width, cfg.moving_width)
    refuse_taken(cfg.host, cfg.port)
    session = open_session(cfg, start(cfg.runtime), log)
    saved = SavedFiles(Path(cfg.output) if cfg.output else Path(cfg.runs) / "view" / session.name)
    try:
        with serve_page(session, saved, settings, (cfg.host, cfg.port), log) as (page, address):
            log(f"{address} shows {session.name}; press Ctrl-C to stop")
            page.worker.wait()
    except KeyboardInterrupt:
        stopped = f"stopped; {saved.folder} holds {saved.count} saved views and paths"
        print_line(Console(stderr=True), stopped)  # the other one may keep an interrupted line
        raise SystemExit(INTERRUPTED) from None
