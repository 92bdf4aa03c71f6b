"""Creation of the viewer's session from the configuration of the job ``view``."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import torch
from omegaconf import DictConfig

from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.checkpoint import SHIPPED_FOLDER
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.plan import AUTO, Rules
from gaussian_enhancer.infer.validated_inputs import validate_inputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.enhancement import read_options, unlike_photos
from gaussian_enhancer.runs.inputs import Task, attach_fine, with_fine_photos
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.runs.splat_source import SplatWithCapture, open_splat_with_capture, splat_file
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.viewer.session import Choices, Session, SessionChoice
from gaussian_enhancer.viewer.stage import Stage

RAW, DISTILLED = "raw", "distilled"
CONFIGURED_PLAN = "given"
"""Name of a plan that is neither `auto` nor `full`."""


def open_session(cfg: DictConfig, device: torch.device, notify: Callable[[str], None]) -> Session:
    """Create the session and build its first stage, so that invalid input is refused before a page is served.

    Args:
        cfg: configuration of the job ``view``.
        device: where splats are rendered and networks run.
        notify: called with what the user should know of the input, once for each splat.

    Raises:
        InputError: the input cannot be read, weights are missing, or an option is out of range.
    """
    capture = open_splat_with_capture(cfg, "view")
    if not capture.cameras:
        raise InputError(capture.rendered.name, "has no camera", "give a capture with cameras")
    files = {RAW: capture.splat} | ({} if cfg.distilled is None else {DISTILLED: _splat_path(cfg.distilled)})
    plans = _plans(build(cfg.plan))
    strength = None if cfg.strength is None else float(cfg.strength)
    initial_splat = DISTILLED if cfg.distilled is not None else RAW
    initial_choice = SessionChoice(initial_splat, str(cfg.weights), next(iter(plans)), cfg.max_references, strength)
    choices = Choices(tuple(files), _weights(initial_choice.weights), plans)
    stages = _StageBuilder(cfg, device, capture, files, plans, notify)
    session = Session(capture.rendered.name, capture.cameras, choices, initial_choice, stages.open)
    session.stage(initial_choice)
    return session


class _StageBuilder:
    """Builds the stages of choices. Stages share splats, and photos that have been read.

    Args:
        cfg: configuration of the job ``view``.
        device: where splats are rendered and networks run.
        capture: cameras and photos of the capture.
        files: files of splats by name.
        plans: rules of plans by name.
        notify: called with what the user should know of a splat or its photos.
    """

    def __init__(
        self,
        cfg: DictConfig,
        device: torch.device,
        capture: SplatWithCapture,
        files: dict[str, Path],
        plans: dict[str, Rules],
        notify: Callable[[str], None],
    ) -> None:
        self.cfg, self.device, self.capture, self.files, self.plans = cfg, device, capture, files, plans
        self.notify = notify
        self._splat = cache(self._read)
        self._pool = cache(lambda splat, fine: ReferencePool(self._task(splat, fine).rendered.references))
        self._task = cache(self._with_photos)

    def open(self, choice: SessionChoice) -> Stage:
        """Build the stage of a choice.

        Raises:
            InputError: a splat or weights cannot be read, or a number is out of range.
        """
        cfg, pretrained = self.cfg, load_weights(choice.weights)
        plan = self.plans[choice.plan]
        options = read_options(cfg, max_references=choice.max_references, strength=None, plan=plan)
        fine = pretrained.reference_config.fine
        task = self._task(choice.splat, fine)
        reference_config = options.reference_config(pretrained, task.depth)
        pool = self._pool(choice.splat, fine)
        validated = validate_inputs(task.rendered, reference_config, options.rules, pretrained.network.scale, pool)
        config = PathReferences.from_config(validated.reference_config)
        validated = replace(validated, reference_config=config)
        enhancer = options.enhancer(pretrained, config, self.device)
        uses_depth = validated.rendered.targets[0].read_depth is not None
        renderer, _ = self._splat(choice.splat)
        return Stage(
            renderer.target,
            enhancer,
            validated.rendered,
            validated.planner(options.rules),
            validated.pool,
            uses_depth=uses_depth,
        )

    def _read(self, splat: str) -> tuple[SplatRenderer, RenderedSet]:
        """Open a splat: return its renderer, and the set of photos with the splat's renders of their views."""
        renderer = self.capture.renderer(self.cfg, self.device.type, self.files[splat])
        rendered = self.capture.references_rendered_by(renderer, again=splat != RAW)
        for warning in unlike_photos(ReferencePool(rendered.references)):
            self.notify(f"{splat}: {warning}")
        return renderer, rendered

    def _with_photos(self, splat: str, fine: bool) -> Task:
        """Task of a splat: references, with high-resolution photos where ``fine`` is set, and one example target."""
        renderer, rendered = self._splat(splat)
        # The capture has no photo of the example, which therefore comes after the photos.
        task = Task(replace(rendered, targets=()), depth="surface" if self.device.type == "cpu" else "expected")
        task = with_fine_photos(task, partial(attach_fine, self.cfg) if fine else None)
        if task.note:
            self.notify(f"{splat}: {task.note}")
        example = renderer.target("view.png", self.capture.cameras[0])
        return replace(task, rendered=replace(task.rendered, targets=(example,), own_depth=True))


def _splat_path(distilled: str) -> Path:
    """File of a splat, by the path of the file or of its run's folder."""
    return splat_file(distilled) if Path(distilled).is_dir() else Path(distilled)


def _plans(configured: Rules) -> dict[str, Rules]:
    """Plans to choose from; the configured one is the first."""
    plans = {"auto": AUTO, "full": Rules()}
    name = next((name for name, rules in plans.items() if rules == configured), CONFIGURED_PLAN)
    return {name: configured, **plans}


def _weights(configured: str) -> tuple[str, ...]:
    """Weights to choose from: the configured ones first, then the shipped ones."""
    shipped = sorted(file.stem for prefix in ("lr", "sr") for file in SHIPPED_FOLDER.glob(f"{prefix}_*.safetensors"))
    return tuple(dict.fromkeys((configured, *shipped)))
