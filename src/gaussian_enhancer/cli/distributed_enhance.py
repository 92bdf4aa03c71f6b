"""Several processes enhance the views of a set, each its own part, in Lightning's prediction loop."""

import os
from dataclasses import replace
from pathlib import Path

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.strategies import DDPStrategy
from omegaconf import DictConfig
from torch.utils.data import DataLoader

from gaussian_enhancer.align.references import Pool
from gaussian_enhancer.infer.enhancer import Enhanced, SetEnhancer
from gaussian_enhancer.infer.plan import Plan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.runs.enhancement import ready
from gaussian_enhancer.runs.output import write_one
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.train.processes import launch
from gaussian_enhancer.train.share import gathered
from gaussian_enhancer.train.trainer import quieten, stopped_by_ctrl_c


class Prediction(LightningModule):
    """Enhances one view a step and writes it.

    Args:
        enhancer: the network with its reference configuration; it stays on its own device.
        rendered: the whole set.
        folder: where images are written.
        planner: leaves out what a view does not need.
    """

    def __init__(
        self, enhancer: SetEnhancer, rendered: RenderedSet, folder: Path, planner: Planner | None = None
    ) -> None:
        super().__init__()
        self.enhancer, self.rendered, self.folder, self.planner = enhancer, rendered, folder, planner
        self.pool = Pool(rendered.references)  # references that were read for one view serve the next
        self.written: list[Enhanced] = []

    def predict_step(self, batch: int, index: int) -> None:
        """Enhance and write a view.

        Args:
            batch: the view's place in the set; Lightning cannot carry the view, which is a frozen dataclass.
            index: of the step.
        """
        view = replace(self.rendered, targets=(self.rendered.targets[int(batch)],))
        (one,) = self.enhancer(view, self.planner, self.pool)
        write_one(one, self.folder, view.targets[0], self.enhancer.network.scale)
        # No tensor of inference mode, and no more than a pipe holds: who plans ahead knows the plans.
        self.written.append(replace(one, image=torch.empty(3, 0, 0), plan=None))


def predicted(
    enhancer: SetEnhancer,
    rendered: RenderedSet,
    folder: Path,
    count: int,
    progress: bool,
    planner: Planner | None = None,
) -> list[Enhanced]:
    """Enhance this process's part of a set's targets and write the images.

    Lightning gives each process its part of the views: none twice, none left out.

    Args:
        enhancer: the network with its reference configuration.
        rendered: the whole set, of at least as many targets as there are processes.
        folder: where images are written.
        count: of processes.
        progress: show a bar.
        planner: leaves out what a view does not need; None enhances all of it.

    Returns:
        All views, those of the other processes included, in the set's order, without their pixels and plans.
    """
    quieten()
    trainer = Trainer(
        accelerator=enhancer.device.type,
        devices=count,
        strategy=DDPStrategy() if count > 1 else "auto",
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        enable_progress_bar=progress,
    )
    module = Prediction(enhancer, rendered, folder, planner)
    views: DataLoader[int] = DataLoader(range(len(rendered.targets)), batch_size=None)  # type: ignore[arg-type]
    with stopped_by_ctrl_c(trainer):
        trainer.predict(module, views, return_predictions=False)
    found = {one.name: one for one in gathered(module.written)}
    return [found[view.name] for view in rendered.targets]


def enhanced_together(folder: Path, plan: Plan, cfg: DictConfig, accelerator: str, processes: int) -> list[Enhanced]:
    """Enhance by several processes, by a plan that is made.

    Args:
        folder: where images are written.
        plan: what of each view is enhanced.
        cfg: configuration of the job ``enhance``.
        accelerator: Lightning's name of the devices.
        processes: how many; at most as many as there are views.

    Returns:
        All views in the set's order, without their pixels and plans.

    Raises:
        InputError: a process refuses its input.
    """
    every: list[Enhanced] = launch(_part, cfg, accelerator, processes, folder, plan, processes)
    return every


def _part(cfg: DictConfig, folder: Path, plan: Plan, processes: int) -> list[Enhanced]:
    """Enhance one process's part of the views."""
    device = start(cfg.runtime)
    device = torch.device("cuda", int(os.environ["LOCAL_RANK"])) if device.type == "cuda" else device
    enhancer, task, found = ready(cfg, device)
    planner = found.planner(plan.rules, plan.views)
    return predicted(enhancer, task.rendered, folder, processes, cfg.runtime.progress, planner)
