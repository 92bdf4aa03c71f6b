"""The panel of controls beside the picture."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.viewer.modes import MODES, Mode
from gaussian_enhancer.viewer.session import Session, SessionChoice
from gaussian_enhancer.viewer.stage import StageView

AS_TRAINED = "as in training"
MOST_REFERENCES = 8
SECONDS = (1.0, 60.0, 8.0)
"""Duration of a path in seconds: smallest, largest and initial value."""


class Controls:
    """The panel of the page.

    Args:
        server: viser's server.
        session: the session whose choices are offered.
        mode: initial mode.
        on_change: called when a choice changes.
    """

    def __init__(self, server: Any, session: Session, mode: Mode, on_change: Callable[[], None]) -> None:
        gui, initial = server.gui, session.initial_choice
        self.status = gui.add_markdown("Waiting for the first picture.")
        with gui.add_folder("Show"):
            names = [_label(name) for name in MODES]
            self._mode = gui.add_dropdown("mode", names, initial_value=_label(mode.name))
            self._wipe = gui.add_slider("wipe", 0.0, 1.0, 0.01, mode.wipe, hint="the mode wipe's line")
        with gui.add_folder("Enhance"):
            choices = session.choices
            self._splat = gui.add_dropdown("splat", choices.splats, initial_value=initial.splat)
            self._weights = gui.add_dropdown("weights", choices.weights, initial_value=initial.weights)
            self.strength = gui.add_slider("strength", 0.0, 1.0, 0.01, session.strength(initial))
            counts = [AS_TRAINED, *map(str, range(MOST_REFERENCES + 1))]
            initial_count = AS_TRAINED if initial.max_references is None else str(initial.max_references)
            self._references = gui.add_dropdown(
                "references", counts, initial_value=initial_count, hint="photos a view may use"
            )
            self._plan = gui.add_dropdown("plan", tuple(choices.plans), initial_value=initial.plan)
        with gui.add_folder("Nearest photo"):
            self._photo = gui.add_image(np.zeros((2, 3, 3), np.uint8), label="", visible=False)
            self.go = gui.add_button("Go to its camera")
        with gui.add_folder("Save"):
            self.save_view = gui.add_button("Save view", hint="the displayed picture and its camera")
            self.add = gui.add_button("Add camera to path")
            self._count = gui.add_markdown("")
            self.seconds = gui.add_slider("seconds", SECONDS[0], SECONDS[1], 0.5, SECONDS[2], hint="of the path")
            self.save_path = gui.add_button("Save path", hint="a file that gaussian-enhancer video path=FILE reads")
            self.clear = gui.add_button("Clear path")
        self.show_count(0)
        controls = (self._mode, self._wipe, self._splat, self._weights, self.strength, self._references, self._plan)
        for control in controls:
            control.on_update(lambda _: on_change())

    @property
    def mode(self) -> Mode:
        """The chosen mode.

        Raises:
            InputError: a browser sent a value that is not offered.
        """
        name = {_label(name): name for name in MODES}.get(self._mode.value, str(self._mode.value))
        return Mode(name, float(self._wipe.value))

    @property
    def choice(self) -> SessionChoice:
        """The chosen splat, weights, plan, number of references and strength.

        Raises:
            InputError: a browser sent a value that is not offered, for instance another file.
        """
        for control in (self._splat, self._weights, self._references, self._plan):
            if control.value not in control.options:
                raise InputError("the page", f"asks for {control.value!r}", "choose what it offers")
        count = None if self._references.value == AS_TRAINED else int(self._references.value)
        strength = float(self.strength.value)
        return SessionChoice(self._splat.value, self._weights.value, self._plan.value, count, strength)

    def show_photo(self, image: np.ndarray, name: str) -> None:
        """Show the nearest photo.

        Args:
            image: 8 bits, height x width x 3.
            name: name of the photo.
        """
        self._photo.image, self._photo.label, self._photo.visible = image, name, True

    def show_count(self, count: int) -> None:
        """Show how many cameras the path passes."""
        self._count.content = f"The path passes {count} cameras."


def status(frame: int, picture: Float[Tensor, "3 _ _"], view: StageView, mode: Mode) -> str:
    """The status text above the controls, in Markdown: run times, size, and notes.

    Args:
        frame: number of the picture, from 1.
        picture: the picture as it is shown.
        view: the view that it shows.
        mode: the mode that it was made by.
    """
    height, width = picture.shape[-2:]
    times = view.times
    stages = f"render {times.rendering:.0f}"
    if view.enhanced is not None:
        stages += f", references {times.preparing:.0f}, network {times.enhancing:.0f}"
    lines = [f"**{times.total:.0f} ms** ({stages}), {width} × {height}, frame {frame}"]
    if view.blank:
        lines.append("The splat is not visible from here: turn the camera or move back.")
    elif view.enhanced is not None and not view.references:
        lines.append("No photo is used here.")
    return "\n\n".join(filter(None, [*lines, mode.legend]))


def _label(name: str) -> str:
    return name.replace("_", " ")
