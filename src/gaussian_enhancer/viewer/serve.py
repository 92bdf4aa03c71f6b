"""Serving the viewer's page."""

import io
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera, usable_depth
from gaussian_enhancer.viewer.address import load_viser, refuse_taken
from gaussian_enhancer.viewer.cameras import PageCamera, upward
from gaussian_enhancer.viewer.page import Page, PageSettings
from gaussian_enhancer.viewer.saved import SavedFiles
from gaussian_enhancer.viewer.session import Session

DEPTH_RENDER_WIDTH = 160
"""Width in pixels of the render whose depth gives the distance of the point that the camera orbits."""


@contextmanager
def serve_page(
    session: Session,
    saved: SavedFiles,
    settings: PageSettings,
    address: tuple[str, int],
    notify: Callable[[str], None],
) -> Iterator[tuple[Page, str]]:
    """Serve a page until the block ends; yield the page and its address.

    Args:
        session: the session that is shown.
        saved: files of saved views and paths.
        settings: settings of the page.
        address: host and port to listen at; port 0 takes a free one.
        notify: called with each message for the user at the terminal.

    Raises:
        InputError: viser is not installed, or no server can listen at the address.
    """
    viser, (host, port) = load_viser(), address
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # do not report stray connections to the user
    refuse_taken(host, port)
    with redirect_stdout(io.StringIO()):  # viser prints the address, which is yielded below
        server = viser.ViserServer(host=host, port=port, label="gaussian-enhancer", verbose=False)
    try:
        bound_port = server.get_port()
        if port not in (0, bound_port):
            raise InputError(f"port={port}", "is in use", "give another port, or port=0 for a free one")
        _set_up_panel(server)
        _set_initial_camera(server, session)
        page = Page(server, session, saved, settings, notify)
        page.worker.start()
        try:
            name = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
            yield page, f"http://{name}:{bound_port}"
        finally:
            page.worker.stop()
    finally:
        _stop(server)


def _set_up_panel(server: Any) -> None:
    """Dock the panel, and disable viser's sharing, which publishes the page through third-party servers."""
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.gui.main_panel.dock_right()  # beside the picture, not over it
    server.request_share_url = lambda *_, **__: None


def _set_initial_camera(server: Any, session: Session) -> None:
    """Set the initial camera of browsers to the capture's first camera, orbiting the point that it looks at."""
    camera = session.cameras[0]
    page_camera = PageCamera.of(camera)
    server.scene.set_up_direction(tuple(upward(session.cameras)))
    initial_camera = server.initial_camera
    initial_camera.position, initial_camera.fov = page_camera.position, page_camera.fov
    orbit_radius = _orbit_distance(session, page_camera)
    initial_camera.look_at = tuple((camera.centre + orbit_radius * camera.forward).tolist())
    initial_camera.near, initial_camera.far = 1e-4 * orbit_radius, 1e4 * orbit_radius


def _orbit_distance(session: Session, camera: PageCamera) -> float:
    """Distance to what a camera looks at, in scene units: the median depth in the middle of its picture.

    Where the middle shows nothing, it is the median depth of the whole picture, else the spread of the capture's
    cameras.

    Args:
        session: the session that is shown.
        camera: camera of the page.
    """
    picture_camera: Camera = camera.to_camera(DEPTH_RENDER_WIDTH)
    view = session.draw(session.initial_choice, picture_camera, enhance=False)
    if view is None:
        raise ValueError("a view that nothing supersedes is drawn")
    height, width = view.depth.shape[-2:]
    middle = view.depth[0, height // 4 : height - height // 4, width // 4 : width - width // 4]
    for depth in (middle, view.depth):
        if bool(usable_depth(depth).any()):
            return float(depth[usable_depth(depth)].median())
    spread = torch.stack([capture_camera.centre for capture_camera in session.cameras]).std(0, correction=0).norm()
    return float(spread) or 1.0


def _stop(server: Any) -> None:
    """Stop the server without its output; wait 5 seconds at most."""
    with redirect_stdout(io.StringIO()):
        stopper = threading.Thread(target=server.stop, daemon=True)
        stopper.start()
        stopper.join(timeout=5.0)
