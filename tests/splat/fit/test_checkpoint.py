"""The checkpoint of an interrupted fit."""

import torch

from gaussian_enhancer.splat.fit.checkpoint import load_checkpoint, save_checkpoint


def test_a_checkpoint_that_was_written_on_a_gpu_is_read_without_one(tmp_path, monkeypatch) -> None:
    means = torch.arange(6.0).view(2, 3)
    with monkeypatch.context() as gpu:
        gpu.setattr(torch.serialization, "location_tag", lambda storage: "cuda:0")
        save_checkpoint(tmp_path, {"identity": "fit", "step": 3, "splat": {"means": means}})
    checkpoint = load_checkpoint(tmp_path, "fit")
    assert checkpoint is not None
    assert checkpoint["splat"]["means"].device.type == "cpu"
    assert checkpoint["splat"]["means"].equal(means)
