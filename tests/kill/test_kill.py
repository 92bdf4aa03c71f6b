"""A slice of the kill campaign; `nox -s kill` runs all of it."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from kill import campaign

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


def test_every_case_states_its_commit_and_is_not_done_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    done: list[str] = []

    def case(_: object) -> dict[str, str]:
        done.append("case")
        return {"job": "fit", "verdict": "handled"}

    monkeypatch.setattr(campaign, "Campaign", lambda name, root: SimpleNamespace(seconds=1.0, writes=[]))
    monkeypatch.setattr(campaign, "kills", lambda name, count: [("kill 0", case)])
    monkeypatch.setattr(campaign, "others", lambda one: [])
    for _ in range(2):
        campaign.run(["fit"], 1, tmp_path / "kill.jsonl", tmp_path)
    total, row = (json.loads(line) for line in (tmp_path / "kill.jsonl").read_text().splitlines())
    assert done == ["case"]
    assert total == {"total": 1, "handled": 1}
    assert row["commit"]
