"""The readers under a fuzzer that is guided by coverage (atheris): inputs that reach new code are kept and changed on.

    python tests/fuzz/coverage_guided.py --seconds 60 --record docs/results/fuzz_coverage.jsonl

It needs the dependency group ``fuzz``. Every reader has a process of its own, that begins with a small real file. A
process ends at the first input that is neither refused by an `InputError` of one line nor read as something that holds:
that input is kept in the folder ``--found``.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parents[1]
WATCHED = (
    "gaussian_enhancer.checkpoint",
    "gaussian_enhancer.files",
    "gaussian_enhancer.infer.weights",
    "gaussian_enhancer.input_files",
    "gaussian_enhancer.ply_file",
    "gaussian_enhancer.scene",
    "gaussian_enhancer.splat.io",
    "plyfile",
)
"""What reads; compiled kernels cannot be watched."""
MEMORY_MB = 4096
LONGEST = 20
"""Seconds that one input may take."""


def fuzz(name: str, file: str, seconds: int, found: Path) -> None:
    """Fuzz one file of one reader in this process, which ends with it."""
    import atheris

    with atheris.instrument_imports(include=list(WATCHED)):
        from fuzz.readers import READERS
        from gaussian_enhancer.errors import InputError

    reader, folder = READERS[name], Path(tempfile.mkdtemp())
    (folder / "case").mkdir()
    (folder / "corpus").mkdir()
    reader.make(folder / "case")
    target = folder / "case" / file
    (folder / "corpus" / "whole").write_bytes(target.read_bytes())
    assert reader.faults(reader.read(folder / "case")) == []

    def one(data: bytes) -> None:
        target.write_bytes(data)
        try:
            faults = reader.faults(reader.read(folder / "case"))
        except InputError as error:
            line = str(error)
            if not line.isprintable() or "; " not in line or "fit into memory" in line:
                raise AssertionError(f"is refused by {line!r}") from error
        else:
            assert not faults, faults

    found.mkdir(parents=True, exist_ok=True)
    options = (
        f"-max_total_time={seconds}",
        f"-rss_limit_mb={MEMORY_MB}",
        f"-timeout={LONGEST}",
        "-print_final_stats=1",
    )
    place = f"-artifact_prefix={found / name}-"
    atheris.Setup([sys.argv[0], *options, place, "-max_len=200000", "-seed=1", str(folder / "corpus")], one)
    atheris.Fuzz()


def run(names: list[str], seconds: int, found: Path) -> list[dict[str, Any]]:
    """A row for each file of each reader."""
    from fuzz.readers import READERS
    from gaussian_enhancer.metrics.provenance import provenance

    rows = []
    for name in names or READERS:
        for file in READERS[name].files:
            words = ("--one", name, file, "--seconds", str(seconds), "--found", str(found))
            ended = subprocess.run([sys.executable, __file__, *words], capture_output=True, text=True, check=False)
            found_here = outcome(ended.returncode, ended.stderr)
            rows.append({"reader": name, "file": file, "seconds": seconds, **found_here, **provenance(timed=True)})
            print(json.dumps(rows[-1]), flush=True)
    return rows


def outcome(code: int, printed: str) -> dict[str, Any]:
    """What libFuzzer's own words say: inputs tried, edges of the code that they reached, and what went wrong."""
    tried = re.search(r"stat::number_of_executed_units:\s*(\d+)", printed)
    reached = re.findall(r"cov: (\d+)", printed)
    row: dict[str, Any] = {"inputs": int(tried[1]) if tried else 0, "edges": int(reached[-1]) if reached else 0}
    if code == 0 and row["inputs"]:
        return {**row, "verdict": "handled"}
    words = [line for line in printed.splitlines() if re.search(r"Error|ERROR|Exception|SUMMARY|==", line)]
    return {**row, "verdict": "failed", "detail": " ".join(words)[-300:] or f"ended with {code}"}


def main() -> None:
    """Fuzz all readers, write the record, and fail where an input was found that none should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="for each file of each reader")
    parser.add_argument("--readers", nargs="*", default=[])
    parser.add_argument("--found", type=Path, default=Path("fuzz_found"))
    parser.add_argument("--record", type=Path)
    parser.add_argument("--one", nargs=2)
    options = parser.parse_args()
    from fuzz.campaign import FOLDERS

    sys.path[:0] = [str(TESTS / folder) for folder in FOLDERS]
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if options.one:
        fuzz(*options.one, options.seconds, options.found)
        return
    rows = run(options.readers, options.seconds, options.found)
    if options.record:
        options.record.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    sys.exit(1 if any(row["verdict"] == "failed" for row in rows) else 0)


if __name__ == "__main__":
    sys.path.insert(0, str(TESTS))
    main()
