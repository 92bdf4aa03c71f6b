"""What a process of several may do; in a module of its own, which started processes find by name."""

import os
import signal
import time

from gaussian_enhancer.apps.together import Place
from gaussian_enhancer.errors import InputError


def refuses(cfg, place: Place) -> None:
    if place.rank == 1:
        raise InputError("a", "is bad", "mend it")
    time.sleep(3600)  # waits for the other


def dies(cfg, place: Place) -> None:
    if place.rank == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(3600)
