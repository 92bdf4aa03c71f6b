"""What a process of several may do; in a module of its own, which started processes find by name."""

import atexit
import os
import signal
import time
from pathlib import Path

import torch

from gaussian_enhancer.errors import InputError


def refuses(cfg) -> None:
    if os.environ["LOCAL_RANK"] == "1":
        raise InputError("a", "is bad", "mend it")
    time.sleep(3600)  # waits for the other


def dies(cfg) -> None:
    if os.environ["LOCAL_RANK"] == "1":
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(3600)


def notes_its_end(cfg, folder: Path) -> None:
    assert torch.distributed.is_initialized()
    note = folder / os.environ["LOCAL_RANK"]
    atexit.register(lambda: note.write_text(str(torch.distributed.is_initialized())))
