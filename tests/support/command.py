"""The command line in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

DYING = Path(__file__).with_name("dying_command.py")


def run_command(*words: str, dies_at_step: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run ``gaussian-enhancer`` with these words, in one thread a process, and wait for its end.

    Args:
        *words: a job and its options.
        dies_at_step: step of the training after which its processes kill themselves; None for never.
    """
    program = ["-c", "from gaussian_enhancer.cli.main import main; main()"]
    if dies_at_step is not None:
        program = [str(DYING), str(dies_at_step)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *program, *words], env=environment, capture_output=True, text=True, check=False
    )
