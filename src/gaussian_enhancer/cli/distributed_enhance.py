"""Enhances a set's views in several processes, each for a part of the views, with Lightning's prediction loop."""

import os
from dataclasses import replace
from pathlib import Path

import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.strategies import DDPStrategy
from omegaconf import DictConfig
from torch.utils.data import DataLoader

from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.infer.enhancer import EnhancedView, SetEnhancer
from gaussian_enhancer.infer.plan import Plan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.runs.enhancement import load_enhancement
from gaussian_enhancer.runs.output import write_enhanced_view
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.train.processes import launch
from gaussian_enhancer.train.share import gather
from gaussian_enhancer.train.trainer import raise_interrupt, silence_lightning


class Prediction(LightningModule):
    """Lightning module that enhances and writes one view per prediction step.

    Args:
        enhancer: the network with its reference configuration; it stays on its own device.
        rendered: the whole set.
        folder: folder of the enhanced images.
        planner: decides which regions of a view are enhanced, and with which references; None enhances every pixel.
    """

    def __init__(self, enhancer: SetEnhancer, rendered: RenderedSet, folder: Path, planner: Planner | None) -> None:
        super().__init__()
        self.enhancer, self.rendered, self.folder, self.planner = enhancer, rendered, folder, planner
        self.pool = ReferencePool(rendered.references)  # references stay in memory for the following views
        self.written: list[EnhancedView] = []

    def predict_step(self, batch: int, index: int) -> None:
        """Enhance and write a view.

        Args:
            batch: index of the view in the set; Lightning cannot pass the view itself, which is a frozen dataclass.
            index: index of the step.
        """
        view = replace(self.rendered, targets=(self.rendered.targets[int(batch)],))
        (enhanced,) = self.enhancer(view, self.planner, self.pool)
        write_enhanced_view(enhanced, self.folder, view.targets[0], self.enhancer.network.scale)
        # Keep no inference tensors, and little enough for a pipe: no pixels, and no plans, which the caller has.
        self.written.append(replace(enhanced, image=torch.empty(3, 0, 0), plan=None))


def enhance_in_processes(
    folder: Path, plan: Plan, cfg: DictConfig, accelerator: str, processes: int
) -> list[EnhancedView]:
    """Enhance a set in several processes by a finished plan.

    Args:
        folder: folder of the enhanced images.
        plan: which regions of each view are enhanced.
        cfg: configuration of the job ``enhance``.
        accelerator: Lightning's name of the device type.
        processes: number of processes, from 2 to the number of views.

    Returns:
        All views in the set's order, without their pixels and plans.

    Raises:
        InputError: a process refuses its input.
    """
    enhanced_views: list[EnhancedView] = launch(_enhance_part, cfg, accelerator, processes, folder, plan, processes)
    return enhanced_views


def _enhance_part(cfg: DictConfig, folder: Path, plan: Plan, processes: int) -> list[EnhancedView]:
    """Enhance this process's part of the views and write the images; return the views of all processes.

    Lightning distributes the views among the processes: each view is enhanced exactly once.
    """
    device = start(cfg.runtime)
    device = torch.device("cuda", int(os.environ["LOCAL_RANK"])) if device.type == "cuda" else device
    enhancer, task, validated = load_enhancement(cfg, device)
    targets = task.rendered.targets
    silence_lightning()
    trainer = Trainer(
        accelerator=device.type,
        devices=processes,
        strategy=DDPStrategy(),
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        enable_progress_bar=cfg.runtime.progress,
    )
    module = Prediction(enhancer, task.rendered, folder, validated.planner(plan.rules, plan.views))
    indices: DataLoader[int] = DataLoader(range(len(targets)), batch_size=None)  # type: ignore[arg-type]
    with raise_interrupt(trainer):
        trainer.predict(module, indices, return_predictions=False)
    enhanced_views = {enhanced.name: enhanced for enhanced in gather(module.written)}
    return [enhanced_views[view.name] for view in targets]
