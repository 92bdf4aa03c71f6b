"""The page in a real browser: a user drags the camera, switches what is shown, and saves."""

import io
import os
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.report.figures import colour_map
from gaussian_enhancer.scene.path_files import read_path
from gaussian_enhancer.viewer.modes import Mode
from gaussian_enhancer.viewer.page import PageSettings
from gaussian_enhancer.viewer.saved import SavedFiles
from gaussian_enhancer.viewer.serve import serve_page
from gaussian_enhancer.viewer.source import open_session

pytestmark = pytest.mark.browser
pytest.importorskip("viser", reason="viser is in the dependency group `test`")
FULL, SMALL = 400, 200
WAIT = 60
"""Seconds after which a picture that does not come is a failure."""


@dataclass
class Opened:
    """The page in the browser.

    Args:
        driver: of the browser.
        folder: where views and paths are saved.
        told: lines that were told at the terminal.
    """

    driver: Any
    folder: Path
    told: list[str]

    @property
    def text(self) -> str:
        return self.driver.execute_script("return document.body.innerText")

    @property
    def frame(self) -> int:
        match = re.search(r"frame (\d+)", self.text)
        return int(match[1]) if match else 0

    @property
    def width(self) -> int:
        match = re.search(r"(\d+) × (\d+), frame", self.text)
        return int(match[1]) if match else 0

    @property
    def canvas(self) -> Any:
        return max(self.driver.find_elements("tag name", "canvas"), key=lambda element: element.size["width"])

    def picture(self) -> np.ndarray:
        """Colours of the middle of the canvas, in [0, 1]."""
        image = np.asarray(Image.open(io.BytesIO(self.canvas.screenshot_as_png)).convert("RGB")) / 255
        height, width = image.shape[:2]
        return image[height // 3 : -height // 3, width // 3 : -width // 3]

    def until(self, met: Callable[[], bool], awaited: str) -> None:
        end = time.monotonic() + WAIT
        while not met():
            assert time.monotonic() < end, f"{awaited} never came: {self.told} {self.text}"
            time.sleep(0.1)

    def press(self, label: str) -> None:
        button = next(element for element in self.driver.find_elements("tag name", "button") if label in element.text)
        self.driver.execute_script("arguments[0].scrollIntoView()", button)
        button.click()

    def choose(self, before: str, after: str) -> None:
        """Choose an option of the drop-down list that shows another one."""
        inputs = self.driver.find_elements("css selector", "input")
        field = next(element for element in inputs if element.get_attribute("value") == before)
        self.driver.execute_script("arguments[0].scrollIntoView()", field)
        field.click()
        found: list[Any] = []

        def listed() -> bool:
            options = self.driver.find_elements("css selector", "[role=option]")
            found[:] = [element for element in options if element.is_displayed() and element.text == after]
            return bool(found)

        self.until(listed, f"the option {after}")
        found[0].click()

    def drag(self, x: int, y: int = 0) -> None:
        from selenium.webdriver import ActionChains

        ActionChains(self.driver).drag_and_drop_by_offset(self.canvas, x, y).perform()


@pytest.fixture(scope="module")
def page(browser, configured, viewed, tmp_path_factory) -> Iterator[Opened]:
    told: list[str] = []
    session = open_session(configured(f"distilled={viewed / 'distilled.ply'}"), torch.device("cpu"), print)
    folder = tmp_path_factory.mktemp("saved") / "plane"
    settings = PageSettings(Mode("enhanced"), FULL, SMALL)
    with serve_page(session, SavedFiles(folder), settings, ("127.0.0.1", 0), told.append) as (_, address):
        browser.get(address)
        opened = Opened(browser, folder, told)
        opened.until(lambda: opened.width == FULL, "the first full picture")
        yield opened
        if shown := os.environ.get("GAUSSIAN_ENHANCER_SHOW_REPORT"):
            browser.save_screenshot(str(Path(shown) / "viewer.png"))
        browser.get("about:blank")


def test_the_splat_is_on_the_screen_with_its_times_and_the_nearest_photo(page):
    page.until(lambda: float(page.picture().std((0, 1)).max()) > 0.01, "a picture of the sheet")
    assert re.search(r"\d+ ms \(render \d+, references \d+, network \d+\), 400 × \d+", page.text)
    assert re.search(r"view_00\d\.png", page.text)


def test_dragging_draws_small_pictures_and_a_full_one_when_the_camera_is_still(page):
    page.until(lambda: page.width == FULL, "a full picture")
    before, first = page.frame, page.picture()
    from selenium.webdriver import ActionChains

    hold = ActionChains(page.driver).move_to_element(page.canvas).click_and_hold()
    hold.move_by_offset(30, 0).perform()
    page.until(lambda: page.frame > before, "a picture while the camera moves")
    widths = {page.width}
    for _ in range(10):
        ActionChains(page.driver).move_by_offset(2, 1).perform()
        widths.add(page.width)
    ActionChains(page.driver).release().perform()
    page.until(lambda: page.width == FULL and page.frame > before + 1, "the full picture of the still camera")
    assert SMALL in widths
    page.until(lambda: float(np.abs(page.picture() - first).mean()) > 0.003, "a changed picture")


def test_maps_are_shown_instead_of_colours(page):
    colours = colour_map().numpy()

    def off_map() -> float:
        shown = page.picture()[::8, ::8].reshape(-1, 1, 3)
        return float(np.abs(shown - colours).max(-1).min(-1).mean())

    page.choose("enhanced", "depth")
    page.until(lambda: "Light: near" in page.text and off_map() < 0.05, "the depth map")
    page.choose("depth", "enhanced")
    page.until(lambda: "Light: near" not in page.text and off_map() > 0.05, "the enhanced view")


def test_other_weights_bring_their_strength(page):
    bright = next(
        element.get_attribute("value")
        for element in page.driver.find_elements("css selector", "input")
        if (element.get_attribute("value") or "").endswith("bright.safetensors")
    )
    page.choose(bright, "lr_tiny")
    page.until(lambda: "1" in strengths(page), "the strength of the other weights")
    page.choose("lr_tiny", bright)
    page.until(lambda: "1" not in strengths(page) and page.width == FULL, "the first weights' strength")


def strengths(page: Opened) -> list[str]:
    return [element.get_attribute("value") or "" for element in page.driver.find_elements("css selector", "input")]


def test_the_button_moves_the_camera_to_the_nearest_photo(page):
    """The tests below begin there, within the capture, which paths must not leave."""
    before = page.picture()
    page.drag(60, 20)
    page.until(lambda: page.width == FULL and float(np.abs(page.picture() - before).mean()) > 0.005, "a move")
    frame = page.frame
    page.press("Go to its camera")
    page.until(lambda: page.frame > frame and page.width == FULL, "the view from the photo's camera")


def test_a_view_and_a_path_are_saved_for_the_job_video(page):
    page.press("Save path")
    page.until(lambda: any("add the cameras it shall pass" in line for line in page.told), "the refusal")
    assert not page.folder.exists()
    page.press("Add camera to path")
    page.until(lambda: "passes 1 cameras" in page.text, "the first camera")
    before = page.frame
    page.drag(-4, 1)
    page.until(lambda: page.frame > before + 1 and page.width == FULL, "a still picture")
    page.press("Add camera to path")
    page.until(lambda: "passes 2 cameras" in page.text, "the second camera")
    page.press("Save path")
    page.until((page.folder / "path_001.json").is_file, "the path")
    path = read_path(page.folder / "path_001.json", 1, 1)
    assert path.fps == 30
    assert len(path.cameras) == 240
    assert float((path.cameras[0].centre - path.cameras[-1].centre).norm()) > 0.01
    page.press("Save view")
    page.until(lambda: any("view_001.png" in line for line in page.told), "the view")
    with Image.open(page.folder / "view_001.png") as image:
        assert image.width == FULL


def test_photos_that_cannot_be_read_are_told_once_and_the_page_goes_on(page, viewed):
    moved = viewed / "elsewhere"
    photos = viewed / "train" / "ours_100" / "gt"
    told = len(page.told)
    photos.rename(moved)
    try:
        page.choose("distilled", "raw")
        page.until(lambda: len(page.told) > told, "the refusal")
        page.drag(3)
        page.drag(-3)
    finally:
        moved.rename(photos)
    refused = page.told[told:]
    assert len(refused) == len(set(refused))
    assert all("/gt/view_0" in line for line in refused), refused
    frame = page.frame
    page.choose("raw", "distilled")
    page.until(lambda: page.frame > frame and page.width == FULL, "the first splat")


def test_no_error_was_logged(page):
    severe = [entry["message"] for entry in page.driver.get_log("browser") if entry["level"] == "SEVERE"]
    assert severe == []
