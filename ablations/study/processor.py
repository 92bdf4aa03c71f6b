"""Measurements that are made on the processor alone."""

import torch

from gaussian_enhancer.errors import InputError


def refuse_gpu(device: torch.device) -> None:
    """Refuse a GPU for a job that would compute on the processor all the same, and whose records would not say so.

    Args:
        device: device of the job.

    Raises:
        InputError: the device is not the processor.
    """
    if device.type != "cpu":
        raise InputError("runtime.device", f"is {device.type}, but this job computes on the processor", "choose cpu")
