"""Choices of the viewer, and the stages that draw them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.types import Camera
from gaussian_enhancer.viewer.stage import Stage, StageView

STAGE_CACHE_SIZE = 4
"""Number of stages that stay in memory."""


@dataclass(frozen=True)
class SessionChoice:
    """The splat that is shown, and how it is enhanced.

    Args:
        splat: name of the splat.
        weights: shipped name or file.
        plan: name of the plan, whose rules state which parts of the input may be left out.
        max_references: maximum number of photos that the network uses; None takes as many as in training.
        strength: share of the network's change that is applied, in [0, 1]; None means 1 with confidence, and the
            strength that the weights state without it.

    Raises:
        InputError: the strength is out of range.
    """

    splat: str
    weights: str
    plan: str
    max_references: int | None = None
    strength: float | None = None

    def __post_init__(self) -> None:
        if self.strength is not None and not 0 <= self.strength <= 1:
            raise InputError("strength", f"is {self.strength:g}", "use a number from 0 (the render) to 1")


@dataclass(frozen=True)
class Choices:
    """Choices that the page offers.

    Args:
        splats: names of splats.
        weights: shipped names and files.
        plans: rules of plans by name.
    """

    splats: tuple[str, ...]
    weights: tuple[str, ...]
    plans: Mapping[str, Rules]


class Session:
    """Draws views by a choice. Only one thread may draw. Recently used stages stay in memory.

    Args:
        name: name of the capture.
        cameras: cameras of the capture's photos, at least one.
        choices: choices that the page offers.
        initial_choice: initial choice.
        open_stage: builds the stage of a choice.
    """

    def __init__(
        self,
        name: str,
        cameras: Sequence[Camera],
        choices: Choices,
        initial_choice: SessionChoice,
        open_stage: Callable[[SessionChoice], Stage],
    ) -> None:
        self.name, self.cameras, self.choices, self.initial_choice = name, tuple(cameras), choices, initial_choice
        self._open: Callable[[SessionChoice], Stage] = lru_cache(maxsize=STAGE_CACHE_SIZE)(open_stage)

    def stage(self, choice: SessionChoice) -> Stage:
        """The stage of a choice, with the strength of the choice.

        Args:
            choice: the choice.

        Raises:
            InputError: a splat or weights cannot be read, or a number is out of range.
        """
        stage = self._open(replace(choice, strength=None))
        stage.enhancer.strength = stage.default_strength if choice.strength is None else choice.strength
        return stage

    def strength(self, choice: SessionChoice) -> float:
        """The strength of a choice; where it has none, 1 with confidence, else the strength that the weights state.

        Raises:
            InputError: see `stage`.
        """
        return self.stage(choice).enhancer.strength

    def draw(
        self,
        choice: SessionChoice,
        camera: Camera,
        enhance: bool = True,
        superseded: Callable[[], bool] | None = None,
    ) -> StageView | None:
        """Draw the view of a camera; see `Stage.draw`.

        Raises:
            InputError: see `stage`, or a reference cannot be read.
        """
        return self.stage(choice).draw(camera, enhance, superseded)
