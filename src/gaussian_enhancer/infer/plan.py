"""The plan of an enhancement: which parts of a scene are used or left out, and why.

It is plain data, to be printed and saved. `gaussian_enhancer.infer.planner` makes it.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Region

CHOICES = {"references": ("all", "auto"), "depth": ("all", "auto", "none"), "tiles": ("all", "auto")}


@dataclass(frozen=True)
class Rules:
    """What a plan may leave out. The defaults leave nothing out.

    Args:
        references: "auto" warps all candidates on a coarse grid first, and at full size only the best of those that
            show at least ``share``; "all" warps all candidates at full size.
        depth: "auto" uses depth unless it does not fit the renders; "all" uses it unchecked; "none" never uses it.
        tiles: "auto" passes plain background through; "all" enhances every pixel.
        share: smallest share of a target's covered pixels that a reference must show, in [0, 1].
        tolerance: largest colour difference from the background at which a pixel counts as background, in [0, 1].
        margin: width in pixels of the border around an enhanced region that the network also receives; a multiple of 8.
        small: number of pixels up to which all of a view's candidates are warped at full size, since the coarse grid
            would take as long. It has no effect if background is passed through.

    Raises:
        InputError: a choice is unknown or a number out of range.
    """

    references: str = "all"
    depth: str = "all"
    tiles: str = "all"
    share: float = 0.05
    tolerance: float = 0.03
    margin: int = 0
    small: int = 0

    def __post_init__(self) -> None:
        check_fields(self, "plan.")
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise InputError(f"plan.{name}", f"is {getattr(self, name)!r}", f"choose {', '.join(choices)}")
        for name in ("share", "tolerance"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"plan.{name}", f"is {getattr(self, name)}", "give a number in [0, 1]")
        if self.margin < 0 or self.margin % 8:
            raise InputError("plan.margin", f"is {self.margin}", "give 0 or a multiple of 8")
        if self.small < 0:
            raise InputError("plan.small", f"is {self.small}", "give a number of pixels, 0 to look always")

    @property
    def full(self) -> bool:
        """Whether nothing is left out."""
        return (self.references, self.depth, self.tiles) == ("all", "all", "all")


AUTO = Rules("auto", "auto", "auto", small=65536)
"""Default of the job ``enhance`` and of the Python API; the same as ``conf/plan/auto.yaml``."""


@dataclass(frozen=True)
class PlanItem:
    """One part of the input and whether it is used.

    Args:
        name: the part: "cameras", "depth", "references", ...
        used: whether it is used.
        why: how it is used, or why it is left out.
    """

    name: str
    used: bool
    why: str


@dataclass(frozen=True)
class ViewPlan:
    """Which regions of one view are enhanced, and with which references.

    Args:
        name: the render's file name.
        size: height and width of the render, in pixels.
        regions: regions that are enhanced; the rest of the render is passed through. None enhances all of it.
        references: names of the references that are warped; None leaves the choice to the reference configuration.
        left_out: candidates that are left out, with the share of the view that each shows.
    """

    name: str
    size: tuple[int, int]
    regions: tuple[Region, ...] | None = None
    references: tuple[str, ...] | None = None
    left_out: Mapping[str, float] = field(default_factory=dict)

    @property
    def passed_share(self) -> float:
        """Share of the pixels that are passed through."""
        if self.regions is None:
            return 0.0
        return 1 - sum(region.area for region in self.regions) / (self.size[0] * self.size[1])


@dataclass(frozen=True)
class Plan:
    """The parts of a scene that are used or left out.

    Args:
        scene: its name.
        rules: what may be left out.
        parts: parts of the input, for the whole scene.
        views: plans of the views so far.
    """

    scene: str
    rules: Rules = field(default_factory=Rules)
    parts: tuple[PlanItem, ...] = ()
    views: tuple[ViewPlan, ...] = ()

    @property
    def passed_share(self) -> float:
        """Share of all pixels that are passed through."""
        total = sum(view.size[0] * view.size[1] for view in self.views)
        return sum(view.passed_share * view.size[0] * view.size[1] for view in self.views) / max(1, total)

    def table(self) -> str:
        """The plan as text: one line for each part, then a summary of the views."""
        lines = [(part.name, "yes" if part.used else "no", part.why) for part in self.parts]
        if self.views:
            without_references = any(part.name == "references" and not part.used for part in self.parts)
            if self.rules.references == "auto" and not without_references:
                lines.append(("candidates", "", self._candidates()))
            if self.rules.tiles == "auto":
                share = f"{self.passed_share:.0%}" if self.passed_share else "none"
                lines.append(("pixels", "", f"{share} show plain background and are passed through"))
        return "\n".join(f"{name:<18}{used:<5}{why}".rstrip() for name, used, why in lines)

    def _candidates(self) -> str:
        examined = [view for view in self.views if view.references is not None]
        if not examined:
            return "all are warped: on views of this size a coarse look first would save no time"
        shares = [share for view in examined for share in view.left_out.values()]
        used = sum(len(view.references or ()) for view in examined)
        text = f"{used + len(shares)} examined for {len(examined)} views, {len(shares)} left out"
        few = sum(share < self.rules.share for share in shares)
        return text + (f", {few} of them because they see less than {self.rules.share:.0%}" if few else "")

    def to_file(self, path: Path) -> None:
        """Write the plan as JSON, atomically.

        Raises:
            InputError: the file cannot be written.
        """
        write_json(path, dataclasses.asdict(self), indent=1)
