"""From the configuration of the job ``view`` to its session."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import torch
from omegaconf import DictConfig

from gaussian_enhancer.align.references import Pool
from gaussian_enhancer.checkpoint import SHIPPED
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.plan import AUTO, Rules
from gaussian_enhancer.infer.validated_inputs import validate_inputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.inputs import InputPaths, Task, attach_fine
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.runs.splat_source import Capture, open_capture, splat_file
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.scene import Photo
from gaussian_enhancer.viewer.session import Choices, Session, SessionChoice
from gaussian_enhancer.viewer.stage import Stage

RAW, DISTILLED = "raw", "distilled"
GIVEN = "given"
"""Name of a plan that is neither `auto` nor `full`."""


def open_session(cfg: DictConfig, device: torch.device) -> Session:
    """Open what is to be seen, and build its first stage: what cannot be used is refused before a page is served.

    Args:
        cfg: configuration of the job ``view``.
        device: where splats are rendered and networks run.

    Raises:
        InputError: the input cannot be read, weights are missing, or an option is out of range.
    """
    capture = open_capture(cfg, "view")
    files = {RAW: capture.splat} | ({} if cfg.distilled is None else {DISTILLED: _file(cfg.distilled)})
    plans = _plans(build(cfg.plan))
    strength = None if cfg.strength is None else float(cfg.strength)
    shown = DISTILLED if cfg.distilled is not None else RAW
    first = SessionChoice(shown, str(cfg.weights), next(iter(plans)), cfg.max_references, strength)
    choices = Choices(tuple(files), _weights(first.weights), plans)
    stages = _Stages(cfg, device, capture, files, plans)
    session = Session(_name(capture), capture.cameras, choices, first, stages.open)
    session.stage(first)
    return session


class _Stages:
    """Opens the stages of choices. Splats, and photos that were read, are shared among them.

    Args:
        cfg: configuration of the job ``view``.
        device: where splats are rendered and networks run.
        capture: cameras and photos.
        files: splats by name.
        plans: rules by name.
    """

    def __init__(
        self, cfg: DictConfig, device: torch.device, capture: Capture, files: dict[str, Path], plans: dict[str, Rules]
    ) -> None:
        self.cfg, self.device, self.capture, self.files, self.plans = cfg, device, capture, files, plans
        self._splat = cache(self._read)
        self._pool = cache(lambda splat, fine: Pool(self._task(splat, fine).rendered.references))
        self._task = cache(self._with_photos)

    def open(self, choice: SessionChoice) -> Stage:
        """The stage of a choice.

        Raises:
            InputError: a splat or weights cannot be read, or a number is out of range.
        """
        cfg, pretrained = self.cfg, load_weights(choice.weights)
        options = EnhancementOptions(
            choice.max_references,
            cfg.depth_kind,
            None,
            cfg.colour_clamping,
            precision=cfg.precision,
            tile=cfg.tile,
            plan=self.plans[choice.plan],
            colour_completion=cfg.colour_completion,
            confidence=cfg.confidence,
        )
        fine = pretrained.reference_config.fine
        task = self._task(choice.splat, fine)
        asked = options.reference_config(pretrained, task.depth)
        pool = self._pool(choice.splat, fine)
        found = validate_inputs(task.rendered, asked, options.rules, pretrained.network.scale, pool)
        config = PathReferences.of(found.reference_config)
        found = replace(found, reference_config=config)
        enhancer = options.enhancer(pretrained, config, self.device)
        uses_depth = found.rendered.targets[0].read_depth is not None
        renderer, _ = self._splat(choice.splat)
        return Stage(
            renderer.target, enhancer, found.rendered, found.planner(options.rules), found.pool, uses_depth=uses_depth
        )

    def _read(self, splat: str) -> tuple[SplatRenderer, RenderedSet]:
        """What renders a splat, and the photos with its renders of their views."""
        renderer = self.capture.renderer(self.cfg, self.device.type, self.files[splat])
        rendered = self.capture.rendered_by(renderer)
        if splat == RAW or self.capture.scene is not None:
            return renderer, rendered
        photos = (Photo(one.name, one.camera, one.read_photo) for one in rendered.references)  # type: ignore[arg-type]
        return renderer, replace(rendered, references=tuple(map(renderer.reference, photos)))

    def _with_photos(self, splat: str, fine: bool) -> Task:
        """The photos to refer to, with finer ones where they are wanted, and one view that stands for all."""
        renderer, rendered = self._splat(splat)
        example = renderer.target("view.png", self.capture.cameras[0])
        alone = replace(rendered, targets=(example,), own_depth=True)
        task = Task(alone, depth="surface" if self.device.type == "cpu" else "expected")
        task = InputPaths(attach_fine=partial(attach_fine, self.cfg)).with_fine_photos(task, fine)
        return replace(task, rendered=replace(task.rendered, targets=(example,), own_depth=True))


def _file(distilled: str) -> Path:
    """The file of a splat that was named by itself or by its run."""
    return splat_file(distilled) if Path(distilled).is_dir() else Path(distilled)


def _plans(given: Rules) -> dict[str, Rules]:
    """The plans to choose from, the given one first."""
    known = {"auto": AUTO, "full": Rules()}
    named = {name: rules for name, rules in known.items() if rules == given} or {GIVEN: given}
    return {**named, **{name: rules for name, rules in known.items() if name not in named}}


def _weights(given: str) -> tuple[str, ...]:
    """The weights to choose from: the given ones and the shipped ones."""
    shipped = sorted(file.stem for prefix in ("lr", "sr") for file in SHIPPED.glob(f"{prefix}_*.safetensors"))
    return tuple(dict.fromkeys((given, *shipped)))


def _name(capture: Capture) -> str:
    name = capture.rendered.name if capture.scene is None else capture.scene.name
    if not capture.cameras:
        raise InputError(name, "has no camera", "give a capture with cameras")
    return name
