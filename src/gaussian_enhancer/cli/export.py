"""The job ``export``: export a network with its weights as a program for other runtimes."""

import logging
from pathlib import Path

from omegaconf import DictConfig

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.export import ENDINGS, export_network
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.runtime import start


def run(cfg: DictConfig) -> float | None:
    """Export the network as a program, and compare the outputs of the two.

    Args:
        cfg: see ``conf/export.yaml``.

    Returns:
        The largest difference between the program's output and the network's.

    Raises:
        InputError: weights, format or number of references cannot be used, or the file cannot be written.
    """
    if cfg.format not in ENDINGS:
        raise InputError("format", f"is {cfg.format!r}", f"choose one of {', '.join(ENDINGS)}")
    start(cfg.runtime)
    for logger_name in ("onnx_ir", "onnxscript"):  # they log a line for each node that they simplify
        logging.getLogger(logger_name).setLevel(logging.WARNING)
    pretrained = load_weights(cfg.weights)
    path = Path(cfg.output or ".") / f"{Path(cfg.weights).stem}{ENDINGS[cfg.format]}"
    signature, difference = export_network(pretrained, path, cfg.format, cfg.references)
    print(
        f"{path}: {', '.join(signature.inputs)}; {signature.references} references, sides multiples of "
        f"{signature.stride}, output {signature.scale} times the render's size"
    )
    print(f"largest difference from the network on random inputs: {difference:.2e}")
    return difference
