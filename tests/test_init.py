import os
import subprocess
import sys

import pytest

NAMES = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
TELL = f"import os; import gaussian_enhancer; print(*(os.environ.get(name) for name in {NAMES}))"


@pytest.mark.parametrize(
    ("given", "then"),
    [
        ({}, "PASSIVE 10000"),
        ({"GOMP_SPINCOUNT": "7"}, "PASSIVE 7"),
        ({"OMP_WAIT_POLICY": "ACTIVE"}, "ACTIVE None"),
    ],
)
def test_idle_threads_sleep_soon_unless_the_user_says_otherwise(given, then):
    environment = {name: value for name, value in os.environ.items() if name not in NAMES} | given
    ended = subprocess.run([sys.executable, "-c", TELL], env=environment, capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == then
