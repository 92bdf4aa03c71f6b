"""Trainings that the user or the system stops."""

import signal
import sys
from types import SimpleNamespace

import pytest
import torch
from omegaconf import OmegaConf

from gaussian_enhancer.errors import LostProcessError
from gaussian_enhancer.train.processes import launch
from gaussian_enhancer.train.trainer import raise_interrupt


def ended(trainer):
    """As Lightning ends the process after Ctrl-C."""
    with raise_interrupt(trainer):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sys.exit(1)


@pytest.mark.parametrize(("interrupted", "error"), [(True, KeyboardInterrupt), (False, SystemExit)])
def test_ctrl_c_stays_ctrl_c_and_works_again(interrupted, error):
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(error):
        ended(SimpleNamespace(interrupted=interrupted))
    assert signal.getsignal(signal.SIGINT) is before


def test_a_killed_process_of_a_shared_training_is_named(monkeypatch):
    class Fabric:
        def __init__(self, **_):
            pass

        def launch(self, *_):
            raise torch.multiprocessing.ProcessExitedException("killed", error_index=0, error_pid=1, exit_code=-9)

    monkeypatch.setattr("lightning.fabric.Fabric", Fabric)
    with pytest.raises(LostProcessError, match="one of 2 processes was killed"):
        launch(print, OmegaConf.create({"runtime": {"threads": 1}}), "cpu", 2)
