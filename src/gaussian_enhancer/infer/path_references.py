"""Choice of references for the frames of a path, with few changes, since each change is visible in the video."""

from dataclasses import dataclass, field, fields

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.scene.neighbours import choose_references
from gaussian_enhancer.scene.rendered import RenderedView

HYSTERESIS = 0.5
"""A candidate of the previous frame is kept until another's cost is below this share of its cost."""


@dataclass(frozen=True)
class PathReferences(ReferenceConfig):
    """A reference configuration that keeps the previous frame's candidates until others are clearly better.

    Frames must be requested in the order of the path. To resume within a path, restore ``kept``.

    Args:
        hysteresis: factor on the cost of the previous candidates (`choose_references`); 1 chooses anew for each frame.
        kept: names of the previous frame's candidates, nearest first; updated in place with every frame.
    """

    hysteresis: float = HYSTERESIS
    kept: list[str] = field(default_factory=list)

    @classmethod
    def from_config(cls, config: ReferenceConfig, hysteresis: float = HYSTERESIS) -> "PathReferences":
        """Build the configuration for a path from one for single views.

        Args:
            config: how references are chosen and aligned for single views.
            hysteresis: see the class.
        """
        return cls(**{item.name: getattr(config, item.name) for item in fields(ReferenceConfig)}, hysteresis=hysteresis)

    def nearest_candidates(self, target: LoadedView, view: RenderedView, pool: ReferencePool) -> tuple[int, ...]:
        """Indices of the pool's candidate references for the next frame, nearest first."""
        if not self.references:
            return ()
        previous = [index for index, reference in enumerate(pool.views) if reference.name in self.kept]
        ranking = {"depth": target.depth, "previous_references": previous, "hysteresis": self.hysteresis}
        ranked = choose_references(view, pool.views, self.candidates, **ranking)  # type: ignore[arg-type]
        self.kept[:] = [pool.views[index].name for index in ranked]
        return ranked
