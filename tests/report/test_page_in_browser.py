"""The page in a real browser: what a reader drags, presses and reads."""

import json
import math
import os
import shutil
from pathlib import Path

import pytest

from gaussian_enhancer.files import write_text
from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.page import document

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, views: list[ComparedView], provenance: dict[str, str]) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_text(path, document("Raw against enhanced", views, provenance))
    if folder := os.environ.get("GAUSSIAN_ENHANCER_SHOW_REPORT"):
        shutil.copy(path, folder)
    return path


def stage(page, index: int = 0):
    element = page.find_element("css selector", f"#view-{index} .stage")
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    return element


def visible_widths(page, stage) -> dict[str, list[int]]:
    """Visible pixels' columns of each picture of a stage: [first, last), as the browser clips them."""
    script = """
    const box = arguments[0].getBoundingClientRect(), shown = {};
    for (const image of arguments[0].querySelectorAll("img")) {
      const style = getComputedStyle(image);
      if (style.visibility !== "visible") continue;
      const inset = /inset\\(0px ([^ )]+)/.exec(style.clipPath);
      const cut = inset ? new Function("w", `return ${inset[1].replace("calc", "").replaceAll("%", "/100*w")
        .replaceAll("px", "")}`)(box.width) : 0;
      shown[image.className] = Math.round(box.width - cut);
    }
    shown.divider = Math.round(arguments[0].querySelector(".divider").getBoundingClientRect().left + 1 - box.left);
    shown.width = Math.round(box.width);
    return shown;
    """
    return page.execute_script(script, stage)


def colour_at(page, stage, share: float) -> tuple[int, int, int]:
    """The colour on the screen at a share of the stage's width, low in the picture where nothing lies over it."""
    import io

    from PIL import Image

    picture = Image.open(io.BytesIO(stage.screenshot_as_png)).convert("RGB")
    return picture.getpixel((round(share * (picture.width - 1)), round(0.9 * picture.height)))


def test_dragging_moves_the_divider(page) -> None:
    from selenium.webdriver import ActionChains

    target = stage(page)
    before = visible_widths(page, target)
    assert before["raw"] == before["divider"] == pytest.approx(before["width"] / 2, abs=1)
    assert before["enhanced"] == before["width"]
    width = before["width"]
    ActionChains(page).move_to_element(target).click_and_hold().move_by_offset(-width // 4, 5).perform()
    held = visible_widths(page, target)
    assert held["raw"] == held["divider"] == pytest.approx(width / 4, abs=2)
    ActionChains(page).move_by_offset(width // 2, -5).release().perform()
    after = visible_widths(page, target)
    assert after["raw"] == after["divider"] == pytest.approx(3 * width / 4, abs=2)
    ActionChains(page).move_by_offset(-30, 0).perform()
    assert visible_widths(page, target) == after, "the divider follows a pointer that was let go"
    assert page.execute_script("return arguments[0].querySelector('input').value", target) == "75"


def test_dragging_changes_the_pixels_on_the_screen(page) -> None:
    from selenium.webdriver import ActionChains

    target = stage(page)
    page.execute_async_script(
        """const [stage, done] = arguments;
        const paint = (name, colour) => {
          const canvas = document.createElement("canvas"), context = canvas.getContext("2d");
          context.fillStyle = colour;
          context.fillRect(0, 0, 999, 999);
          const image = stage.querySelector(name);
          image.src = canvas.toDataURL();
          return image.decode();
        };
        Promise.all([paint(".raw", "#f00"), paint(".enhanced", "#00f")]).then(() => done());""",
        target,
    )
    assert colour_at(page, target, 0.4) == (255, 0, 0)
    assert colour_at(page, target, 0.6) == (0, 0, 255)
    ActionChains(page).drag_and_drop_by_offset(target, -round(0.3 * target.size["width"]), 0).perform()
    assert colour_at(page, target, 0.4) == (0, 0, 255)
    assert colour_at(page, target, 0.1) == (255, 0, 0)


def test_the_keyboard_moves_the_divider(page) -> None:
    from selenium.webdriver.common.keys import Keys

    target = stage(page)
    slider = target.find_element("tag name", "input")
    page.execute_script("arguments[0].focus()", slider)
    slider.send_keys(Keys.ARROW_LEFT * 3)
    moved = visible_widths(page, target)
    assert moved["raw"] == moved["divider"] == pytest.approx(0.47 * moved["width"], abs=1)
    assert slider.get_attribute("aria-valuetext") == "47 % render"
    slider.send_keys(Keys.HOME)
    assert visible_widths(page, target)["raw"] == 0
    slider.send_keys(Keys.END)
    assert visible_widths(page, target)["raw"] == moved["width"]
    assert slider.accessible_name == "Divider between render and enhanced, 001.png"


def test_toggles_show_the_photo_and_the_errors(page) -> None:
    target = stage(page)
    first = page.find_element("id", "view-0")
    shown = {"photo": {"enhanced", "photo"}, "error": {"error-raw", "error-enhanced"}, "compare": {"raw", "enhanced"}}
    for mode, pictures in shown.items():
        button = first.find_element("css selector", f".controls [data-mode={mode}]")
        button.click()
        assert set(visible_widths(page, target)) - {"divider", "width"} == pictures
        assert button.get_attribute("aria-pressed") == "true"
        assert len(first.find_elements("css selector", ".controls [aria-pressed=true]")) == 1
        assert first.find_element("css selector", ".legend").is_displayed() == (mode == "error")
    page.find_element("css selector", ".bar-all [data-mode=error]").click()
    modes = page.execute_script("return [...document.querySelectorAll('.stage')].map((s) => s.dataset.mode)")
    assert modes == ["error"] * 3


def test_every_picture_is_decoded(page) -> None:
    sizes = page.execute_script("return [...document.images].map((i) => [i.naturalWidth, i.naturalHeight])")
    assert sizes == [[64, 48]] * 10 + [[36, 64]] * 5


def test_the_numbers_shown_equal_the_records(page, views: list[ComparedView]) -> None:
    script = """return [...document.querySelectorAll(".card")].map((card) => Object.fromEntries(
      [...card.querySelectorAll("tbody tr")].map((row) => [row.dataset.metric, Object.fromEntries(
        [...row.querySelectorAll("[data-of]")].map(
          (cell) => [cell.dataset.of, [cell.dataset.value, cell.innerText]]))])))"""
    block = json.loads(page.execute_script("return document.getElementById('report-data').textContent"))
    for index, (view, rows) in enumerate(zip(views, page.execute_script(script), strict=True)):
        assert rows.pop("lpips_alex") == {}
        assert rows.keys() == view.metrics_raw.keys()
        for key, cells in rows.items():
            raw, enhanced = view.metrics_raw[key], view.metrics_enhanced[key]
            for of, expected in (("raw", raw), ("enhanced", enhanced), ("gain", enhanced - raw)):
                exact, shown = cells[of]
                assert float(exact) == expected == block["views"][index][of][key]
                places = len(shown.partition(".")[2])
                assert float(shown.replace("−", "-").replace("±", "")) == pytest.approx(
                    expected, abs=0.5 * 10**-places + 1e-12
                )
    tile = page.find_element("css selector", ".tile[data-metric=psnr_aligned] [data-of=gain]")
    gains = [view.metrics_enhanced["psnr_aligned"] - view.metrics_raw["psnr_aligned"] for view in views]
    assert math.isclose(float(tile.get_attribute("data-value")), sum(gains) / 3)


def test_sorting_reorders_rows_and_cards(page) -> None:
    rows = "return [...document.querySelectorAll('.overview tbody tr')].map((r) => r.dataset.view)"
    cards = "return [...document.querySelectorAll('.card')].map((c) => c.dataset.view)"
    button = page.find_element("css selector", "[data-sort=psnr_aligned]")
    button.click()
    assert page.execute_script(rows) == page.execute_script(cards) == ["1", "2", "0"]
    button.click()
    assert page.execute_script(rows) == page.execute_script(cards) == ["0", "2", "1"]
    page.find_element("css selector", "[data-sort=name]").click()
    assert page.execute_script(rows) == ["1", "0", "2"]


@pytest.mark.parametrize("width", [320, 390, 1280])
def test_nothing_overflows(page, width: int) -> None:
    size = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        for mode in ("compare", "error"):
            page.find_element("css selector", f".bar-all [data-mode={mode}]").click()
            beyond = page.execute_script(
                """return [document.documentElement.scrollWidth, [...document.querySelectorAll("body *")]
                .filter((e) => e.getBoundingClientRect().right > innerWidth + 0.5 && !e.closest(".scroll > *"))
                .map((e) => e.tagName + "." + e.className)]"""
            )
            assert beyond[0] <= width
            assert beyond[1] == []
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
