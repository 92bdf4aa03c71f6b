"""Prepares the settings of the job tradeoff: finds weights, builds enhancers, compiles networks once."""

from collections.abc import Callable
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig, open_dict
from torch import Tensor

from ablations.study.description import MethodDescription, TableDescription
from ablations.suite.descriptions import USUAL, Experiment
from ablations.suite.evaluation import compose_checked, with_plan
from ablations.suite.method_runs import Runs
from ablations.tradeoff.settings import NULL_NETWORKS, Setting
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli.train import naming_configuration
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.runs.enhancement import load_enhancement
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import find_run
from gaussian_enhancer.scene.rendered import RenderedSet

TRAIN = "let it be made: train_missing=true"

Enhance = Callable[[RenderedSet], Float[Tensor, "3 _ _"]]
"""A function that returns the enhanced first target of a set."""


class SettingLoader:
    """Loads settings for measurement.

    Args:
        cfg: conf/tradeoff.yaml, composed.
        device: device of the networks.
        folder: for weights files of networks without trained weights.
    """

    def __init__(self, cfg: DictConfig, device: torch.device, folder: Path) -> None:
        self.cfg, self.device, self.folder = cfg, device, folder
        self.runs = Runs(cfg)
        self._compiled: dict[str, Network] = {}

    def weights(self, setting: Setting) -> str:
        """The weights of a setting.

        Raises:
            InputError: they are not trained yet, or the setting cannot be measured on this device.
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
        run = find_run(naming_configuration(self.runs.train_job(training, setting.name, seed)), "train")
        if not self.cfg.train_missing and (run is None or not run.done):
            overrides = f"{' '.join(setting.train)} seed={seed}"
            raise InputError(f"the training {overrides}", f"is not made yet at scale {self.cfg.scale.name}", TRAIN)
        return self.runs.weights(training, setting.name, seed)

    def enhance(self, setting: Setting, weights: str, run: Path) -> Enhance:
        """A function that enhances views of a run by a setting; nothing is computed yet.

        Args:
            setting: the setting.
            weights: weights of the setting.
            run: the fit that the views belong to.

        Raises:
            InputError: the setting's overrides are invalid, or its weights cannot be used.
        """
        job = compose_checked("enhance", self.cfg, with_plan(setting.enhance))
        with open_dict(job):
            job.update({"weights": weights, "run": str(run), "earlier_step": None})
        enhancer, *_ = load_enhancement(job, self.device)
        if setting.compiled:
            if setting.name not in self._compiled:  # once: compiling takes a minute
                enhancer.network.compile()
                self._compiled[setting.name] = enhancer.network
            enhancer.network = self._compiled[setting.name]
        plan_rules = build(job.plan)

        def enhanced(view: RenderedSet) -> Float[Tensor, "3 _ _"]:
            planner = None if plan_rules.full else Planner(plan_rules, enhancer.reference_config, view)
            image = next(enhancer(view, planner)).image
            return upsample_bicubic(image[None], 4)[0].clamp(0, 1) if setting.upscale else image

        return enhanced


def _training(cfg: DictConfig, setting: Setting) -> Experiment:
    """An experiment with one trained method, so that its training has the digest that the suite uses."""
    train = (*cfg.scale.trainings[USUAL].train, *setting.train)
    methods = {setting.name: MethodDescription(setting.name, train=train, role="")}
    seeds = tuple(cfg.scale.seeds[:1])
    table = TableDescription("tradeoff", "", "quality", "", methods, setting.name, (), (), {}, seeds)
    return Experiment(table, (), {setting.name: USUAL})
