"""``gaussian-enhancer simulate``: a photo made to look like splat renders, as images to use and a page to look at."""

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import track

from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.adaptive import AdaptiveGate, MixedGate, calibrated_on
from gaussian_enhancer.degrade.gates.fingerprint import Fingerprint, fingerprint_of_training_views
from gaussian_enhancer.degrade.gates.gate import AllGate, Gate, NoGate, RandomGate, Step
from gaussian_enhancer.degrade.generative.second_stage import DiffusedGenerator, PairedGenerator
from gaussian_enhancer.degrade.photographed import Photographed, read_held_out, read_image
from gaussian_enhancer.degrade.simulator import SecondStage, Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import save_array, whole_file, write_text
from gaussian_enhancer.report.simulation import EDGE, Section, sheet, write_page
from gaussian_enhancer.report.simulation_parts import (
    gate_section,
    generator_section,
    reduced,
    sample_section,
    type_sections,
    view_section,
)
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_run

PICTURED = 20
"""Samples that the page shows; all are written."""


@dataclass(frozen=True)
class Sample:
    """One simulated render.

    Args:
        file: the image, relative to the job's folder.
        seed: of its own generator.
        steps: stage 1, in order.
    """

    file: str
    seed: int
    steps: tuple[Step, ...]


def run(cfg: DictConfig) -> float | None:
    """Simulate renders of one photo; write samples, sheets, a page and a record of what was drawn.

    Nothing is written before everything was read, and stage 2 has shown that it runs.

    Args:
        cfg: see ``conf/simulate.yaml``.

    Raises:
        InputError: the photo or the run cannot be used, gate or generator refuse, or a file cannot be written.
    """
    device = start(cfg.runtime)
    seed, draws = _whole(cfg, "seed", 0), _whole(cfg, "draws", 1)
    rendered = _rendered(cfg)
    photo = _photo(cfg, rendered).to(device)
    console = Console(stderr=True)
    status = _fingerprint(rendered, console)
    cfg, gate = _gate(cfg, rendered)
    second: SecondStage = build(cfg.generator)
    if isinstance(second, PairedGenerator | DiffusedGenerator):
        second.model.to(device)
    simulator = Simulator(gate, second)
    small = reduced(photo.view)
    sections = [
        view_section(small, photo.real),
        *type_sections(small, seed),
        gate_section(small, _gates(gate, rendered), seed),
        generator_section(photo.view, simulator, seed, photo.real),
    ]
    if isinstance(gate, AdaptiveGate):
        console.print(gate.table(), highlight=False)
    job = open_run(cfg, "simulate", photo.name)
    hidden = not (cfg.runtime.progress and console.is_terminal)
    samples, pictures = [], []
    generators = spawn(draws, torch.Generator().manual_seed(seed))
    for number, generator in enumerate(track(generators, "simulating", console=console, disable=hidden)):
        drawn, view = _drawn(simulator, photo, generator, f"samples/{number:03d}.png")
        _write(job.folder / drawn.file, view)
        samples.append(drawn)
        if number < PICTURED:
            pictures.append((drawn.file, drawn.steps, reduced(view)))
    sections.append(sample_section(pictures, draws))
    _write_pages(job.folder, photo, sections, _provenance(photo, cfg, status, gate))
    _write_record(job.folder, seed, samples, status, gate)
    job.finish()
    page = job.folder / "simulation.html"
    console.print(f"{page}: {draws} samples of {photo.name}", highlight=False, soft_wrap=True)
    return None


def _whole(cfg: DictConfig, key: str, least: int) -> int:
    value = cfg[key]
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InputError(key, f"is {value!r}", f"give a whole number of at least {least}")
    return value


def _rendered(cfg: DictConfig) -> RenderedSet | None:
    """The fitted run, where one was named.

    Raises:
        InputError: a photo and a run were given, or neither, or an option of the one beside the other.
    """
    given = [name for name in ("image", "run") if cfg[name] is not None]
    if len(given) != 1:
        received = "was given image and run" if given else "was given nothing to simulate from"
        raise InputError("simulate", received, "give one of image=FILE, run=FOLDER")
    foreign = {"image": ("view", "step"), "run": ("depth",)}[given[0]]
    stray = next((name for name in foreign if cfg[name] is not None), None)
    if stray is not None:
        raise InputError(stray, f"was given beside {given[0]}", f"leave {stray} out: it has no effect there")
    return read_run(cfg.run, cfg.step) if cfg.run is not None else None


def _photo(cfg: DictConfig, rendered: RenderedSet | None) -> Photographed:
    if rendered is not None:
        return read_held_out(rendered, None if cfg.view is None else str(cfg.view))
    return read_image(cfg.image, cfg.depth, depth_scale=cfg.depth_scale, background=cfg.background)


def _fingerprint(rendered: RenderedSet | None, console: Console) -> Fingerprint | None:
    """Of the run's training views; None without a run, or where the run kept no renders of them."""
    if rendered is None or not any(view.read is not None for view in rendered.references):
        return None
    found = fingerprint_of_training_views(rendered)
    console.print(found.table(), highlight=False)
    return found


def _gate(cfg: DictConfig, rendered: RenderedSet | None) -> tuple[DictConfig, Gate]:
    """The chosen gate; gate=adaptive without a file is calibrated on the run's training views.

    Returns:
        The configuration that is recorded, and the gate.
    """
    if rendered is None or not OmegaConf.is_missing(cfg.gate, "file"):
        return cfg, build(cfg.gate)
    generator = torch.Generator().manual_seed(cfg.seed)
    types = {str(name): on for name, on in cfg.gate.get("types", {}).items()}
    gate = calibrated_on(rendered, generator, types=types)
    settled = copy.deepcopy(cfg)
    settled.gate.file = None  # the run stands for it, and is part of the configuration
    return settled, gate


def _gates(chosen: Gate, rendered: RenderedSet | None) -> dict[str, Gate | str]:
    """The gates to show, by name: the chosen one in the place of its kind, the others as they are by default."""
    photo = "a single photo has no training views to calibrate it on: add gate=adaptive gate.file=FILE, or give run="
    run = "add gate=adaptive to calibrate it on the run's training views, which takes about a minute"
    default: dict[str, Gate | str] = {
        "none": NoGate(),
        "all": AllGate(),
        "random": RandomGate(),
        "adaptive": photo if rendered is None else run,
    }
    kinds = {NoGate: "none", AllGate: "all", RandomGate: "random", AdaptiveGate: "adaptive", MixedGate: "adaptive"}
    kind = kinds.get(type(chosen), type(chosen).__name__)
    others = {name: gate for name, gate in default.items() if name != kind}
    return {f"{kind} (chosen)": chosen, **others}


def _drawn(simulator: Simulator, photo: Photographed, generator: torch.Generator, file: str) -> tuple[Sample, View]:
    """One sample and what its gate drew, which its seed repeats."""
    seed = generator.initial_seed()
    steps = simulator.gate.draw(torch.Generator().manual_seed(seed))
    return Sample(file, seed, steps), simulator(photo.view, [generator], photo.real)


def _write(path: Path, view: View) -> None:
    """Write image, depth and opacity of one sample side by side."""
    write_image(path, view.image[0])
    if view.depth is not None:
        save_array(path.with_name(f"{path.stem}_depth.npy"), view.depth[0, 0].float().cpu().numpy())
    if view.alpha is not None:
        write_image(path.with_name(f"{path.stem}_alpha.png"), view.alpha[0].expand(3, -1, -1))


def _provenance(photo: Photographed, cfg: DictConfig, status: Fingerprint | None, gate: Gate) -> dict[str, str]:
    words = {**photo.origin, "Gate": OmegaConf.to_yaml(cfg.gate).strip()}
    if status is not None:
        words["Fingerprint"] = status.table()
    if isinstance(gate, AdaptiveGate):
        words["Calibrated"] = gate.table()
    return {**words, "Generator": OmegaConf.to_yaml(cfg.generator).strip(), "Seed": str(cfg.seed)}


def _write_pages(folder: Path, photo: Photographed, sections: Sequence[Section], provenance: Mapping[str, str]) -> None:
    """Write a sheet of each section that has one, and the page."""
    for section in sections:
        if section.file and section.rows:
            with whole_file(folder / f"{section.file}.png") as temporary:
                sheet(section).save(temporary)
    height, width = photo.view.image.shape[-2:]
    subtitle = f"{width} x {height} pixels · sheets are made from a copy of at most {EDGE} pixels"
    write_page(folder / "simulation.html", f"Simulated renders of {photo.name}", subtitle, sections, provenance)


def _write_record(folder: Path, seed: int, samples: Sequence[Sample], status: Fingerprint | None, gate: Gate) -> None:
    """Write what determines the samples; a calibrated gate and its fingerprint also as files that other jobs read."""
    record: dict[str, Any] = {"seed": seed, "samples": [asdict(sample) for sample in samples]}
    record["fingerprint"] = None if status is None else asdict(status)
    if status is not None:
        status.to_json(folder / "fingerprint.json")
    if isinstance(gate, AdaptiveGate):
        gate.to_file(folder / "gate.json")
    write_text(folder / "simulation.json", json.dumps(record, indent=1) + "\n")
