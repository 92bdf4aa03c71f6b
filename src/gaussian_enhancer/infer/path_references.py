"""References for the frames of a path: few changes, since each change of a reference can be seen."""

from dataclasses import dataclass, field, fields

from gaussian_enhancer.align.alignment import Pixels
from gaussian_enhancer.align.references import Pool, ReferenceConfig
from gaussian_enhancer.scene.neighbours import rank_references
from gaussian_enhancer.scene.rendered import RenderedView

HYSTERESIS = 0.5
"""A candidate of the frame before keeps its place until another costs less than this share of it."""


@dataclass(frozen=True)
class PathReferences(ReferenceConfig):
    """Candidates of a frame are those of the frame before until others are clearly better.

    Frames are asked for in the order of the path. To go on in the middle of a path, ``kept`` is set to what it was.

    Args:
        hysteresis: factor on the cost of the previous candidates (`rank_references`); 1 chooses anew for each frame.
        kept: names of the candidates of the frame before, nearest first; changes with every frame.
    """

    hysteresis: float = HYSTERESIS
    kept: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, config: ReferenceConfig, hysteresis: float = HYSTERESIS) -> "PathReferences":
        """A configuration with the choice for paths.

        Args:
            config: how references are chosen and aligned for single views.
            hysteresis: see the class.
        """
        return cls(**{one.name: getattr(config, one.name) for one in fields(ReferenceConfig)}, hysteresis=hysteresis)

    def nearest(self, target: Pixels, view: RenderedView, pool: Pool) -> tuple[int, ...]:
        """Indices of the pool's candidate references for the next frame, nearest first."""
        if not self.references:
            return ()
        before = [index for index, one in enumerate(pool.views) if one.name in self.kept]
        ranking = {"depth": target.depth, "kept": before, "hysteresis": self.hysteresis}
        ranked = rank_references(view, pool.views, self.candidates, **ranking)  # type: ignore[arg-type]
        self.kept[:] = [pool.views[index].name for index in ranked]
        return ranked
