"""Files of rows: the records of studies of single views, one JSON object a line."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.input_files import read_text
from gaussian_enhancer.metrics.provenance import provenance


@dataclass(frozen=True)
class RowFile:
    """A study's rows.

    Args:
        path: the file.
        columns: that it must have.
        keys: columns that say what was measured; measuring it again replaces its rows.
        option: of the job, by which it measures.
    """

    path: Path
    columns: tuple[str, ...]
    keys: tuple[str, ...]
    option: str

    def read(self) -> pd.DataFrame:
        """All rows.

        Raises:
            InputError: there is no file, or it holds something else.
        """
        remedy = f"measure again, with {self.option}="
        text = read_text(self.path)
        try:
            frame = pd.read_json(io.StringIO(text), lines=True)
        except ValueError as error:
            raise InputError(self.path, f"is no file of rows ({error})", remedy) from error
        lacking = set(self.columns) - set(frame.columns)
        if lacking:
            raise InputError(self.path, f"lacks the column {sorted(lacking)[0]}", remedy)
        return frame

    def held(self) -> pd.DataFrame:
        """All rows; none where there is no file.

        Raises:
            InputError: the file holds something else.
        """
        return self.read() if self.path.exists() else pd.DataFrame(columns=self.columns)

    def add(self, rows: Sequence[Mapping[str, object]]) -> None:
        """Add rows, with the versions that they were measured by, in place of those with the same keys.

        Raises:
            InputError: the file holds something else, or cannot be written.
        """
        found = pd.DataFrame([{**row, **provenance()} for row in rows])
        held = self.held()
        fresh = set(found[list(self.keys)].itertuples(index=False, name=None))
        stay = [key not in fresh for key in held[list(self.keys)].itertuples(index=False, name=None)]
        together = pd.concat([held[stay], found], ignore_index=True) if any(stay) else found
        write_text(self.path, together.to_json(orient="records", lines=True))
