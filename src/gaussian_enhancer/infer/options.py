"""The options of an enhancement, which the command line and the Python API share."""

from dataclasses import dataclass, fields, replace
from typing import Any

import torch

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.depth_search import SEARCHES, DepthKind
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import AUTO, Rules
from gaussian_enhancer.infer.tiles import check_tiles
from gaussian_enhancer.infer.weights import Pretrained


@dataclass(frozen=True)
class EnhancementOptions:
    """How renders are enhanced. The defaults are those of the job ``enhance``.

    Args:
        max_references: maximum number of photos for the network, 0 to 8; None means as many as in training. With 0, the
            network works on the render alone; otherwise, a view in which no photo is visible is returned unchanged.
        depth_kind: kind of the renders' depth: "surface" (median z), "expected" (mean z, as gsplat and nerfstudio
            render it), "exact", or "auto": the kind that the input's source gives, "expected" for depth in memory.
        strength: share of the network's change that is applied, 0 (the render) to 1, in addition to ``confidence``;
            None means 1 with confidence, and the strength that the weights state without it.
        colour_clamping: side in pixels of the windows whose colours, of the render and of the warped references, limit
            an enhanced pixel that a reference sees; odd, 0 for no limit.
        colour_completion: where no reference is visible, extrapolate the smooth change of colour from visible pixels.
        confidence: apply only the share of the change, block by block, that the references support; no effect for
            weights without a change confidence.
        ensemble: average two enhancements, with all references and without the least useful one. It gains more and
            takes about 1.5 times as long; no effect without ``confidence`` or with fewer than three references.
        temporal_smoothing: for frames along a path: share of the change that a frame takes over from the frame before
            it, from 0 to below 1. It needs cameras and depth.
        precision: precision of the network's convolutions: "auto", "float32", "bfloat16" or "float16".
        tile: side in pixels of the tiles that larger images are cut into, a multiple of 16.
        plan: what may be left out: "auto" leaves out references that do not help, depth that does not fit, and plain
            background; "full" leaves out nothing; `Rules` decide each item.

    Raises:
        InputError: the plan or the kind of depth is unknown. Other values are checked by `SetEnhancer`.
    """

    max_references: int | None = None
    depth_kind: str = "auto"
    strength: int | float | None = None
    colour_clamping: int = 3
    temporal_smoothing: int | float = 0.0
    precision: str = "auto"
    tile: int = 1024
    plan: Rules | str = "auto"
    colour_completion: bool = True
    confidence: bool = True
    ensemble: bool = True

    def __post_init__(self) -> None:
        if self.depth_kind not in ("auto", *SEARCHES):
            raise InputError("depth_kind", f"is {self.depth_kind!r}", f"choose auto, {', '.join(SEARCHES)}")
        if not isinstance(self.plan, Rules) and self.plan not in ("auto", "full"):
            raise InputError("plan", f"is {self.plan!r}", "choose auto or full, or give Rules")

    @classmethod
    def of(cls, **options: Any) -> "EnhancementOptions":
        """Make options from keyword arguments of the Python API.

        Raises:
            InputError: an option does not exist, or is out of range.
        """
        refuse_unknown("options", options, [field.name for field in fields(cls)])
        return cls(**options)

    @property
    def rules(self) -> Rules:
        """The plan's rules."""
        if isinstance(self.plan, Rules):
            return self.plan
        return AUTO if self.plan == "auto" else Rules()

    def reference_config(self, pretrained: Pretrained, depth: DepthKind) -> ReferenceConfig:
        """The reference configuration of the weights, for this kind of depth and this number of references.

        Args:
            pretrained: the weights.
            depth: kind of the input's depth if ``depth_kind`` is "auto".

        Raises:
            InputError: the number of references is out of range.
        """
        config = pretrained.reference_config
        if isinstance(config.warp, Reprojected):
            kind = depth if self.depth_kind == "auto" else self.depth_kind
            config = replace(config, warp=replace(config.warp, depth=kind))  # type: ignore[arg-type]
        if self.max_references is None:
            return config
        candidates = max(self.max_references, config.candidates)
        return replace(config, references=self.max_references, candidates=candidates)

    def enhancer(
        self, pretrained: Pretrained, reference_config: ReferenceConfig, device: torch.device | None = None
    ) -> SetEnhancer:
        """The enhancer of sets of views.

        Args:
            pretrained: the weights.
            reference_config: how references are chosen and aligned, as far as the input allows.
            device: where the network runs; None is the CPU.

        Raises:
            InputError: an option is out of range, or does not suit the weights.
        """
        confidence = pretrained.confidence if self.confidence else None
        default_strength = pretrained.strength if confidence is None else 1.0
        enhancer = SetEnhancer(
            pretrained.network,
            reference_config,
            device,
            self.precision,
            self.tile,
            strength=default_strength if self.strength is None else float(self.strength),
            temporal_smoothing=float(self.temporal_smoothing),
            colour_clamping=int(self.colour_clamping),
            colour_completion=self.colour_completion,
            confidence=confidence,
            ensemble=self.ensemble,
            pass_through=pretrained.reference_config.references > 0 and self.max_references != 0,
        )
        check_tiles(enhancer.tile, enhancer.halo)
        return enhancer
