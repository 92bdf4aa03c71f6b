"""The page in the browser: viser's camera control, the picture in the background, and the panel of controls."""

import shlex
from collections import defaultdict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.image_files import to_bytes
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.types import Camera
from gaussian_enhancer.viewer.cameras import PageCamera
from gaussian_enhancer.viewer.controls import Controls, status
from gaussian_enhancer.viewer.modes import Mode
from gaussian_enhancer.viewer.saved import SavedFiles, path_through_cameras
from gaussian_enhancer.viewer.schedule import Worker
from gaussian_enhancer.viewer.session import Session, SessionChoice
from gaussian_enhancer.viewer.stage import StageView

QUALITY = {True: 95, False: 85}
"""JPEG quality of pictures at full size (True), and of the smaller ones while the camera moves (False)."""
THUMBNAIL = 400
"""Width in pixels of the nearest photo beside the picture."""
SHOWN_SECONDS = 10.0
"""Seconds that a notification stays on the page."""


@dataclass(frozen=True)
class PageSettings:
    """Initial mode of the page, and widths of its pictures.

    Args:
        mode: initial mode.
        width: largest width of the picture in pixels while the camera is still.
        moving_width: largest width of the picture in pixels while the camera moves.
    """

    mode: Mode
    width: int = 960
    moving_width: int = 400


@dataclass(frozen=True)
class _ShownPicture:
    """Picture that a browser shows, and the view that it was made of.

    Args:
        key: everything that the view depends on; the view is reused while the key is the same.
        view: the view that was drawn.
        picture: the picture that the mode made of the view.
        camera: the page's camera of the whole picture.
        full: whether it is drawn at full size.
    """

    key: tuple[object, ...]
    view: StageView
    picture: Float[Tensor, "3 _ _"]
    camera: PageCamera
    full: bool


class Page:
    """Serves a session to browsers. All browsers share the choices; each has its own camera.

    Args:
        server: viser's server.
        session: the session that is shown.
        saved: files of saved views and paths.
        settings: settings of the page.
        notify: called with each message for the user at the terminal.
    """

    def __init__(
        self, server: Any, session: Session, saved: SavedFiles, settings: PageSettings, notify: Callable[[str], None]
    ) -> None:
        self.server, self.session, self.saved, self.settings, self.notify = server, session, saved, settings, notify
        self.worker = Worker(self._draw_or_notify)
        self.controls = Controls(server, session, settings.mode, self._on_change)
        self._bind()
        self._shown: dict[Hashable, _ShownPicture] = {}
        self._refused: defaultdict[Hashable, set[str]] = defaultdict(set)
        self._path_cameras: list[PageCamera] = []
        self._frame, self._weights = 0, session.initial_choice.weights
        self._photo: RenderedView | None = None
        server.on_client_connect(self._on_connect)
        server.on_client_disconnect(self._on_disconnect)

    def _bind(self) -> None:
        """Connect the buttons to their actions."""
        controls = self.controls
        controls.save_view.on_click(self._report_errors(self._save_view))
        controls.add.on_click(self._report_errors(self._add_camera))
        controls.clear.on_click(self._report_errors(self._clear_path))
        controls.save_path.on_click(self._report_errors(self._save_path))
        controls.go.on_click(self._report_errors(self._go_to_photo))

    def _on_connect(self, client: Any) -> None:
        last_camera = _page_camera(client)

        def on_camera_update(_: Any) -> None:
            nonlocal last_camera
            camera = _page_camera(client)
            if camera != last_camera:
                last_camera = camera
                self.worker.camera_moved(client.client_id)

        client.camera.on_update(on_camera_update)
        self.worker.add_viewer(client.client_id)

    def _on_disconnect(self, client: Any) -> None:
        self.worker.remove_viewer(client.client_id)
        self._shown.pop(client.client_id, None)
        self._refused.pop(client.client_id, None)

    def _on_change(self) -> None:
        for viewer in self.server.get_clients():
            self.worker.content_changed(viewer)

    def _draw_or_notify(self, viewer: Hashable, full: bool, superseded: Callable[[], bool]) -> None:
        client = self.server.get_clients().get(viewer)
        if client is None:
            return
        try:
            if self._draw(client, full, superseded):
                self._refused.pop(viewer, None)
        except InputError as error:
            if str(error) not in self._refused[viewer]:  # notify once, not at each movement
                self._refused[viewer].add(str(error))
                self._note(client, str(error))

    def _draw(self, client: Any, full: bool, superseded: Callable[[], bool]) -> bool:
        """Draw the picture that a browser asks for, and send it. Return whether it was sent."""
        mode, choice, camera = self.controls.mode, self._choice(), _page_camera(client)
        largest_width = self.settings.width if full else self.settings.moving_width
        width = min(largest_width, client.camera.image_width)
        view_camera = camera.middle_half().to_camera(width // 2) if mode.splits_width else camera.to_camera(width)
        key = (choice, camera, view_camera.width, mode.splits_width)
        previous = self._shown.get(client.client_id)
        if previous is not None and previous.key == key and (previous.view.enhanced is not None or not mode.enhances):
            view: StageView | None = previous.view
        else:
            view = self.session.draw(choice, view_camera, mode.enhances, superseded)
        if view is None:
            return False
        picture = mode(view)
        if client.client_id not in self.server.get_clients():
            return False  # the browser disconnected while its view was drawn
        self._shown[client.client_id] = _ShownPicture(key, view, picture, camera, full)
        client.scene.set_background_image(to_bytes(picture), format="jpeg", jpeg_quality=QUALITY[full])
        self._frame += 1
        self.controls.status.content = status(self._frame, picture, view, mode)
        if full:
            self._show_photo(choice, view_camera)
        return True

    def _choice(self) -> SessionChoice:
        """The choice of the controls.

        When the weights change, the strength is reset to the configured one or, where none is configured, to that of
        the new weights: 1 with confidence, else what their card states.
        """
        choice = self.controls.choice
        if choice.weights != self._weights:
            default_strength = self.session.strength(replace(choice, strength=self.session.initial_choice.strength))
            self._weights = choice.weights
            self.controls.strength.value = default_strength
            choice = replace(choice, strength=default_strength)
        return choice

    def _show_photo(self, choice: SessionChoice, camera: Camera) -> None:
        photo = self.session.stage(choice).nearest_photo(camera)
        if photo is None or photo.read_photo is None:
            return
        if self._photo is None or photo.name != self._photo.name:
            image = photo.read_photo()
            width = min(THUMBNAIL, image.shape[-1])
            thumbnail = resize(image, max(1, round(image.shape[-2] * width / image.shape[-1])), width)
            self.controls.show_photo(to_bytes(thumbnail), photo.name)
            self._photo = photo

    def _report_errors(self, act: Callable[[Any], str]) -> Callable[[Any], None]:
        """Wrap the action of a button: a text that it returns, or an `InputError`, becomes a notification."""

        def pressed(event: Any) -> None:
            if event.client is None:
                return
            try:
                message = act(event.client)
            except InputError as error:
                message = str(error)
            if message:
                self._note(event.client, message)

        return pressed

    def _save_view(self, client: Any) -> str:
        shown = self._shown.get(client.client_id)
        if shown is None or not shown.full or shown.camera != _page_camera(client):
            raise InputError("view", "is being rendered", "save it when the picture is at full size")
        height, width = shown.picture.shape[-2:]
        camera = replace(shown.camera, aspect=width / height).to_camera(width)
        return f"saved {self.saved.save_view(shown.picture, camera)}"

    def _add_camera(self, client: Any) -> str:
        self._path_cameras.append(_page_camera(client))
        self.controls.show_count(len(self._path_cameras))
        return ""

    def _clear_path(self, client: Any) -> str:
        self._path_cameras.clear()
        self.controls.show_count(0)
        return ""

    def _save_path(self, client: Any) -> str:
        seconds = float(self.controls.seconds.value)
        cameras = path_through_cameras(tuple(self._path_cameras), self.settings.width, seconds, self.session.cameras)
        file = self.saved.save_path(cameras, len(cameras) / seconds)
        return f"saved {file}: gaussian-enhancer video path={shlex.quote(str(file))} makes a video of it"

    def _go_to_photo(self, client: Any) -> str:
        if self._photo is None or self._photo.camera is None:
            raise InputError("nearest photo", "is not known yet", "wait until the picture is at full size")
        photo_camera = PageCamera.of(self._photo.camera)
        with client.atomic():
            client.camera.wxyz = photo_camera.wxyz
            client.camera.position = photo_camera.position
            client.camera.fov = photo_camera.fov
        return ""

    def _note(self, client: Any, line: str) -> None:
        client.add_notification("gaussian-enhancer", line, auto_close_seconds=SHOWN_SECONDS)
        self.notify(line)


def _page_camera(client: Any) -> PageCamera:
    camera = client.camera
    position, wxyz = (tuple(float(value) for value in values) for values in (camera.position, camera.wxyz))
    return PageCamera(position, wxyz, float(camera.fov), camera.image_width / max(1, camera.image_height))
