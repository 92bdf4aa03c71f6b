"""The command line: ``gaussian-enhancer JOB key=value ...``. Every job is a Hydra application.

A job is a configuration ``conf/JOB.yaml`` and a module with ``run(cfg)``: ``cli/JOB.py``, ``ablations/jobs/JOB.py`` for
jobs of the experiment suite, ``ablations/scripts/JOB.py`` or ``ablations/benchmarks/JOB.py`` for single measurements.
Arguments after the job's name are Hydra's: overrides, ``--cfg job``, ``-m`` for multirun. Only ``--help`` is answered
here, and ``--dry-run`` is passed on as ``dry_run=true``.
"""

import errno
import importlib
import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import nullcontext, redirect_stderr
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.errors import INTERRUPTED, InputError, LostProcessError
from gaussian_enhancer.files import to_write_error

JOBS = {
    "demo": "one procedural scene, start to finish: fit, enhance, measure, report",
    "fit": "fit a splat to a scene; write the splat and its renders",
    "simulate": "simulate splat renders from a photo; write samples and a page with every artefact",
    "enhance": "enhance the renders of a fitted run, of a splat file, or of a folder",
    "video": "render a splat along a camera path, enhance every frame, and encode them",
    "view": "show a splat in the browser, raw and enhanced: drag the camera, compare, save views and paths",
    "distil": "train a splat on its enhanced views, which gives a better .ply; or only remove its floaters",
    "train": "train an enhancement network on fitted runs",
    "train_generator": "train the second stage of the degradation simulator on fitted runs",
    "train_confidence": "train the change confidence (the share of the change to apply) on held-out views of fits",
    "measure": "compare images with photos; write records",
    "quality": "every method on every held-out scene: docs/results/quality.md, and whether its aims are met",
    "tradeoff": "error over run time of every method at several settings; what enhance budget_ms= chooses from",
    "stability": "stiff and extreme cases in every precision against float64: docs/results/stability.md",
    "plan_study": "what the plan leaves out of each scene, the time saved and the cost in quality",
    "ibgs": "train a peer's residual network on the training views of a finished fit",
    "tables": "make any table or figure of the paper, or a study of our own, from fits to reports",
    "status": "state of every run, or of those that tables need: running, stopped, failed with its error, done",
    "pages": "regenerate every committed page from its records, and compare",
    "fresh": "list committed pages whose inputs have changed since they were made",
    "report": "make an HTML report of a measured run",
    "dashboard": "one page of all tables: comparison with the paper, curves, distributions, pictures, provenance",
    "export": "write weights as a program for other runtimes: ONNX or torch.export",
    "download": "download the paper's datasets: resumable, verified by checksums, selected scenes only",
}

SUITE_JOBS = (
    "quality",
    "tradeoff",
    "stability",
    "plan_study",
    "ibgs",
    "tables",
    "status",
    "dashboard",
    "pages",
    "fresh",
)
"""Jobs of the experiment suite."""

SCRIPTS = {
    "candidates": "which weights to ship: gains of several on validation runs",
    "guards": "gain and harm at several values of a limit to the change",
    "renders": "gain of enhancers trained on real, simulated and mixed renders",
    "leave_one_out": "do training views predict how much of the change to apply? docs/results/leave_one_out.md",
    "convergence": "gain by number of fitting steps: docs/results/convergence.md",
    "distil_study": "gain of distilling, compared with the same steps without enhanced views: docs/results/distil.md",
    "depth": "gain with references warped through several kinds of depth",
    "flicker": "flicker along a camera path, raw and enhanced",
    "already_good": "can blocks that need no change be recognised before enhancement?",
    "realism": "can a classifier tell simulated renders from real ones?",
    "diversity": "spread of simulated renders over seeds, and of real ones over fits",
    "fingerprints": "ratio of errors of held-out to training views, for the gate",
    "artefact_sheet": "each type of artefact beside a real crop of the same kind, at pixel size",
    "sampler": "distribution of sampled codes against codes of real renders",
    "ship": "copy trained weights into the package, with their card",
    "before_after": "draw the README's picture: raw render, enhanced view, photo",
    "flow_figure": "draw the data-flow diagram: docs/pictures/flow.svg",
}
"""Single measurements and pictures."""

BENCHMARKS = {
    "networks": "cost of every network at every size: docs/results/networks.md",
    "peers": "speed and memory of our networks, published restorers and the whole pipeline: docs/performance.md",
    "degradation": "megapixels per second of the simulator, compared with Real-ESRGAN's degradation",
    "similarity": "run time of a fit's loss, compared with torch's autograd",
    "splat_kernels": "time of one iteration of a splat's fit, part by part",
    "viewer_speed": "how many pictures a second the viewer shows while its camera is dragged",
    "video_speed": "speed of the job video relative to its slowest stage alone",
}
"""Single measurements of cost."""

RESTARTED = {
    *("simulate", "enhance", "view", "train_confidence", "measure", "report", "export", "dashboard", "pages"),
    *("fresh", "status", "sampler", "ship", "before_after", "flow_figure"),
    *BENCHMARKS,
}
"""Jobs that begin anew after an interruption. All others reuse what was finished."""

JOBS |= SCRIPTS | BENCHMARKS

WAITING_JOBS = (*SUITE_JOBS, "demo")
"""Jobs that start runs of other jobs. If another process is computing such a run, they wait for it."""

DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.ENAMETOOLONG)
"""Numbers of system errors on writing: full disk, quota, file-size limit, read-only file system, a name too long."""

SWEEPS = ("-m", "--multirun")
"""Arguments that start a sweep."""

USAGE = """\
usage: gaussian-enhancer JOB [key=value ...] [--help] [--cfg job] [-m]

{jobs}

single measurements:
{measurements}

  completion    print a script for tab completion: eval "$(gaussian-enhancer completion)"

Every job takes Hydra's overrides, --help shows its options and -m sweeps over comma-separated values.
"""

COMPLETION = """\
_gaussian_enhancer() {
    mapfile -t COMPREPLY < <(COMP_WORDBREAKS= gaussian-enhancer --complete "${COMP_LINE:0:COMP_POINT}")
    [[ ${#COMPREPLY[@]} -eq 1 && ${COMPREPLY[0]} == *[=/.] ]] && compopt -o nospace
}
COMP_WORDBREAKS=${COMP_WORDBREAKS//=}
complete -o nospace -F _gaussian_enhancer gaussian-enhancer
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the job that the command line names.

    Exit codes: 0 done, 1 an internal error (with its traceback) or a process that was killed (one line), 2 input that
    cannot be used (one line), 130 stopped by Ctrl-C (one line).
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        _dispatch(words)
    except InputError as error:
        _exit(2, str(error))
    except LostProcessError as error:
        _exit(1, f"{error}; {_continuation(words)}")
    except KeyboardInterrupt:
        _exit(INTERRUPTED, f"stopped by Ctrl-C; {_continuation(words)}")


def _continuation(words: Sequence[str]) -> str:
    """What the same command does after an interruption."""
    restarts = bool(words) and words[0] in RESTARTED
    return f"the same command {'begins anew' if restarts else 'goes on where it stopped'}"


def _dispatch(words: Sequence[str]) -> None:
    set_openmp_wait_policy()
    if not words or words[0] in ("-h", "--help", "help"):
        print(usage(), end="")
    elif words[0] == "--version":
        print(version("gaussian-enhancer"))
    elif words[0] == "completion":
        print(COMPLETION, end="")
    elif words[0] == "--complete":
        print("\n".join(complete(" ".join(words[1:]))))
    elif words[0] not in JOBS:
        raise InputError(f"job {words[0]!r}", "is unknown", f"choose one of {', '.join(JOBS)}")
    elif {"-h", "--help"} & set(words):
        from gaussian_enhancer.cli.help import help_text

        print(help_text(words[0], words[1:], configurations()), end="")
    else:
        launch(words[0], words[1:])


def usage() -> str:
    """Usage text: every job with its description, single measurements last."""
    lines = {name: f"  {name:<13} {text}" for name, text in JOBS.items()}
    measurements = [lines.pop(name) for name in (*SCRIPTS, *BENCHMARKS)]
    return USAGE.format(jobs="\n".join(lines.values()), measurements="\n".join(measurements))


def set_openmp_wait_policy() -> None:
    """Set OpenMP's waiting policy for this process unless the user has set it.

    OpenMP reads the policy once, when torch loads it. Only the command line sets it; importing the package does not.
    Idle OpenMP threads spin by default. On a machine that others use as well, a fit then takes 20 times as long (28
    against 450-740 ms per step, measured). Threads that sleep at once take longer to wake than most parallel loops of
    an enhancement take (250 against 140 ms per view, measured). They therefore spin briefly before they sleep.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        os.environ.setdefault("GOMP_SPINCOUNT", "10000")


def launch(job: str, arguments: Sequence[str]) -> None:
    """Run a job by Hydra with the remaining command-line arguments.

    Raises:
        InputError: the arguments are not overrides of the job's configuration, or the job refuses its input.
        LostProcessError: a process of a sweep was killed.
    """
    import hydra
    from hydra._internal.utils import get_args_parser
    from hydra.errors import HydraException, InstantiationException

    from gaussian_enhancer.cli.hydra_messages import OverridesFilter, is_hydra_error, to_input_error

    sweeps = [word for word in arguments if word in SWEEPS]  # first, since Hydra refuses overrides on both sides of -m
    words = ["dry_run=true" if word == "--dry-run" else word for word in arguments if word not in SWEEPS]
    words = [expand_home(word) for word in words]
    unknown = [word for word in get_args_parser().parse_known_args(words)[1] if word.startswith("-")]
    if unknown:
        raise InputError(
            f"argument {unknown[0]}", "is unknown", f"options are key=value: gaussian-enhancer {job} --help"
        )
    sys.argv = [f"gaussian-enhancer {job}", *sweeps, *words]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # raise errors unchanged; Hydra would print them and end the process
    filtered_stderr = cast(Any, OverridesFilter(cast(io.TextIOBase, sys.stderr)))
    try:
        with redirect_stderr(filtered_stderr):
            hydra.main(version_base="1.3", config_path=str(configurations()), config_name=job)(job_function(job))()
    except InstantiationException:  # a bug in this project's code: `build` converts the user's mistakes
        raise
    except HydraException as error:
        raise to_input_error(error, job, words) from error
    except ValueError as error:
        if isinstance(error, InputError) or not is_hydra_error(error):
            raise
        raise to_input_error(error, job, words) from error
    except BrokenExecutor as error:
        raise LostProcessError("a process of the sweep was killed, for want of memory perhaps") from error


def expand_home(word: str) -> str:
    """Replace ``~/`` at the start of an override's value, or of each of several, by the home folder.

    Shells expand it in few such words. It stays where the user has no home folder.
    """
    key, sign, value = word.partition("=")
    home = os.path.expanduser("~")  # "~" again without a home folder
    return key + sign + re.sub(r"(^|(?<=[,\[]))~/", lambda _: f"{home}/", value)


def job_function(job: str) -> Callable[[Any], Any]:
    """The function that Hydra calls with the composed configuration.

    It checks the job's options, locks the path that the job writes outside of runs, and marks the runs that an error
    leaves unfinished. In a multirun, an `InputError` fails only its own run; it is reported after the other runs.
    """

    def run(cfg: Any) -> Any:
        from hydra.core.hydra_config import HydraConfig
        from hydra.types import RunMode

        from gaussian_enhancer.cli.options import check_options
        from gaussian_enhancer.runs.lock import exclusive, wait_for_holders
        from gaussian_enhancer.runs.status import track_runs

        check_options(job, cfg)
        module = importlib.import_module(f"{package_of(job)}.{job}")
        output = output_path_of(module, cfg)
        wait = job in WAITING_JOBS or HydraConfig.get().mode == RunMode.MULTIRUN
        try:
            with track_runs(discard=True), wait_for_holders(wait), exclusive(output) if output else nullcontext():
                return module.run(cfg)
        except OSError as error:
            if error.errno not in DISK_ERRORS:
                raise
            raise to_write_error(error.filename or "output", error) from error

    return run


def output_path_of(module: ModuleType, cfg: Any) -> Path | None:
    """The path that a job writes outside of runs: from its module's ``output_path``, else the option ``records``."""
    if hasattr(module, "output_path"):
        return cast(Path | None, module.output_path(cfg))
    records = cfg.get("records")
    return Path(records) if records else None


def package_of(job: str) -> str:
    """The package that holds a job's module."""
    packages = {"ablations.jobs": SUITE_JOBS, "ablations.scripts": SCRIPTS, "ablations.benchmarks": BENCHMARKS}
    return next((package for package, jobs in packages.items() if job in jobs), "gaussian_enhancer.cli")


def complete(line: str) -> list[str]:
    """Completions of the last word of a command line: names of jobs, or Hydra's completions of overrides.

    Args:
        line: the command line up to the cursor, the program's name included.
    """
    words = line.split(" ")
    if len(words) <= 2:
        return [job for job in (*JOBS, "completion") if job.startswith(words[-1])]
    job = words[1]
    if job not in JOBS:
        return []
    return _complete_overrides(job, " ".join(words[2:]))


def _complete_overrides(job: str, line: str) -> list[str]:
    from hydra._internal.config_loader_impl import ConfigLoaderImpl
    from hydra._internal.utils import create_automatic_config_search_path
    from hydra.core.plugins import Plugins
    from hydra.core.utils import setup_globals
    from hydra.plugins.completion_plugin import DefaultCompletionPlugin

    setup_globals()
    search_path = create_automatic_config_search_path(None, None, str(configurations()))
    Plugins.instance()
    plugin = DefaultCompletionPlugin(ConfigLoaderImpl(config_search_path=search_path))
    return sorted(plugin._query(config_name=job, line=line))


def _exit(code: int, message: str) -> None:
    print(f"gaussian-enhancer: {message}", file=sys.stderr)
    raise SystemExit(code)
