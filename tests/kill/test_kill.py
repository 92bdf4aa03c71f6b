"""A slice of the kill campaign; `nox -s kill` runs all of it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

CAMPAIGN = Path(__file__).with_name("campaign.py")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="forks and reads /proc")
def test_a_killed_fit_and_one_without_room_come_to_the_same_result() -> None:
    ended = subprocess.run([sys.executable, str(CAMPAIGN), "--slice"], capture_output=True, text=True, check=False)
    rows = [json.loads(line) for line in ended.stdout.splitlines()]
    assert len(rows) == 6, ended.stderr
    assert [row.get("detail") for row in rows[:-1]] == [None] * 5
    assert rows[-1] == {"total": 5, "handled": 5}
    assert [row["signal"] for row in rows[:-1]] == ["SIGKILL", "SIGTERM", "SIGINT", "SIGKILL", "disk full"]
