"""The job ``export``: from a weights file to a program that says what it takes."""

from pathlib import Path

import pytest
import torch

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli import export
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.export import load_program
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.network.sif import SIF
from support.job_config import job_config


def job(*overrides: str):
    return job_config("export", *overrides, "runtime.threads=1")


def test_a_weights_file_becomes_a_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch.manual_seed(0)
    save_weights(
        tmp_path / "small.safetensors", SIF(widths=(8, 8), blocks=(1, 1)), ReferenceConfig(), {"name": "small"}
    )
    difference = export.run(job(f"weights={tmp_path}/small.safetensors", f"output={tmp_path}/programs", "references=1"))
    assert difference is not None
    assert difference < 1e-4
    stdout = capsys.readouterr().out
    assert "1 references, sides multiples of 4" in stdout
    signature = load_program(tmp_path / "programs" / "small.onnx").signature
    assert (signature.name, signature.references, signature.scale) == ("small", 1, 1)


def test_an_unknown_format_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="choose one of onnx, torch_export"):
        export.run(job("format=tflite", f"output={tmp_path}/programs"))
    assert not (tmp_path / "programs").exists()
