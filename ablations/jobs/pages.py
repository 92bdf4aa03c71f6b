"""``gaussian-enhancer pages``: regenerate every committed page, table and figure from its committed records.

Pages are made in a copy of ``docs/``, in which all paths of ``conf/`` are valid.
"""

import contextlib
import importlib
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from hydra import compose
from omegaconf import DictConfig

from ablations.report import inserted_text
from ablations.report.reliability import read_page
from gaussian_enhancer.cli.main import package_of
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text

ROOT = Path(__file__).resolve().parents[2]
README, DOCS, RESULTS = Path("README.md"), Path("docs"), Path("docs/results")
SCALE = "desk"
JOBS = (
    ("quality", "records_only=true"),
    ("quality", "heldout=test", "records_only=true"),
    ("quality", "heldout=converged_long", "records_only=true"),
    ("plan_study", "records_only=true"),
    ("tradeoff", "records_only=true"),
    ("stability", "records_only=true"),
    ("tables", "table=[all,budget,captures,equal_budget,mode]", f"scale={SCALE}", "records_only=true"),
    ("peers", "records_only=true"),
    ("convergence", "records=docs/results/convergence.jsonl", "page=docs/results/convergence.md"),
    (
        "convergence",
        "row_table=same_fits",
        "last=true",
        "records=docs/results/same_fits.jsonl",
        "page=docs/results/same_fits.md",
    ),
    (
        "convergence",
        "row_table=two_fits",
        "last=true",
        "records=docs/results/two_fits.jsonl",
        "page=docs/results/two_fits.md",
    ),
    ("leave_one_out", "records=docs/results/leave_one_out.jsonl", "page=docs/results/leave_one_out.md"),
    ("distil_study", "records=docs/results/distil.jsonl", "page=docs/results/distil.md"),
)
"""The jobs that write pages, with the overrides that make them from their records alone."""


def remade(source: Path, folder: Path) -> list[Path]:
    """Regenerate all pages in a folder and return the files that differ from the committed ones.

    Hydra must be initialised with the project's configurations, as it is within a job.

    Args:
        source: the repository.
        folder: an empty folder.

    Returns:
        Paths relative to both.
    """
    shutil.copytree(source / DOCS, folder / DOCS)
    with contextlib.chdir(folder):
        for job, *overrides in JOBS:
            importlib.import_module(f"{package_of(job)}.{job}").run(compose(job, overrides))
        write_text("docs/reliability.md", read_page(RESULTS))
        for page in inserted_text.PAGES:
            write_text(page, inserted_text.fill_page((source / page).read_text(encoding="utf-8"), Path(), page))
    regenerated = [README, *sorted(path.relative_to(folder) for path in (folder / DOCS).rglob("*") if path.is_file())]
    return [path for path in regenerated if not _same(source / path, folder / path)]


def _same(committed: Path, regenerated: Path) -> bool:
    return committed.is_file() and committed.read_bytes() == regenerated.read_bytes()


def run(cfg: DictConfig) -> None:
    """Compare the regenerated pages with the committed ones, or write them.

    Args:
        cfg: conf/pages.yaml, composed.

    Raises:
        InputError: a page differs from its records, and ``write`` is off.
    """
    with TemporaryDirectory() as folder:
        different = remade(ROOT, Path(folder))
        for path in different:
            print(f"differs: {path}")
            if cfg.write:
                (ROOT / path).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(Path(folder) / path, ROOT / path)
    if different and not cfg.write:
        received = f"hold {len(different)} files that differ from their records"
        raise InputError("pages", received, "write them: gaussian-enhancer pages write=true")
    print(f"{len(different)} files written" if different else "every page is what its records say")
