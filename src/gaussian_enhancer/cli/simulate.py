"""The job ``simulate``: make a photo look like splat renders; write samples and a page of every artefact."""

import torch
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import track

from gaussian_enhancer.console import hides_progress, print_line
from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.gates.adaptive import AdaptiveGate
from gaussian_enhancer.degrade.generative.second_stage import DiffusedGenerator, PairedGenerator
from gaussian_enhancer.degrade.simulator import SecondStage, Simulator
from gaussian_enhancer.report.simulation_files import (
    SimulatedRender,
    provenance,
    write_record,
    write_sample,
    write_sheets,
)
from gaussian_enhancer.report.simulation_parts import (
    gate_section,
    generator_section,
    sample_section,
    shrink_view,
    type_sections,
    view_section,
)
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.runs.simulation import (
    choose_gate,
    choose_photo,
    gates_to_show,
    read_fitted_run,
    run_fingerprint,
)

PICTURED = 20
"""Maximum number of samples shown on the page; all samples are written."""


def run(cfg: DictConfig) -> None:
    """Simulate renders of one photo; write samples, sheets, a page and a record of the random draws.

    Nothing is written before all input is read and stage 2 has run once.

    Args:
        cfg: see ``conf/simulate.yaml``.

    Raises:
        InputError: the photo, run, gate or generator cannot be used, or a file cannot be written.
    """
    device = start(cfg.runtime)
    rendered = read_fitted_run(cfg)
    photo = choose_photo(cfg, rendered).to(device)
    console = Console(stderr=True)
    fingerprint = run_fingerprint(rendered)
    if fingerprint is not None:
        console.print(fingerprint.table(), highlight=False)
    cfg, gate = choose_gate(cfg, rendered)
    second_stage: SecondStage = build(cfg.generator)
    if isinstance(second_stage, PairedGenerator | DiffusedGenerator):
        second_stage.model.to(device)
    simulator = Simulator(gate, second_stage)
    reduced_view = shrink_view(photo.view)
    sections = [
        view_section(reduced_view, photo.real),
        *type_sections(reduced_view, cfg.seed),
        gate_section(reduced_view, gates_to_show(gate, rendered), cfg.seed),
        generator_section(photo.view, simulator, cfg.seed, photo.real),
    ]
    if isinstance(gate, AdaptiveGate):
        console.print(gate.table(), highlight=False)
    job = open_run(cfg, "simulate", photo.name, reused=False)
    progress_hidden = hides_progress(cfg, console)
    samples, pictures = [], []
    generators = spawn(cfg.draws, torch.Generator().manual_seed(cfg.seed))
    for number, generator in enumerate(track(generators, "simulating", console=console, disable=progress_hidden)):
        file, seed = f"samples/{number:03d}.png", generator.initial_seed()
        steps = simulator.gate.draw(torch.Generator().manual_seed(seed))  # as the simulator draws them
        view = simulator(photo.view, [generator], photo.real)
        write_sample(job.folder / file, view)
        samples.append(SimulatedRender(file, seed, steps))
        if number < PICTURED:
            pictures.append((file, steps, shrink_view(view)))
    sections.append(sample_section(pictures, cfg.draws))
    write_sheets(job.folder, photo, sections, provenance(photo, cfg, fingerprint, gate))
    write_record(job.folder, cfg.seed, samples, fingerprint, gate)
    job.finish()
    print_line(console, f"{job.folder / 'simulation.html'}: {cfg.draws} samples of {photo.name}")
