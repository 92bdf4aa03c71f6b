"""Reads the photo, the fitted run and the gates from the configuration of the job ``simulate``."""

import copy

import torch
from omegaconf import DictConfig, OmegaConf

from gaussian_enhancer.degrade.gates.adaptive import AdaptiveGate, MixedGate, calibrate_on_splat
from gaussian_enhancer.degrade.gates.fingerprint import Fingerprint, fingerprint_of_training_views
from gaussian_enhancer.degrade.gates.gate import AllGate, Gate, NoGate, RandomGate
from gaussian_enhancer.degrade.photographed import SimulatorInput, read_held_out, read_image
from gaussian_enhancer.runs.arguments import only_given, refuse_without_effect
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_run


def read_fitted_run(cfg: DictConfig) -> RenderedSet | None:
    """The views of the fitted run; None if a photo was given instead.

    Args:
        cfg: configuration of the job.

    Raises:
        InputError: both a photo and a run were given, or neither, or an option that only applies to the other one.
    """
    inputs = {name: cfg[name] for name in ("image", "run")}
    form = only_given(inputs, "simulate", "nothing to simulate from", "give one of image=FILE, run=FOLDER")
    defaults = {"view": None, "step": None} if form == "image" else {"depth": None, "depth_scale": 1}
    refuse_without_effect((name for name, default in defaults.items() if cfg[name] != default), form)
    return read_run(cfg.run, cfg.step) if form == "run" else None


def choose_photo(cfg: DictConfig, rendered: RenderedSet | None) -> SimulatorInput:
    """The photo to degrade.

    Args:
        cfg: configuration of the job.
        rendered: views of the fitted run, from which the photo is taken; None reads the photo's own file.

    Raises:
        InputError: the view does not exist, or a file cannot be read.
    """
    if rendered is not None:
        return read_held_out(rendered, None if cfg.view is None else str(cfg.view))
    return read_image(cfg.image, cfg.depth, depth_scale=cfg.depth_scale, background=cfg.background)


def run_fingerprint(rendered: RenderedSet | None) -> Fingerprint | None:
    """The fingerprint of a run's training views; None without a run, or if the run has no renders of them.

    Args:
        rendered: views of the fitted run.
    """
    if rendered is None or not any(view.read is not None for view in rendered.references):
        return None
    return fingerprint_of_training_views(rendered)


def choose_gate(cfg: DictConfig, rendered: RenderedSet | None) -> tuple[DictConfig, Gate]:
    """The gate that the configuration names. ``gate=adaptive`` without a file is calibrated on the training views.

    Args:
        cfg: configuration of the job.
        rendered: views of the fitted run.

    Returns:
        The configuration to record, and the gate.
    """
    if rendered is None or not OmegaConf.is_missing(cfg.gate, "file"):
        return cfg, build(cfg.gate)
    generator = torch.Generator().manual_seed(cfg.seed)
    artefact_types = {str(name): on for name, on in cfg.gate.get("types", {}).items()}
    gate = calibrate_on_splat(rendered, generator, types=artefact_types)
    recorded = copy.deepcopy(cfg)
    recorded.gate.file = None  # the run replaces the file, and is itself part of the configuration
    return recorded, gate


def gates_to_show(chosen: Gate, rendered: RenderedSet | None) -> dict[str, Gate | str]:
    """The gates that the page shows, by name: the chosen gate, and the default gate of each other kind.

    Args:
        chosen: the chosen gate.
        rendered: views of the fitted run.

    Returns:
        Gates, or the reason why a kind of gate is not shown.
    """
    no_training_views = (
        "a single photo has no training views to calibrate it on: add gate=adaptive gate.file=FILE, or give run="
    )
    not_calibrated = "add gate=adaptive to calibrate it on the run's training views, which takes about a minute"
    defaults: dict[str, Gate | str] = {
        "none": NoGate(),
        "all": AllGate(),
        "random": RandomGate(),
        "adaptive": no_training_views if rendered is None else not_calibrated,
    }
    kinds = {NoGate: "none", AllGate: "all", RandomGate: "random", AdaptiveGate: "adaptive", MixedGate: "adaptive"}
    kind = kinds.get(type(chosen), type(chosen).__name__)
    return {f"{kind} (chosen)": chosen, **{name: gate for name, gate in defaults.items() if name != kind}}
