"""The job ``train_generator``: train the second stage of the simulator on fitted runs, in two steps."""

import json
import time
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from rich.console import Console

from gaussian_enhancer.checkpoint import WEIGHTS
from gaussian_enhancer.console import print_line
from gaussian_enhancer.degrade.generative.second_stage import FactorDesign, FactorModel
from gaussian_enhancer.degrade.generative.weights import load_model, save_model
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json, write_text
from gaussian_enhancer.infer.weights import count_parameters
from gaussian_enhancer.runs.instantiate import build, plain_values, require
from gaussian_enhancer.runs.run import Run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.train.trainer import (
    device_count,
    make_trainer,
    raise_interrupt,
    result_configuration,
    silence_lightning,
)

STEPS = ("paired", "diffused")


def run(cfg: DictConfig) -> float | None:
    """Train, or resume a killed training; write ``weights.safetensors`` and its card.

    Returns:
        Gain in PSNR over stage 1's output, in dB, against real renders of sampled views of the validation runs; None
        if the training was stopped.
    """
    require(cfg)
    start(cfg.runtime)
    if device_count(cfg) > 1:
        received = f"is {cfg.trainer.devices}, but the simulator's noise is drawn for whole batches"
        raise InputError("trainer.devices", received, "train it with trainer.devices=1")
    job = open_run(result_configuration(cfg), "train_generator", cfg.label)
    console = Console(stderr=True)
    weights = job.folder / WEIGHTS
    if job.done:
        print_line(console, f"trained already: {weights}")
        return float(json.loads((job.folder / "card.json").read_text())["validation"]["gain/diffused"])
    # Slow imports, which are not needed to show help.
    from lightning import seed_everything

    silence_lightning()
    seed_everything(cfg.seed, workers=True, verbose=False)
    samples = {"cache": str(Path(cfg.runs) / "samples"), "progress": cfg.runtime.progress}
    data = build(cfg.data, samples=samples)
    design: FactorDesign = build(cfg.design)
    resumed = any((job.folder / f"{step}{ending}").is_file() for step in STEPS for ending in (".ckpt", ".safetensors"))
    started = time.time()
    validation = _train_steps(cfg, job, design, data)
    if validation is None:
        console.print("stopped; the same command resumes")
        return None
    model = load_model(job.folder / f"{STEPS[-1]}.safetensors").model
    card: dict[str, Any] = {
        **plain_values(cfg.card),
        "parameters": count_parameters(model),
        "steps": {step: int(cfg[step].steps) for step in STEPS},
        "minutes": None if resumed else round((time.time() - started) / 60, 1),
        "train": list(cfg.data.train),
        "samples": sum(len(source) for source in data.sources),
        "gate": plain_values(cfg.gate),
        "validation": validation,
        "run": job.digest,
    }
    save_model(weights, model, card)
    write_json(job.folder / "card.json", card, indent=2)
    job.finish()
    summary = ", ".join(f"{k} {v:+.4f}" for k, v in validation.items())
    print_line(console, f"{weights}: {summary}")
    return validation["gain/diffused"]


def _train_steps(cfg: DictConfig, job: Run, design: FactorDesign, data: Any) -> dict[str, float] | None:
    """Train the steps that are not done yet; return the validation of all, or None if the training was stopped."""
    validation: dict[str, float] = {}
    for step in STEPS:
        if not (job.folder / f"{step}.safetensors").is_file():
            step_validation = _train_step(cfg, job, step, design, data)
            if step_validation is None:
                return None
        validation |= json.loads((job.folder / f"{step}.json").read_text())
    return validation


def _train_step(cfg: DictConfig, job: Run, step: str, design: FactorDesign, data: Any) -> dict[str, float] | None:
    """Train one step, save the EMA of its weights, and return its validation; None if the training was stopped."""
    from gaussian_enhancer.train.generator import DiffusedModule, PairedModule
    from gaussian_enhancer.train.loggers import finish_wandb_run

    steps = int(cfg[step].steps)
    loss, optimizer, scheduler = build(cfg.generator_loss), build(cfg[step].optimizer), build(cfg[step].lr_scheduler)
    module: PairedModule | DiffusedModule
    if step == "paired":
        module = PairedModule(FactorModel(design), loss, optimizer, scheduler, seed=cfg.seed)
    else:
        paired_model = load_model(job.folder / "paired.safetensors").model
        module = DiffusedModule(paired_model, loss, optimizer, build(cfg.sampler), scheduler, seed=cfg.seed + 1)
    trainer = make_trainer(cfg, job, step, name=step, max_steps=steps)
    checkpoint = job.folder / f"{step}.ckpt"
    with finish_wandb_run(trainer.loggers), raise_interrupt(trainer):
        trainer.fit(
            module, datamodule=data, ckpt_path=str(checkpoint) if checkpoint.is_file() else None, weights_only=True
        )
        if trainer.interrupted or trainer.global_step < steps:
            return None
        validation = {name: float(value) for name, value in trainer.validate(module, data, verbose=False)[0].items()}
    write_text(job.folder / f"{step}.json", json.dumps(validation))
    save_model(job.folder / f"{step}.safetensors", module.model, {})  # last: its file marks the step as done
    return validation
