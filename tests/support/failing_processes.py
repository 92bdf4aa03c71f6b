"""What a process of several may do; in a module of its own, which started processes find by name."""

import os
import signal
import time

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.processes import Place


def refuses(cfg, place: Place) -> None:
    if place.rank == 1:
        raise InputError("a", "is bad", "mend it")
    time.sleep(3600)  # waits for the other


def dies(cfg, place: Place) -> None:
    if place.rank == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(3600)
