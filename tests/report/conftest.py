import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from gaussian_enhancer.report.compared import ComparedView
from support.report_samples import NASTY, compared

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
)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
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


@pytest.fixture(scope="session")
def views() -> list[ComparedView]:
    return [
        compared("001.png", 0.5, 1),
        compared(NASTY, -0.25, 2),
        compared("003.png", 0.001, 3, height=64, width=36),
    ]


@pytest.fixture(scope="session")
def provenance() -> dict[str, str]:
    return {"Commit": "0123abc", "Configuration": "runs/<x>/config.yaml", "Machine": "2 cores", "Weights": "sif & co"}
