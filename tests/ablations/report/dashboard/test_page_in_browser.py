"""The dashboard in a real browser: what a reader opens, sorts, clicks and drags."""

import random
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from ablations.report.dashboard.folder import TableRecords, all_records, read_folder
from ablations.report.dashboard.page import document
from ablations.report.dashboard.pictures import copy_pictures
from ablations.report.dashboard.runs import source_runs
from ablations.study.description import SceneGroup
from ablations.study.lines import table_lines
from ablations.study.results import Results
from support.dashboard_samples import NASTY, QUALITY, record, write_results, write_runs

pytestmark = pytest.mark.browser
PARTS = ("tables", "curves", "distributions", "pictures", "tradeoff", "stability", "plan", "settings", "measurements")


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> tuple[TableRecords, ...]:
    return read_folder(write_results(tmp_path_factory.mktemp("results")))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, listed: tuple[TableRecords, ...]) -> Path:
    folder = tmp_path_factory.mktemp("dashboard")
    runs = write_runs(folder / "runs")
    sources = source_runs(runs, all_records(listed))
    pictures = copy_pictures(listed, runs, folder)
    shutil.rmtree(runs)
    (folder / "dashboard.html").write_text(document("Suite", listed, sources, pictures))
    return folder / "dashboard.html"


def all_of(page, selector: str, read: str = "e.textContent") -> list:
    return page.execute_script(f"return [...document.querySelectorAll(arguments[0])].map((e) => {read})", selector)


def go(page, address: str) -> None:
    """Follow an address within the page, drawn when this returns."""
    page.execute_script("location.hash = arguments[0]", address)
    until(page, "document.documentElement.dataset.drawn === location.hash")


def until(page, condition: str) -> None:
    """Wait for what an event brings about."""
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(page, 600).until(lambda p: p.execute_script(f"return {condition}"))


def click(page, selector: str) -> None:
    page.execute_script("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", selector)
    page.find_element("css selector", selector).click()


def test_the_numbers_are_those_of_the_records(page, listed: tuple[TableRecords, ...]) -> None:
    script = """return [...document.querySelectorAll(`#table-${arguments[0]} tbody tr`)].map((row) => [row.dataset,
      [...row.querySelectorAll("[data-of]")].map(
        (e) => [e.dataset.metric, e.dataset.of, e.dataset.value, e.textContent])])"""
    for one in listed:
        lines = table_lines(Results(one.table, one.records), one.records)
        shown = page.execute_script(script, one.table.name)
        assert len(shown) == len(lines) > 0
        for line, (where, cells) in zip(lines, shown, strict=True):
            assert (where["block"], where["row"], where.get("statistic", "")) == (
                line.block,
                line.method,
                line.statistic,
            )
            for metric, of, value, text in cells:
                expected = getattr(line.numbers[metric], of)
                assert (None if value is None else float(value)) == expected
                if value is None and of != "paper_gain" and line.method != one.table.baseline:
                    assert text.startswith("missing")
                    assert "not fitted <yet>" in text or line.numbers[metric].reasons[0] in text
                elif value is not None:
                    number = text.split(" ")[0].rstrip("*").replace("−", "-").replace("±", "")
                    assert float(number) == pytest.approx(expected, abs=0.0051)


def test_tabs_open_by_pointer_keyboard_and_address(page) -> None:
    from selenium.webdriver.common.keys import Keys

    assert all_of(page, "[role=tabpanel]", "e.childElementCount > 0").count(True) == 1, "drawn before it is opened"
    for part in PARTS:
        click(page, f"#tab-{part}")
        assert all_of(page, "[role=tabpanel]:not([hidden])", "e.id") == [f"part-{part}"]
        assert page.execute_script("return location.hash.split('?')[0]") == f"#{part}"
    page.find_element("id", "tab-measurements").send_keys(Keys.ARROW_RIGHT)
    assert all_of(page, "[role=tab][aria-selected=true]", "e.dataset.part") == ["tables"]
    assert page.switch_to.active_element.get_attribute("id") == "tab-tables"
    go(page, "#settings")
    assert all_of(page, "[role=tab][aria-selected=true]", "e.dataset.part") == ["settings"]


def test_provenance_on_a_click_and_its_links(page, listed: tuple[TableRecords, ...]) -> None:
    from selenium.webdriver.common.keys import Keys

    click(page, "#table-table_2 tr[data-block='3dgs'][data-row=gepp] [data-of=gain][data-metric=psnr] button")
    text = page.find_element("css selector", "dialog[open]").text
    for fact in (
        "0123abc",
        "2 cores <b>",
        "2026-11-21T10:00:00",
        "2026-11-21T10:00:01",
        "train: +ablation/variant=gepp_lr",
        "8 bit",
    ):
        assert fact in text
    assert listed[0].digest in text
    own = [
        c
        for r, c in zip(listed[0].records, listed[0].checksums, strict=True)
        if r.variant == "gepp" and r.kind == "quality"
    ]
    assert sorted(all_of(page, "dialog code")) == sorted(own)
    page.switch_to.active_element.send_keys(Keys.ESCAPE)
    assert all_of(page, "dialog[open]") == []
    click(page, "#table-table_2 tr[data-block='3dgs'][data-row=gepp] [data-of=value][data-metric=psnr] button")
    page.find_element("link text", "All 12 records of this cell").click()
    until(page, "document.documentElement.dataset.drawn.startsWith('#measurements')")
    assert sorted(all_of(page, "#part-measurements tbody tr", "e.dataset.record")) == sorted(own)
    click(page, "#part-measurements tbody button")
    assert all_of(page, "dialog dd", "e.textContent")[-1] in own
    page.find_element("partial link text", "train/gepp-seed").click()
    until(page, "document.documentElement.dataset.drawn.startsWith('#settings')")
    assert all_of(page, "[role=tab][aria-selected=true]", "e.dataset.part") == ["settings"]
    assert all_of(page, "dialog[open]") == []


def test_settings_show_what_differs_and_nothing_else(page) -> None:
    go(page, "#settings?left=train/gepp-seed0&right=train/gepp-seed1")
    methods = all_of(page, "#part-settings tbody tr", "[...e.children].map((c) => c.textContent)")
    assert methods == [["extra", "not set", "true"], ["seed", "0", "1"]]
    assert all_of(page, "#part-settings caption") == ["2 of 5 settings differ"]
    go(page, "#settings?left=train/gepp-seed0&right=train/ge-seed1")
    assert "train/ge-seed1: no settings, the run is not on this machine." in all_of(page, "#part-settings .absent")


def test_sliders_move_and_show_what_is_chosen(page) -> None:
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import Select

    go(page, "#pictures?scene=yard")
    assert all_of(page, ".card", "e.dataset.scene") == ["yard"] * 2
    stage = page.find_element("css selector", ".card .stage")
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", stage)
    ActionChains(page).drag_and_drop_by_offset(stage, -round(0.25 * stage.size["width"]), 0).perform()
    slider = stage.find_element("tag name", "input")
    assert float(slider.get_attribute("value")) == pytest.approx(25, abs=1)
    slider.send_keys(Keys.END)
    assert page.execute_script("return arguments[0].style.getPropertyValue('--split')", stage) == "100%"
    sizes = page.execute_async_script(
        """const done = arguments[0], images = [...document.querySelectorAll(".card:first-child .stage img")];
        const sizes = () => images.map((i) => [i.naturalWidth, i.naturalHeight]);
        Promise.all(images.map((i) => i.decode())).then(() => done(sizes()), (error) => done(String(error)))"""
    )
    assert sizes == [[24, 16]] * 2
    before = stage.find_element("css selector", "img.enhanced").get_attribute("src")
    Select(page.find_elements("css selector", ".card .controls select")[1]).select_by_visible_text("photo")
    assert stage.find_element("css selector", "img.enhanced").get_attribute("src") != before
    assert slider.accessible_name.startswith("Divider between render and photo, yard")
    assert "the enhanced run scene0-3dgs-ge-0 is not on this machine" in page.find_element("id", "part-pictures").text


def test_curves_and_distributions_are_drawn(page, listed: tuple[TableRecords, ...]) -> None:
    go(page, "#curves?quantity=train/total")
    assert all_of(page, ".curve", "e.dataset.run") == ["gepp-seed0", "gepp-seed1"]
    assert all_of(page, ".curve", "e.getAttribute('d').split('L').length") == [10, 10]
    assert "ge-seed1: the run is not on this machine" in page.find_element("id", "part-curves").text
    click(page, "#part-curves .key input")
    assert all_of(page, ".curve", "getComputedStyle(e).display !== 'none'") == [False, True]
    go(page, "#distributions?table=table_2&metric=psnr")
    assert all_of(page, ".median", "Number(e.dataset.n)") == [6] * 4
    records = listed[0].records
    raw = {(r.scene, r.view): r.metrics["psnr"] for r in records if r.variant == "raw" and r.kind == "quality"}
    gains = sorted(
        (r.metrics["psnr"] or 0) - (raw[r.scene, r.view] or 0)
        for r in records
        if (r.variant, r.scene, r.kind) == ("ge", "yard", "quality")
    )
    assert all_of(page, ".median", "Number(e.dataset.median)")[0] == pytest.approx((gains[2] + gains[3]) / 2, abs=1e-9)


def test_every_link_leads_somewhere(page) -> None:
    found: set[str] = set()
    for part in PARTS:
        go(page, f"#{part}")
        found |= set(all_of(page, "main a", "e.getAttribute('href')"))
    click(page, "#tab-tables")
    click(page, "#table-table_2 tr[data-row=gepp] [data-of=gain] button")
    found |= set(all_of(page, "dialog a", "e.getAttribute('href')"))
    assert {address.partition("?")[0] for address in found} == {"#tables", "#measurements", "#settings"}
    for address in sorted(found):
        go(page, address)
        assert all_of(page, "[role=tabpanel]:not([hidden])", "e.id") == [f"part-{address[1:].partition('?')[0]}"]
        if address.startswith("#tables?table="):
            assert len(all_of(page, f"#table-{address.partition('=')[2]}")) == 1
        if address.startswith("#measurements"):
            assert all_of(page, "#part-measurements tbody tr")
        assert not [text for text in all_of(page, ".absent") if text.startswith("No record names")]


def test_names_are_text_everywhere(page) -> None:
    for part in PARTS:
        go(page, f"#{part}")
        assert all_of(page, "script", "e.id") == ["dashboard-data", ""]
        assert all_of(page, "img[src=x]") == []
        assert page.title == "Suite"
    go(page, "#measurements")
    assert NASTY in all_of(page, "#part-measurements tbody button")


def test_of_ten_thousand_records_the_first_of_the_order_asked_for_are_drawn(browser, tmp_path: Path) -> None:
    chance = random.Random(0)
    scenes = tuple(f"scene_{i}" for i in range(10))
    table = replace(QUALITY, splats=("3dgs",), datasets={"all": SceneGroup("All", scenes)}, seeds=(0, 1, 2))
    views = [f"{i:04d}.png" for i in range(143)]
    made = [
        record(scene, "3dgs", view, method, seed, 20 + chance.random(), chance.random())
        for scene in scenes
        for view in views
        for method, seed in [("raw", None), *[(method, seed) for method in ("ge", "gepp") for seed in (0, 1, 2)]]
    ]
    assert len(made) == 10_010
    listed = (TableRecords(table, tuple(made), tuple(f"{i:012x}" for i in range(len(made))), "f" * 64),)
    (tmp_path / "dashboard.html").write_text(document("Large", listed))
    assert (tmp_path / "dashboard.html").stat().st_size < 4_000_000
    browser.get("about:blank")
    browser.get((tmp_path / "dashboard.html").as_uri())
    go(browser, "#measurements")
    sort = """const heads = [...document.querySelectorAll("#part-measurements thead button")];
      heads.find((e) => e.textContent.startsWith("PSNR")).click()"""
    browser.execute_script(sort)
    lowest = sorted(value for one in made if (value := one.metrics["psnr"]) is not None)[:200]
    assert all_of(browser, "#part-measurements [data-metric=psnr]", "Number(e.dataset.value)") == lowest
    go(browser, "#distributions?table=table_2&metric=psnr")
    assert all_of(browser, ".median", "Number(e.dataset.n)")
