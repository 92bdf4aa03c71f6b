"""``gaussian-enhancer viewer_speed``: pictures a second that the viewer shows while its camera is dragged.

The job ``view`` runs in a separate process. A headless browser drives its page and shares the cores with it. The job
counts pictures that arrive in the browser, by the number that the page states. During the drag, every picture is
enhanced, ``width`` wide and as high as the page's canvas requires. "processor" is the time on all cores together, which
is affected less when others use the machine. ``picture=FILE`` makes a picture of the page instead.
"""

import io
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import torch
from omegaconf import DictConfig
from PIL import Image

from ablations.study.engine import Study, job
from gaussian_enhancer.cores import usable_cores
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write

CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--enable-unsafe-swiftshader")
WINDOW = "--window-size=1280,800"
STATUS = re.compile(r"(\d+) ms \([^)]*\), (\d+) × (\d+), frame (\d+)")
WAIT = 120.0
"""Seconds within which a picture must come."""
STILL = 5.0
"""Seconds after which an unchanged picture counts as final."""
STEP = 3
"""Pixels by which the pointer moves at a time."""


def refuse_without_browser() -> None:
    """Refuse a machine without a browser to drive the page.

    Raises:
        InputError: Chromium, its driver or selenium is missing.
    """
    for program in (CHROMIUM, DRIVER):
        if not Path(program).is_file():
            raise InputError(program, "does not exist", "apt-get install chromium chromium-driver")
    try:
        import selenium.webdriver  # noqa: F401
    except ImportError as error:
        raise InputError("selenium", f"cannot be imported ({error})", "pip install selenium") from error


@contextmanager
def viewing(words: Sequence[str]) -> Iterator[tuple[str, int]]:
    """The address of the job ``view`` and its process, which runs until the block ends.

    Args:
        words: its options.

    Raises:
        InputError: the job refuses them.
    """
    command = [sys.executable, "-m", "gaussian_enhancer", "view", "port=0", *words]
    job = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        if job.stderr is None:
            raise ValueError("the job's lines are read")
        lines: list[str] = []
        for line in job.stderr:
            if line.startswith("http"):
                yield line.split()[0], job.pid
                return
            lines.append(line.strip())
        last_line = (lines or ["no output"])[-1].removeprefix("gaussian-enhancer: ")
        raise InputError("the job view", f"does not start ({last_line})", "correct run, show, width or overrides")
    finally:
        job.terminate()  # a process that a shell started in the background ignores Ctrl-C
        job.wait(timeout=60)


@contextmanager
def browsing(address: str) -> Iterator[Any]:
    """Headless Chromium on a page that already shows pictures.

    Raises:
        InputError: the page shows no still picture.
    """
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for flag in (*FLAGS, WINDOW, f"--user-data-dir={profile}"):
            options.add_argument(flag)
        driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(executable_path=DRIVER))
        try:
            driver.get(address)
            wait_until_idle(driver)
            yield driver
        finally:
            driver.quit()


def status(driver: Any) -> tuple[int, int, int, int] | None:
    """Status of the page: milliseconds of the last picture, its width and height, and its number."""
    return parse_status(driver.execute_script("return document.body.textContent"))  # needs no layout, unlike innerText


def parse_status(text: str) -> tuple[int, int, int, int] | None:
    """Parse milliseconds, width, height and number of a picture from a page's text; None where they are missing."""
    match = STATUS.search(text)
    return None if match is None else tuple(map(int, match.groups()))  # type: ignore[return-value]


def wait_until_idle(driver: Any) -> None:
    """Wait until the page's picture has not changed for `STILL` seconds.

    Raises:
        InputError: the picture keeps changing, or there is none.
    """
    began, shown, since = time.monotonic(), None, time.monotonic()
    while shown is None or time.monotonic() - since < STILL:
        if time.monotonic() - began > WAIT:
            raise InputError("the page", f"shows no still picture after {WAIT:.0f} s", "choose a smaller width")
        current = status(driver)
        if current != shown:
            shown, since = current, time.monotonic()
        time.sleep(0.1)


def processor_seconds(process: int) -> float:
    """Processor seconds of a process and its children on all cores together."""
    family = [psutil.Process(process), *psutil.Process(process).children(recursive=True)]
    return float(sum(sum(member.cpu_times()[:2]) for member in family))


def drag_camera(driver: Any, job: int, seconds: float) -> dict[str, Any]:
    """Drag the camera back and forth and count the pictures that arrive."""
    from selenium.webdriver import ActionChains

    canvas = max(driver.find_elements("tag name", "canvas"), key=lambda one: one.size["width"])
    ActionChains(driver, duration=0).move_to_element(canvas).click_and_hold().perform()
    milliseconds: dict[int, int] = {}
    sizes, moves = set(), 0
    processes = {"job": job, "browser": driver.service.process.pid}
    processor = {name: processor_seconds(process) for name, process in processes.items()}
    first, began = status(driver), time.monotonic()
    while time.monotonic() - began < seconds:
        direction = 1 if moves // 20 % 2 == 0 else -1
        ActionChains(driver, duration=0).move_by_offset(direction * STEP, 0).perform()
        moves += 1
        if (current := status(driver)) is not None:
            milliseconds[current[3]] = current[0]
            sizes.add(current[1:3])
    last, duration = status(driver), time.monotonic() - began
    processor = {name: processor_seconds(process) - processor[name] for name, process in processes.items()}
    ActionChains(driver, duration=0).release().perform()
    if first is None or last is None:
        raise RuntimeError("the page states no picture")
    count = last[3] - first[3]
    return {
        "pictures": count,
        "seconds": round(duration, 2),
        "pictures_a_second": round(count / duration, 2),
        "median_ms": statistics.median(milliseconds.values()),
        "processor_seconds_a_picture": {name: round(spent / max(1, count), 3) for name, spent in processor.items()},
        "sizes": sorted(f"{width}x{height}" for width, height in sizes),
        "moves": moves,
    }


def words_of(cfg: DictConfig) -> list[str]:
    """Options of the job ``view`` besides run, width and mode."""
    device, threads = cfg.runtime.device, cfg.runtime.threads
    overrides = [f"runtime.device={device}"] if device != "auto" else []
    return [*overrides, *([f"runtime.threads={threads}"] if threads is not None else []), *cfg.overrides]


def save_screenshot(driver: Any, path: str) -> None:
    """Write a picture of the page.

    Raises:
        InputError: the file cannot be written.
    """
    driver.execute_script("document.querySelectorAll('[role=alert]').forEach((one) => one.remove())")
    picture = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
    with atomic_write(path) as temporary:
        picture.save(temporary, format="JPEG", quality=85, optimize=True)


def quote(text: str) -> str:
    """Quote a value of an override, which may contain Hydra's special characters."""
    return "'" + text.replace("'", "\\'") + "'"


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """Measure the page of a run while its camera is dragged, or only take a picture of it.

    Raises:
        InputError: there is no browser.
    """
    refuse_without_browser()
    words, load = words_of(cfg), os.getloadavg()[0]
    overrides = [f"run={quote(cfg.run)}", f"show={cfg.show}", f"width={cfg.width}", f"moving_width={cfg.width}"]

    def draw() -> None:
        with viewing([*overrides, *words]) as (address, _), browsing(address) as driver:
            save_screenshot(driver, cfg.picture)

    def measure(run: str) -> Iterator[dict[str, object]]:
        about = {"run": run, "show": cfg.show, "width": cfg.width, "options": " ".join(words)}
        with viewing([*overrides, *words]) as (address, job), browsing(address) as driver:
            pictures = drag_camera(driver, job, float(cfg.seconds))
        yield {**about, **pictures, "cores": usable_cores(), "load_before": round(load, 2)}

    keys = ("run", "show", "width", "options")
    if cfg.picture:
        return Study((), measure, keys, option="run", report=draw)
    return Study((Path(cfg.run).name,), measure, keys, option="run")


run = job(study)
