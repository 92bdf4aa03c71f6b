"""The train job: fitted runs to weights."""

import copy
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, open_dict

from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.infer.weights import (
    count_parameters,
    design_of,
    load_weights,
    reference_config_of,
    require_saveable,
    save_weights,
    take_values,
)
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos
from gaussian_enhancer.runs.instantiate import build, plain, require
from gaussian_enhancer.runs.run import Run, open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.train.processes import is_first, launch
from gaussian_enhancer.train.trainer import alike, make_trainer, processes, quieten, stopped_by_ctrl_c

if TYPE_CHECKING:
    from gaussian_enhancer.network.network import Network
    from gaussian_enhancer.train.data import RunsData


def run(cfg: DictConfig) -> float | None:
    """Train, or go on where a killed training stopped; write ``weights.safetensors`` and its card.

    With ``trainer.devices=2`` two processes train together and do what one would: each takes half of every batch.

    Returns:
        The mean gain in PSNR over the raw renders of the validation runs, in dB.
    """
    cfg = _without_idle(cfg)
    require(cfg)
    start(cfg.runtime)
    count = processes(cfg)
    job = open_run(_named(cfg), "train", cfg.label, locked=is_first())
    if job.done:
        print(f"trained already: {job.folder / 'weights.safetensors'}")
        return float(json.loads((job.folder / "card.json").read_text())["validation"]["gain/psnr"])
    quieten()
    require_saveable(_network(cfg))
    if count > 1:  # samples are prepared by one, however long that takes, before the others wait for it
        _data(cfg).prepare_data()
    gain: float | None = launch(_train, cfg, cfg.trainer.accelerator, count, job)
    return gain


def _train(cfg: DictConfig, job: Run) -> float | None:
    """One process's part; the first writes what comes of it."""
    # Heavy, and of no use to those who only ask for help.
    from lightning import seed_everything

    from gaussian_enhancer.train.loggers import watching
    from gaussian_enhancer.train.metrics import gains, psnr, ssim
    from gaussian_enhancer.train.module import EnhancerModule

    start(cfg.runtime)
    quieten()
    seed_everything(cfg.seed, workers=True, verbose=False)
    data = _data(cfg)
    made = build(cfg.loss), gains(psnr=psnr, ssim=ssim), build(cfg.optimizer), build(cfg.lr_scheduler)
    module = EnhancerModule(_network(cfg), *made, coarse=cfg.coarse, bad_share=_bad_share(cfg))
    trainer = make_trainer(cfg, job, "last")
    last = job.folder / "last.ckpt"
    started = time.time()
    with watching(trainer.loggers), stopped_by_ctrl_c(trainer):
        trainer.fit(module, datamodule=data, ckpt_path=str(last) if last.is_file() else None, weights_only=True)
        if trainer.interrupted or (trainer.global_step < cfg.trainer.max_steps and cfg.trainer.get("max_time") is None):
            print(f"stopped after {trainer.global_step} steps; the same command goes on from there")
            return None
        found = {name: float(value) for name, value in trainer.validate(module, data, verbose=False)[0].items()}
    non_finite = module.non_finite.of_all()
    if not trainer.is_global_zero:
        return None
    reference_config = build(cfg.reference_config)
    card = {
        **plain(cfg.card),
        "design": design_of(module.network),
        "reference_config": reference_config_of(reference_config),
        "parameters": count_parameters(module.network),
        "steps": trainer.global_step,
        "minutes": round((time.time() - started) / 60, 1),
        "simulated": float(cfg.data.simulation.share) if "simulation" in cfg.data else 0.0,
        "train": list(cfg.data.train),
        "samples": sum(len(source) for source in data.sources),
        "validation": found,
        "seed": int(cfg.seed),
        "run": job.digest,
        **_told(cfg),
        **({"dropped": non_finite} if non_finite else {}),
    }
    save_weights(job.folder / "weights.safetensors", module.network, reference_config, card)  # type: ignore[arg-type]
    write_text(job.folder / "card.json", json.dumps(card, indent=2) + "\n")
    job.finish()
    print(f"{job.folder / 'weights.safetensors'}: " + ", ".join(f"{k} {v:+.4f}" for k, v in found.items()))
    return found["gain/psnr"]


def _network(cfg: DictConfig) -> "Network":
    """The network to train: untrained, or with the values of the weights ``initial``.

    Raises:
        InputError: those weights cannot be read, or are of another design than the configuration's network.
    """
    network: Network = build(cfg.fusion)
    if cfg.get("faithful") and not type(network).__module__.startswith("gaussian_enhancer.network.paper."):
        remedy = "choose fusion=sif, ssif_lr or ssif_sr, or mode=ours"
        raise InputError("mode=paper", f"has no {type(network).__name__}", remedy)
    for name, weights in _begun_with(cfg).items():
        part = getattr(network, name, None) if name else network
        if part is None:
            raise InputError("initial", f"names {name!r}, no part of the network", "name parts of fusion, or weights")
        try:
            take_values(part, load_weights(weights).network)
        except ValueError as error:
            raise InputError(f"weights {weights}", str(error), "choose fusion and size as they have") from None
    return network


def _begun_with(cfg: DictConfig) -> dict[str, str]:
    """The weights to begin with by the part of the network that they are for, which is empty where it is the whole."""
    initial = cfg.get("initial")
    if initial is None:
        return {}
    parts = initial if isinstance(initial, DictConfig) else {"": initial}
    return {str(name): str(one) for name, one in parts.items()}


def _told(cfg: DictConfig) -> dict[str, Any]:
    """What a card says of the weights that a training began with: the cards of those, one after another."""
    known = ("run", "seed", "steps", "train", "minutes", "initial")
    cards = {name: load_weights(one).card for name, one in _begun_with(cfg).items()}
    told = {name: {key: card[key] for key in known if key in card} for name, card in cards.items()}
    return {"initial": told.get("", told)} if told else {}


def _data(cfg: DictConfig) -> "RunsData":
    finer = HighResolutionPhotos(Path(cfg.runs) / "photos")
    samples = {
        "cache": str(Path(cfg.runs) / "samples"),
        "finer": finer,
        "bad_share": _bad_share(cfg),
        "progress": cfg.runtime.progress,
    }
    data: RunsData = build(cfg.data, samples=samples)
    return data


def _bad_share(cfg: DictConfig) -> float:
    """What a training forgives; no part of its address, and so missing where a configuration was cut down to that."""
    from gaussian_enhancer.train.non_finite import BAD_SHARE

    return float(cfg.get("bad_share", BAD_SHARE))


def with_effect(cfg: DictConfig) -> DictConfig:
    """The configuration as it determines what is trained, which names the run.

    Args:
        cfg: the job's whole configuration.

    Raises:
        InputError: the weights to begin with cannot be read.
    """
    return _named(_without_idle(cfg))


def _named(cfg: DictConfig) -> DictConfig:
    """The configuration that names the run of one without what has no effect."""
    same = alike(cfg)
    digests = {name: checkpoint_digest(find_checkpoint(one)) for name, one in _begun_with(same).items()}
    if digests:  # what they hold, wherever they are
        same.initial = digests.get("", digests)
    if same.get("generator") and same.generator.get("weights"):
        same.generator.weights = _content(str(same.generator.weights))
    return same


def _content(weights: str) -> str:
    """What stands for a second stage's weights in a run's name: the run that they are of, made or not, or a digest."""
    run = Path(weights).parent
    return run.name if run.parent.name == "train_generator" else checkpoint_digest(find_checkpoint(weights))


def _without_idle(cfg: DictConfig) -> DictConfig:
    """The configuration without what has no effect, which is not built and does not make another run of the same.

    That is the simulator with its gate and generator where nothing is simulated, and ``initial`` where none is given.
    """
    without = copy.deepcopy(cfg)
    with open_dict(without):
        if without.get("initial") is None:
            without.pop("initial", None)
        if without.data.simulation.share == 0:
            for key in ("gate", "generator"):
                without.pop(key)
            without.data.pop("simulation")
    return without
