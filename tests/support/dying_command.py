"""The command line that kills its own processes right after a step of a training: ``python dying_command.py STEP ...``.

Started processes import this file as their main module, and so die after the same step.
"""

import os
import signal
import sys
from typing import Any

from gaussian_enhancer.train.module import EnhancerModule

STEP = "DYING_COMMAND_STEP"  # environment variable, which started processes inherit


def die_at_step(module: EnhancerModule, *_: Any) -> None:
    """Lightning calls this after every step; checkpoints of that step are written before."""
    if module.global_step == int(os.environ[STEP]):
        os.kill(os.getpid(), signal.SIGKILL)


EnhancerModule.on_train_batch_end = die_at_step  # type: ignore[method-assign]

if __name__ == "__main__":
    from gaussian_enhancer.cli.main import main

    os.environ[STEP] = sys.argv.pop(1)
    main()
