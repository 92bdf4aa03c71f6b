import os
import subprocess
import sys
from importlib.metadata import version

import pytest

NAMES = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
TELL = f"""
import os, gaussian_enhancer
from gaussian_enhancer.cli.main import set_openmp_wait_policy
assert not os.environ.get("CLEAN") or not any(name in os.environ for name in {NAMES})
set_openmp_wait_policy()
print(*(os.environ.get(name) for name in {NAMES}))
"""


@pytest.mark.parametrize(
    ("given", "then"),
    [
        ({"CLEAN": "1"}, "PASSIVE 10000"),
        ({"GOMP_SPINCOUNT": "7"}, "PASSIVE 7"),
        ({"OMP_WAIT_POLICY": "ACTIVE"}, "ACTIVE None"),
    ],
)
def test_idle_threads_sleep_soon_unless_the_user_says_otherwise(given, then):
    environment = {name: value for name, value in os.environ.items() if name not in NAMES} | given
    ended = subprocess.run([sys.executable, "-c", TELL], env=environment, capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == then


def test_the_module_is_the_command_line():
    ended = subprocess.run([sys.executable, "-m", "gaussian_enhancer", "--version"], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout.strip()) == (0, version("gaussian-enhancer"))
