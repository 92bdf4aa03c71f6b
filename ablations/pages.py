"""Make every committed page and table again from its committed records, and name those that differ.

    python -m ablations.pages            # fails where a page is not what its records say
    python -m ablations.pages --write    # writes the pages in place

Everything is made in a copy of ``docs/``, so that the paths in ``conf/`` hold whatever they are.
"""

import os
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

SCALE = "desk"
JOBS = (
    ("quality", "records_only=true"),
    ("plan_study", "records_only=true"),
    ("tradeoff", "records_only=true"),
    ("stability", "records_only=true"),
    ("tables", "table=[all,mode]", f"scale={SCALE}", "records_only=true"),
    ("peers", "records_only=true"),
    ("convergence", "records=docs/results/convergence.jsonl", "page=docs/results/convergence.md"),
    ("distil_study", "records=docs/results/distil.jsonl", "page=docs/results/distil.md"),
)
"""The jobs that write pages, with the overrides that make them from their records alone."""


def remade(source: Path, folder: Path) -> list[Path]:
    """Make all pages again in a folder; the files that differ from the committed ones.

    Args:
        source: the repository.
        folder: an empty folder.

    Returns:
        Paths relative to both.
    """
    from ablations.report.reliability import read_page
    from ablations.report.video import PAGE, filled
    from gaussian_enhancer.cli.main import main
    from gaussian_enhancer.files import write_text

    shutil.copytree(source / "docs", folder / "docs")
    before, arguments = Path.cwd(), sys.argv
    os.chdir(folder)
    try:
        for job, *overrides in JOBS:
            sys.argv = ["gaussian-enhancer", job, *overrides, f"hydra.run.dir={folder / 'hydra'}"]
            try:
                main()
            except SystemExit as ended:
                if ended.code:
                    raise
        write_text("docs/reliability.md", read_page(Path("docs/results")))
        write_text(PAGE, filled(PAGE.read_text(encoding="utf-8"), Path("docs/results")))
    finally:
        sys.argv = arguments
        os.chdir(before)
    made = sorted(path.relative_to(folder) for path in (folder / "docs").rglob("*") if path.is_file())
    return [path for path in made if not _same(source / path, folder / path)]


def _same(committed: Path, made: Path) -> bool:
    return committed.is_file() and committed.read_bytes() == made.read_bytes()


def main() -> None:
    """Compare, or write; the exit status tells whether any page differs."""
    root = Path(__file__).resolve().parents[1]
    with TemporaryDirectory() as folder:
        different = remade(root, Path(folder))
        for path in different:
            print(f"differs: {path}")
            if "--write" in sys.argv:
                (root / path).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(Path(folder) / path, root / path)
    if different and "--write" not in sys.argv:
        raise SystemExit(f"{len(different)} files are not what their records say: python -m ablations.pages --write")
    print(f"{len(different)} files written" if different else "every page is what its records say")


if __name__ == "__main__":
    main()
