import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, settings

from gaussian_enhancer.runs.runtime import set_kernel_threads
from support.synthetic_runs import coloured_sheet, copy_with_splat, write_plane_run

CHROMIUM, DRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card, for the viewer
)

# What a machine is busy with decides no test: examples have no deadline, and their making may take long.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
THREADS = max(1, (os.cpu_count() or 1) // WORKERS)
"""Threads of each process that runs tests: processes beside each other share the cores."""


def pytest_configure(config: pytest.Config) -> None:
    """Processes that tests start share the cores, too."""
    if WORKERS > 1:
        os.environ.setdefault("OMP_NUM_THREADS", str(THREADS))
        set_kernel_threads(THREADS)


@pytest.fixture(autouse=True)
def torch_threads() -> Iterator[None]:
    """Set torch's threads before and after each test: a job that a test starts in this process uses all cores."""
    torch.set_num_threads(THREADS)
    yield
    torch.set_num_threads(THREADS)


@pytest.fixture(scope="session")
def plane_run(tmp_path_factory) -> Path:
    """A small fitted run with two snapshots and exact geometry; not to be written into."""
    return write_plane_run(tmp_path_factory.mktemp("runs") / "plane-0", steps=(50, 100))


@pytest.fixture(scope="session")
def other_plane_run(tmp_path_factory) -> Path:
    """Another one, to validate on."""
    return write_plane_run(tmp_path_factory.mktemp("runs") / "plane-1", seed=1)


@pytest.fixture(scope="session")
def sheet_run(plane_run, tmp_path_factory) -> Path:
    """The plane's run with a splat, a sheet of 24x24 Gaussians; not to be written into."""
    return copy_with_splat(plane_run, tmp_path_factory.mktemp("fitted") / "plane", coloured_sheet(24))


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    """Headless Chromium."""
    if not CHROMIUM.is_file() or not DRIVER.is_file():
        pytest.skip(f"no {CHROMIUM} or {DRIVER}: apt-get install chromium chromium-driver")
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is in the dependency group `test`")
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    profile = tmp_path_factory.mktemp("profile")
    for flag in (*FLAGS, f"--user-data-dir={profile}", "--window-size=1280,1000"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=str(DRIVER)))
    yield driver
    driver.quit()
    shutil.rmtree(profile, ignore_errors=True)


@pytest.fixture
def page(browser, written: Path) -> Iterator:
    """A page that a test has written, freshly opened; afterwards the console must be empty."""
    browser.get_log("browser")
    browser.get("about:blank")
    browser.get(written.as_uri())
    yield browser
    assert [entry["message"] for entry in browser.get_log("browser")] == []
