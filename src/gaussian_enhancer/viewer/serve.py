"""Serving the page until Ctrl-C."""

import io
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera, usable
from gaussian_enhancer.viewer.address import library, refuse_taken
from gaussian_enhancer.viewer.cameras import PageCamera, upward
from gaussian_enhancer.viewer.page import Page, PageSettings
from gaussian_enhancer.viewer.saved import SavedFiles
from gaussian_enhancer.viewer.session import Session

FIRST_WIDTH = 160
"""Width in pixels of the render that tells how far the camera turns round."""


@contextmanager
def served(
    session: Session,
    saved: SavedFiles,
    settings: PageSettings,
    address: tuple[str, int],
    told: Callable[[str], None],
) -> Iterator[tuple[Page, str]]:
    """A page that is served until the block ends, and its address.

    Args:
        session: what is seen.
        saved: where views and paths go.
        settings: of the page.
        address: host and port to listen at; port 0 takes a free one.
        told: called with each line that a user at the terminal should read.

    Raises:
        InputError: viser is not installed, or the address cannot be listened at.
    """
    viser, (host, port) = library(), address
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # stray connections are no concern of the user's
    refuse_taken(host, port)
    with redirect_stdout(io.StringIO()):  # the address is told below
        server = viser.ViserServer(host=host, port=port, label="gaussian-enhancer", verbose=False)
    try:
        found = server.get_port()
        if port not in (0, found):
            raise InputError(f"port={port}", "is in use", "give another port, or port=0 for a free one")
        _without_sharing(server)
        _aim(server, session)
        page = Page(server, session, saved, settings, told)
        page.worker.start()
        try:
            yield page, f"http://{'localhost' if host in ('0.0.0.0', '::') else host}:{found}"
        finally:
            page.worker.stop()
    finally:
        _stop(server)


def _without_sharing(server: Any) -> None:
    """Take away viser's button, and its message, that hand the page to the whole internet through others' servers."""
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.gui.main_panel.dock_right()  # beside the picture, not over it
    server.request_share_url = lambda *_, **__: None


def _aim(server: Any, session: Session) -> None:
    """Let the first camera of a browser be the capture's first, turning round what that looks at."""
    camera = session.cameras[0]
    page = PageCamera.of(camera)
    server.scene.set_up_direction(tuple(upward(session.cameras)))
    start = server.initial_camera
    start.position, start.fov = page.position, page.fov
    start.look_at = tuple((camera.centre + distance(session, page) * camera.forward).tolist())
    start.near, start.far = 1e-4 * distance(session, page), 1e4 * distance(session, page)


def distance(session: Session, camera: PageCamera) -> float:
    """How far what a camera looks at is: the median depth of the middle of its picture, in scene units.

    Args:
        session: what is seen.
        camera: on the page.
    """
    seen: Camera = camera.at(FIRST_WIDTH)
    view = session.draw(session.first, seen, enhance=False)
    if view is None:
        raise ValueError("a view that nothing takes the place of is drawn")
    height, width = view.depth.shape[-2:]
    middle = view.depth[0, height // 4 : height - height // 4, width // 4 : width - width // 4]
    for depth in (middle, view.depth):
        if bool(usable(depth).any()):
            return float(depth[usable(depth)].median())
    spread = torch.stack([one.centre for one in session.cameras]).std(0, correction=0).norm()
    return float(spread) or 1.0


def _stop(server: Any) -> None:
    """Stop the server, which prints, and wait for its thread no longer than it needs."""
    with redirect_stdout(io.StringIO()):
        stopper = threading.Thread(target=server.stop, daemon=True)
        stopper.start()
        stopper.join(timeout=5.0)
