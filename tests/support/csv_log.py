"""Reading what the logger ``csv`` wrote."""

import csv
from pathlib import Path


def logged_rows(folder: Path) -> list[dict[str, str]]:
    """The rows that a training logged."""
    with (folder / "log/metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))
