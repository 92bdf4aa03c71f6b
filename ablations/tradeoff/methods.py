"""Settings of the job tradeoff made ready to be called: weights found, enhancers built, networks compiled once."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig, open_dict
from torch import Tensor

from ablations.study.description import Method, TableDescription
from ablations.suite.descriptions import Experiment
from ablations.suite.evaluation import composed
from ablations.suite.method_runs import Runs
from ablations.tradeoff.settings import NULL_NETWORKS, Setting
from gaussian_enhancer.align.alignment import Unwarped
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli.enhance import ready
from gaussian_enhancer.cli.train import with_effect
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import upsampled
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import find_run
from gaussian_enhancer.scene.rendered import RenderedSet

TRAIN = "let it be made: train_missing=true"

Enhance = Callable[[RenderedSet], Float[Tensor, "3 _ _"]]
"""The first target of a set, enhanced."""


@dataclass
class SettingLoader:
    """Makes settings ready to be called.

    Args:
        cfg: conf/tradeoff.yaml, composed.
        device: where networks run.
        folder: for the files of networks without weights.
        runs: the suite's runs, where trainings are found.
    """

    cfg: DictConfig
    device: torch.device
    folder: Path
    runs: Runs = field(init=False)
    _compiled: dict[str, Network] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.runs = Runs(self.cfg)

    def weights(self, setting: Setting) -> str:
        """The weights of a setting.

        Raises:
            InputError: they are not trained yet, or cannot be used here.
        """
        if setting.only and setting.only != self.device.type:
            received = f"is measured on {setting.only} alone, and this device is {self.device.type}"
            raise InputError(setting.name, received, f"measure on a machine with {setting.only}")
        if setting.weights:
            return setting.weights
        if setting.network:
            path = self.folder / f"{setting.network}.safetensors"
            save_weights(path, NULL_NETWORKS[setting.network](), ReferenceConfig(references=0, candidates=0), {})
            return str(path)
        training, seed = _training(self.cfg, setting), int(self.cfg.scale.seeds[0])
        found = find_run(with_effect(self.runs.train_job(training, setting.name, seed)), "train")
        if not self.cfg.train_missing and (found is None or not found.done):
            words = f"{' '.join(setting.train)} seed={seed}"
            raise InputError(f"the training {words}", f"is not made yet at scale {self.cfg.scale.name}", TRAIN)
        return self.runs.weights(training, setting.name, seed)

    def enhance(self, setting: Setting, weights: str, run: Path) -> Enhance:
        """What a setting does to views of a run; nothing is computed yet.

        Args:
            setting: how.
            weights: of the setting.
            run: the fit that the views are of.

        Raises:
            InputError: the setting's overrides are refused, or its weights cannot be used.
        """
        planned = any(word.startswith("plan=") for word in setting.enhance)
        job = composed("enhance", self.cfg, setting.enhance if planned else ("plan=full", *setting.enhance))
        with open_dict(job):
            job.update({"weights": weights, "run": str(run)})
        enhancer, *_ = ready(job, self.device)
        if setting.warp == "none":
            enhancer.reference_config = replace(enhancer.reference_config, warp=Unwarped())
        if setting.compiled:
            if setting.name not in self._compiled:  # once: compiling takes a minute
                enhancer.network.compile()
                self._compiled[setting.name] = enhancer.network
            enhancer.network = self._compiled[setting.name]
        rules = build(job.plan)

        def enhanced(view: RenderedSet) -> Float[Tensor, "3 _ _"]:
            planner = None if rules.full else Planner(rules, enhancer.reference_config, view)
            image = next(enhancer(view, planner)).image
            return upsampled(image[None], 4)[0].clamp(0, 1) if setting.upscale else image

        return enhanced


def _training(cfg: DictConfig, setting: Setting) -> Experiment:
    """A table of one trained method, so that its training is found where the suite files it."""
    train = (*cfg.scale.trainings[setting.learns].train, *setting.train)
    methods = {setting.name: Method(title=setting.name, about="", role="", train=train)}
    table = TableDescription(
        "tradeoff", "", "quality", "", methods, setting.name, (), (), {}, tuple(cfg.scale.seeds[:1]), {}, False, ""
    )
    return Experiment(table, (), {setting.name: setting.learns})
