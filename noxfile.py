"""Sessions: `nox --list` shows them, `nox -s NAME` runs one, `nox` runs lint and tests."""

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "uv"
nox.options.reuse_venv = "yes"
nox.options.sessions = ["lint", "tests"]

PROJECT = nox.project.load_toml("pyproject.toml")

# Containers often turn caches of bytecode off. Every process of a session would compile its imports again, which takes
# longer than most tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def install(session: nox.Session, *groups: str) -> None:
    """Install the project, editable, with dependency groups, at the versions of constraints.txt."""
    packages = [package for group in groups for package in nox.project.dependency_groups(PROJECT, group)]
    session.install("-c", "constraints.txt", "-e", ".", *packages)


def listed(option: str, values: Iterable[str]) -> str:
    """An override that gives an option a list."""
    return f"{option}=[{','.join(values)}]"


def run_tests(session: nox.Session, *chosen: str) -> None:
    """Run pytest in up to four processes; all tests of a file run in the same process and share its fixtures.

    If a process dies, the run ends and names the test: pytest-xdist can hang if it replaces the process. Idle OpenMP
    threads sleep, as in the command line: threads that spin would slow the other processes down. Three short fits
    and an enhancement compile the kernels first: a process that compiles them computes other last bits than one that
    finds them in the cache, and tests compare what several processes make.
    """
    install(session, "test")
    fits = Path(session.create_tmp()) / "fits"
    shutil.rmtree(fits, ignore_errors=True)
    fits.mkdir()
    with session.chdir(fits):
        size = ("scene=object", "scene.views=8", "scene.height=32", "scene.width=48", "settings.steps=3")
        splats = "splat=3dgs,2dgs,mip_splatting"
        session.run("gaussian-enhancer", "fit", "-m", splats, *size, "runtime.progress=false", silent=True)
        enhanced = f"run={next(Path('runs/fit').iterdir())}"
        session.run("gaussian-enhancer", "enhance", "-m", enhanced, "weights=lr_tiny,sr_tiny", silent=True)
    processes = ("--numprocesses=logical", "--maxprocesses=4", "--dist=loadfile", "--max-worker-restart=0")
    waiting = {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "10000"}
    session.run("pytest", *processes, *chosen, *session.posargs, env=waiting)


@nox.session
def lint(session: nox.Session) -> None:
    """Check style and types: ruff and mypy."""
    install(session, "lint")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("mypy")


@nox.session
def tests(session: nox.Session) -> None:
    """Run the tests that are not marked slow, with checks of shapes; arguments after -- are passed to pytest."""
    run_tests(session, "-m", "not slow")


@nox.session(default=False)
def tests_all(session: nox.Session) -> None:
    """Run all tests, including slow ones, as in continuous integration; arguments after -- are passed to pytest."""
    run_tests(session)


@nox.session(default=False)
def pages(session: nox.Session) -> None:
    """Regenerate every committed page from its records; fails if one differs, `-- write=true` writes them."""
    install(session)
    session.run("gaussian-enhancer", "pages", *session.posargs)


@nox.session(default=False)
def fresh(session: nox.Session) -> None:
    """List committed pages with older weights or code; fails if one is false, with `-- strict=true` also if stale."""
    install(session)
    session.run("gaussian-enhancer", "fresh", *session.posargs)


@nox.session(default=False)
def demo(session: nox.Session) -> None:
    """Fit, enhance, measure and report one procedural scene; arguments after -- are overrides."""
    install(session)
    session.run("gaussian-enhancer", "demo", *session.posargs)


@nox.session(default=False)
def wheel(session: nox.Session) -> None:
    """Build the wheel, install only it in an empty environment, and run the demo from another folder."""
    session.install("build")
    folder = Path(session.create_tmp())
    shutil.rmtree(folder / "dist", ignore_errors=True)
    session.run("python", "-m", "build", "--installer", "uv", "--outdir", str(folder / "dist"), silent=True)
    (built,) = (folder / "dist").glob("*.whl")
    session.run("uv", "venv", "--clear", "-q", str(folder / "empty"), external=True)
    python = folder / "empty" / "bin" / "python"
    constraints = str(Path("constraints.txt").resolve())
    session.run("uv", "pip", "install", "-q", "--python", str(python), "-c", constraints, str(built), external=True)
    command = str((folder / "empty" / "bin" / "gaussian-enhancer").resolve())
    elsewhere = folder / "elsewhere"
    shutil.rmtree(elsewhere, ignore_errors=True)
    elsewhere.mkdir(parents=True)
    with session.chdir(elsewhere):
        session.run(command, "demo", *session.posargs, external=True)


@nox.session(default=False)
def pairs(session: nox.Session) -> None:
    """Make the fits that shipped weights learn from (needs the captures; hours on two cores); resumes after a kill."""
    install(session)
    captures = ("captures_half", "captures_quarter", "captures_validation")
    methods = ("procedural_3dgs", "procedural_2dgs", "procedural_mip_splatting")
    pairs = (*captures, *methods, "procedural_dense", "procedural_more", "procedural_validation")
    converged = ("training", "others", "others_long", "procedural", "procedural_sparse", "validation")
    for name in (*(f"pairs_{one}" for one in pairs), *(f"converged_{one}" for one in converged)):
        session.run("gaussian-enhancer", "fit", f"+sweep=[{name},two_jobs]", *session.posargs)


@nox.session(default=False)
def simulator(session: nox.Session) -> None:
    """Train the simulator's second stage on the fits of `pairs`; resumes after a kill."""
    install(session)
    scenes = ("unbounded_[0-2]", "outdoor_[0-2]", "indoor_[0-2]", "object_[0-2]", "panel17", "boruszyn", "lewis", "axe")
    records = Path("runs/gates.jsonl")  # written when all gates are; some of the gates are there after a kill
    if not records.is_file():
        runs = sorted(str(run) for scene in scenes for run in Path("runs/fit").glob(f"{scene}-*"))
        session.run("gaussian-enhancer", "fingerprints", listed("runs", runs), "gates=runs/gates", f"records={records}")
    session.run("gaussian-enhancer", "train_generator", "+recipe=simulator", *session.posargs)


@nox.session(default=False)
def renders(session: nox.Session) -> None:
    """Train the same enhancer on every kind of render (conf/ablation/renders); resumes after a kill.

    The rows after_tsds and after_real go on from the weights of other rows: each is a command of its own, in its file.
    """
    install(session)
    stems = sorted(path.stem for path in Path("conf/ablation/renders").glob("*.yaml"))
    rows = ",".join(stem for stem in stems if not stem.startswith("after_"))
    session.run("gaussian-enhancer", "train", "-m", "+recipe=renders", f"+ablation/renders={rows}", *session.posargs)


@nox.session(default=False)
def realism(session: nox.Session) -> None:
    """Measure the realism of simulated renders: docs/results/simulator.md (needs the captures; run `renders` first)."""
    install(session)
    training = [f"runs/fit/{name}-*" for name in ("*_1000", "buddha")]
    validation = [f"runs/fit/{name}-*" for name in ("banana", "plush", "copr", "cyprus", "flowerpot")]
    test = [f"runs/fit/{name}-*" for name in ("fox", "monstree")]
    rows = ("naive", "all", "random", "adaptive", "tsds")
    generator = ("generator_weights=simulator", listed("rows", rows))
    results = Path("docs/results")
    for name, learn, judge in (("validation", training, validation), ("test", [*training, *validation], test)):
        options = (f"records={results}/realism_{name}.jsonl", *generator)
        session.run("gaussian-enhancer", "realism", listed("train", learn), listed("test", judge), *options)
    options = (f"records={results}/diversity.jsonl", *generator)
    session.run("gaussian-enhancer", "diversity", listed("runs", ("runs/fit/buddha-*", "runs/fit/fox-*")), *options)
    trained = ("real", *rows, "mixed")
    for name, runs in (("validation", validation), ("test", test)):
        options = (f"records={results}/renders_{name}.jsonl", "lpips=[lpips_alex]")
        session.run("gaussian-enhancer", "renders", listed("rows", trained), listed("runs", runs), *options)


WEIGHTS = (
    "+recipe=lr_long fusion=ssif_lr +card.name=lr_long",
    "+recipe=lr_further fusion=ssif_lr +card.name=lr_further initial={lr_long}",
    "+recipe=lr_converged fusion=ssif_lr label=lr_begun +card.name=lr_begun initial={lr_further} "
    "data.train=[runs/fit/conch-*,runs/fit/caliterra-*,runs/fit/axe-*,runs/fit/boruszyn-*,runs/fit/viking-*]",
    "+recipe=lr_converged fusion=ssif_lr label=lr_second optimizer.lr=8e-4 +card.name=lr_second initial={lr_begun}",
    "+recipe=lr_converged fusion=ssif_lr trainer.max_steps=12000 +card.name=lr_tiny initial={lr_second}",
    "+recipe=sr_shipped size=tiny",
    "+recipe=sr_cascade fusion=cascade size=tiny label=sr_begun +card.name=sr_begun initial.first={lr_further} "
    "initial.second={sr_shipped}",
    "+recipe=sr_converged size=tiny label=sr_second +card.name=sr_second initial.first={lr_converged} "
    "initial.second={sr_begun}",
    "+recipe=sr_converged size=tiny seed=1 trainer.max_steps=4000 label=sr_tiny +card.name=sr_tiny "
    "initial.first={lr_converged} initial.second={sr_second}",
)
"""Overrides of the job train for the shipped weights, in the order in which they learn from each other.

{label} is replaced by the weights of an earlier row.
"""


@nox.session(default=False)
def weights(session: nox.Session) -> None:
    """Train the shipped weights (after `pairs`); resumes after a kill."""
    install(session)
    for row in WEIGHTS:
        finished = sorted(Path("runs/train").glob("*/weights.safetensors"), key=lambda path: path.stat().st_mtime)
        begun = {path.parent.name.split("-")[0]: path for path in finished}
        session.run("gaussian-enhancer", "train", *row.format(**begun).split(), *session.posargs)


@nox.session(default=False)
def quality(session: nox.Session) -> None:
    """Measure the shipped weights: docs/results/quality.md (needs the captures); resumes after a kill.

    `-- heldout=test` measures the frozen test scenes, `-- heldout=converged_long` fits of 15,000 steps of validation
    captures.
    """
    install(session)
    session.run("gaussian-enhancer", "quality", *session.posargs)


@nox.session(default=False)
def ablation(session: nox.Session) -> None:
    """Make one table, figure or study: table 10 in minutes, or `-- table=2 scale=desk`; resumes after a kill."""
    install(session)
    usual = {"table": "10", "scale": "smoke"}
    named = {word.split("=")[0] for word in session.posargs}
    words = [f"{key}={value}" for key, value in usual.items() if key not in named]
    session.run("gaussian-enhancer", "tables", *words, *session.posargs)


@nox.session(default=False)
def tables(session: nox.Session) -> None:
    """Make all tables and figures of the paper, `-- scale=desk` in hours; resumes after a kill."""
    install(session)
    session.run("gaussian-enhancer", "tables", "table=all", *session.posargs)


@nox.session(default=False)
def tradeoff(session: nox.Session) -> None:
    """Make docs/results/tradeoff.md and the presets of `budget_ms=`, on an idle machine; arguments are overrides."""
    install(session)
    shipped = "settings=src/gaussian_enhancer/weights/settings.json"
    session.run("gaussian-enhancer", "tradeoff", shipped, *session.posargs)


@nox.session(default=False)
def bench(session: nox.Session) -> None:
    """Make docs/performance.md: speed of our and published networks and of the pipeline, on an idle machine.

    Arguments after -- are overrides, for instance device=cuda.
    """
    install(session, "bench")
    session.run("gaussian-enhancer", "peers", *session.posargs)


@nox.session(default=False)
def fuzz(session: nox.Session) -> None:
    """Test every reader with 1,500 damaged files, or with `-- --coverage` by a fuzzer for a minute each; record all."""
    words = [word for word in session.posargs if word != "--coverage"]
    if len(words) < len(session.posargs):
        install(session, "test", "fuzz")
        session.run("python", "tests/fuzz/coverage_guided.py", "--record", "docs/results/fuzz_coverage.jsonl", *words)
        return
    install(session, "test")
    record = ("--cases", "1500", "--record", "docs/results/fuzz.jsonl")
    session.run("python", "tests/fuzz/campaign.py", *record, *words)


@nox.session(default=False)
def kill(session: nox.Session) -> None:
    """Kill jobs at 120 moments, start two in one folder, fill the disk; resumes after a stop."""
    install(session, "test")
    session.run("python", "tests/kill/campaign.py", "--record", "docs/results/kill.jsonl", *session.posargs)


@nox.session(default=False)
def docs(session: nox.Session) -> None:
    """Build the documentation into site/, in strict mode and offline; `-- serve` shows a live preview."""
    session.install("-c", "constraints.txt", *nox.project.dependency_groups(PROJECT, "docs"))  # code is not imported
    command = session.posargs or ["build", "--strict"]
    session.run("mkdocs", *command, env={"NO_MKDOCS_2_WARNING": "1"})


@nox.session(default=False)
def picture(session: nox.Session) -> None:
    """Draw the README's picture anew, of plush fitted for 15,000 steps, which takes about half an hour."""
    install(session)
    if not os.environ.get("GAUSSIAN_ENHANCER_DATA"):
        session.error("GAUSSIAN_ENHANCER_DATA names no folder: it must hold captures/plush and lpips")
    shutil.rmtree("runs/picture", ignore_errors=True)  # no run of other options or weights is taken for this one
    own = "runs=runs/picture"
    session.run("gaussian-enhancer", "fit", own, "+sweep=converged_long", "scene=captures/plush")
    (fit,) = Path("runs/picture/fit").glob("plush-3dgs-*")
    session.run("gaussian-enhancer", "enhance", own, f"run={fit}")
    (enhanced,) = Path("runs/picture/enhance").glob("plush-3dgs-*")
    session.run("gaussian-enhancer", "before_after", f"run={enhanced}", "capture='plush, MIT licence'")


@nox.session(default=False, venv_backend="none")
def constraints(session: nox.Session) -> None:
    """Resolve constraints.txt for every platform and Python version (needs uv)."""
    header = "# Exact versions of everything, resolved by `nox -s constraints`.\n"
    options = ["--universal", "--all-extras", "--group", "dev", "--group", "bench", "--upgrade"]
    silence = ["--no-header", "--no-annotate", "--no-emit-index-url"]
    session.run(
        "uv", "pip", "compile", "-q", "pyproject.toml", *options, *silence, "-o", "constraints.txt", external=True
    )
    path = Path("constraints.txt")
    path.write_text(header + path.read_text(encoding="utf-8"), encoding="utf-8")


os.environ.setdefault("UV_HTTP_TIMEOUT", "300")  # seconds: torch's wheel is large, and connections can be slow
