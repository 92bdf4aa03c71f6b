"""The job ``train``: train an enhancement network on fitted runs."""

import copy
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, open_dict

from gaussian_enhancer.checkpoint import WEIGHTS, checkpoint_digest, find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.infer.weights import (
    PARTS,
    copy_values,
    count_parameters,
    design_of,
    load_weights,
    reference_config_of,
    require_saveable,
    save_weights,
)
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos
from gaussian_enhancer.runs.instantiate import build, plain_values, require
from gaussian_enhancer.runs.run import Run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.train.processes import is_first, launch
from gaussian_enhancer.train.trainer import (
    make_trainer,
    raise_interrupt,
    result_configuration,
    silence_lightning,
    spawn_count,
)

if TYPE_CHECKING:
    from gaussian_enhancer.network.network import Network
    from gaussian_enhancer.train.data import RunsData


def run(cfg: DictConfig) -> float | None:
    """Train, or resume a killed training; write ``weights.safetensors`` and its card.

    With ``trainer.devices=2``, two processes train together, each on half of every batch. The result is that of one
    process.

    Returns:
        The mean gain in PSNR over the raw renders of the validation runs, in dB; None where the training was stopped.
    """
    cfg = _without_unused_keys(cfg)
    require(cfg)
    start(cfg.runtime)
    count = spawn_count(cfg)
    job = open_run(_with_digests(cfg), "train", cfg.label, locked=is_first())
    if job.done:
        print(f"trained already: {job.folder / WEIGHTS}")
        return float(json.loads((job.folder / "card.json").read_text())["validation"]["gain/psnr"])
    silence_lightning()
    require_saveable(_network(cfg))
    if count > 1:  # prepare all samples first: it may take long, and the other processes would wait for them
        _data(cfg).prepare_data()
    gain: float | None = launch(_train, cfg, cfg.trainer.accelerator, count, job)
    return gain


def _train(cfg: DictConfig, job: Run) -> float | None:
    """Train in one of the processes; the first process writes weights and card."""
    # Slow imports, which are not needed to show help.
    from lightning import seed_everything

    from gaussian_enhancer.train.loggers import finish_wandb_run
    from gaussian_enhancer.train.metrics import gains, psnr, ssim
    from gaussian_enhancer.train.module import EnhancerModule

    start(cfg.runtime)
    silence_lightning()
    seed_everything(cfg.seed, workers=True, verbose=False)
    data = _data(cfg)
    module_parts = build(cfg.loss), gains(psnr=psnr, ssim=ssim), build(cfg.optimizer), build(cfg.lr_scheduler)
    module = EnhancerModule(_network(cfg), *module_parts, coarse=cfg.coarse, bad_share=_bad_share(cfg))
    trainer = make_trainer(cfg, job, "last")
    checkpoint = job.folder / "last.ckpt"
    resumed, started = checkpoint.is_file(), time.time()
    with finish_wandb_run(trainer.loggers), raise_interrupt(trainer):
        trainer.fit(module, datamodule=data, ckpt_path=str(checkpoint) if resumed else None, weights_only=True)
        if trainer.interrupted or (trainer.global_step < cfg.trainer.max_steps and cfg.trainer.get("max_time") is None):
            print(f"stopped after {trainer.global_step} steps; the same command resumes")
            return None
        validation = {name: float(value) for name, value in trainer.validate(module, data, verbose=False)[0].items()}
    non_finite = module.non_finite.dropped_by_all()
    if not trainer.is_global_zero:
        return None
    reference_config = build(cfg.reference_config)
    card = {
        **plain_values(cfg.card),
        "design": design_of(module.network),
        "reference_config": reference_config_of(reference_config),
        "parameters": count_parameters(module.network),
        "steps": trainer.global_step,
        "minutes": None if resumed else round((time.time() - started) / 60, 1),
        "simulated": float(cfg.data.simulation.share) if "simulation" in cfg.data else 0.0,
        "train": list(cfg.data.train),
        "samples": sum(len(source) for source in data.sources),
        "validation": validation,
        "seed": int(cfg.seed),
        "run": job.digest,
        **_initial_weights_entry(cfg),
        **({"frozen": list(cfg.frozen)} if cfg.get("frozen") else {}),
        **({"dropped": non_finite} if non_finite else {}),
    }
    save_weights(job.folder / WEIGHTS, module.network, reference_config, card)  # type: ignore[arg-type]
    write_json(job.folder / "card.json", card, indent=2)
    job.finish()
    print(f"{job.folder / WEIGHTS}: " + ", ".join(f"{k} {v:+.4f}" for k, v in validation.items()))
    return validation["gain/psnr"]


def _network(cfg: DictConfig) -> "Network":
    """Build the network to train, untrained or with the values of the weights ``initial``, its ``frozen`` parts fixed.

    Raises:
        InputError: the initial weights cannot be read, or their design differs from the configuration's network; or
            there is no part of a name.
    """
    network: Network = build(cfg.fusion)
    if cfg.get("faithful") and not type(network).__module__.startswith("gaussian_enhancer.network.paper."):
        remedy = "choose fusion=sif, ssif_lr or ssif_sr, or mode=ours"
        raise InputError("mode=paper", f"has no {type(network).__name__}", remedy)
    for name, weights in _initial_weights(cfg).items():
        part, source = network, load_weights(weights).network
        if name:
            part = _part_of(network, name, "initial")
            source = _part_of(source, name, "initial") if type(source) is type(network) else source
        try:
            copy_values(part, source)
        except ValueError as error:
            raise InputError(f"weights {weights}", str(error), "choose fusion and size as they have") from None
    for name in cfg.get("frozen", ()):
        _part_of(network, name, "frozen").requires_grad_(False)
    return network


def _part_of(network: "Network", name: str, option: str) -> "Network":
    """The network within a cascade that an option names.

    Raises:
        InputError: there is none of this name.
    """
    part: Network | None = getattr(network, name, None) if name in PARTS else None
    if part is None:
        raise InputError(option, f"names {name!r}, no part of the network", "name parts of fusion=cascade, or weights")
    return part


def _initial_weights(cfg: DictConfig) -> dict[str, str]:
    """Initial weights by the name of the part of the network that they initialise; "" stands for the whole network.

    Weights of a whole cascade initialise a part with their own part of that name.
    """
    initial = cfg.get("initial")
    if initial is None:
        return {}
    weights_by_part = initial if isinstance(initial, DictConfig) else {"": initial}
    return {str(name): str(weights) for name, weights in weights_by_part.items()}


def _initial_weights_entry(cfg: DictConfig) -> dict[str, Any]:
    """The card's entry on the initial weights: selected entries of their cards, which may nest earlier weights."""
    kept_keys = ("run", "seed", "steps", "train", "minutes", "initial")
    cards = {name: load_weights(weights).card for name, weights in _initial_weights(cfg).items()}
    entries = {name: {key: card[key] for key in kept_keys if key in card} for name, card in cards.items()}
    return {"initial": entries.get("", entries)} if entries else {}


def _data(cfg: DictConfig) -> "RunsData":
    fine_photos = HighResolutionPhotos(Path(cfg.runs) / "photos")
    samples = {
        "cache": str(Path(cfg.runs) / "samples"),
        "finer": fine_photos,
        "bad_share": _bad_share(cfg),
        "progress": cfg.runtime.progress,
    }
    data: RunsData = build(cfg.data, samples=samples)
    return data


def _bad_share(cfg: DictConfig) -> float:
    """Share of samples that may be dropped because they are not finite.

    The option is not part of a run's hash, so a configuration reduced to the hashed keys lacks it.
    """
    from gaussian_enhancer.train.non_finite import BAD_SHARE

    return float(cfg.get("bad_share", BAD_SHARE))


def naming_configuration(cfg: DictConfig) -> DictConfig:
    """Configuration that names the run's folder: the part that determines the trained network.

    Args:
        cfg: the complete configuration of the job.

    Raises:
        InputError: the initial weights cannot be read.
    """
    return _with_digests(_without_unused_keys(cfg))


def _with_digests(cfg: DictConfig) -> DictConfig:
    """A configuration without keys that change no result, and with digests in place of the weights' paths."""
    configuration = result_configuration(cfg)
    digests = {
        name: checkpoint_digest(find_checkpoint(weights)) for name, weights in _initial_weights(configuration).items()
    }
    if digests:  # the run depends on the content of the weights, not on their path
        configuration.initial = digests.get("", digests)
    if configuration.get("generator") and configuration.generator.get("weights"):
        configuration.generator.weights = _second_stage_digest(str(configuration.generator.weights))
    return configuration


def _second_stage_digest(weights: str) -> str:
    """Identifier of a second stage's weights: the run that produces them, which may not exist yet, or their digest."""
    run = Path(weights).parent
    return run.name if run.parent.name == "train_generator" else checkpoint_digest(find_checkpoint(weights))


def _without_unused_keys(cfg: DictConfig) -> DictConfig:
    """The configuration without keys of no effect, which are then neither built nor part of the run's name.

    These keys are the simulator with its gate and generator if nothing is simulated, and ``initial`` and ``frozen`` if
    they are empty.
    """
    reduced = copy.deepcopy(cfg)
    with open_dict(reduced):
        for key in ("initial", "frozen"):
            if not reduced.get(key):
                reduced.pop(key, None)
        if reduced.data.simulation.share == 0:
            for key in ("gate", "generator"):
                reduced.pop(key)
            reduced.data.pop("simulation")
    return reduced
