"""The panels to explore: what is packed comes back, and a browser shows, zooms and toggles it without a network."""

from __future__ import annotations

import base64
import json
import re
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_diagnosis import RIG, example
from hypothesis import given
from hypothesis import strategies as st

from twin.report.explorer import explorer, removable
from twin.report.html import Story, html
from twin.report.panels import packed

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip


def unpacked(told: dict[str, Any]) -> np.ndarray:
    """The samples again, by the rule that the script follows."""
    codes = np.frombuffer(zlib.decompress(base64.b64decode(told["data"])), dtype="<u2").astype(int)
    values, level = np.full(len(codes), np.nan), 0
    for i, code in enumerate(codes):
        if code != 65535:
            level = (level + code) % 65535
            values[i] = told["low"] + level * told["step"]
    return values


@given(st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=60))
def test_samples_come_back_within_half_a_step(values: list[float]) -> None:
    told = packed(np.array(values))
    back = unpacked(told)
    assert np.array_equal(np.isnan(back), np.isnan(values))
    assert np.nanmax(np.abs(back - values), initial=0.0) <= 0.5001 * told["step"]


def test_an_effect_that_is_taken_out_leaves_the_first_models_physics() -> None:
    d = example()
    (model,) = removable(d).values()
    assert model.structure == d.before.structure
    assert all(d.after.values[name] == value for name, value in model.values.items())


def test_every_sample_of_a_short_recording_is_there() -> None:
    d = example()
    found = re.search(r'id="explorer-data">(.*?)</script>', explorer(d), re.DOTALL)
    assert found
    (stretch,) = json.loads(found.group(1))["stretches"]
    recording = d.recordings[0]
    assert stretch["count"] == len(recording.time)
    back = unpacked(stretch["channels"]["recorded"])
    assert np.nanmax(np.abs(back - recording.output)) <= np.ptp(recording.output[np.isfinite(recording.output)]) / 1e5
    assert np.isnan(back).sum() == np.isnan(recording.output).sum()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    if BROWSER is None:
        pytest.skip("Chromium is not installed")
    from playwright.sync_api import sync_playwright

    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(html(Story(example(), RIG)), encoding="utf-8")
    with sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=BROWSER, args=FLAGS)
        shown = browser.new_page(viewport={"width": 1000, "height": 900})
        shown.said, shown.asked = [], []
        shown.on("console", lambda message: shown.said.append(message.text))
        shown.on("pageerror", lambda error: shown.said.append(str(error)))
        shown.on("request", lambda request: shown.asked.append(request.url))
        shown.goto(Path(path).as_uri())
        shown.wait_for_selector("#explorer[data-ready=yes]")
        yield shown
        browser.close()


def span(page: Any) -> tuple[float, float]:
    low, high = page.get_attribute("#explorer", "data-span").split()
    return float(low), float(high)


def test_a_stretch_is_zoomed_and_all_comes_back(page: Any) -> None:
    whole = span(page)
    canvas = page.locator("#explorer canvas").first
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 500, box["y"] + 70, steps=5)
    page.mouse.up()
    low, high = span(page)
    assert whole[0] < low < high < whole[1]
    canvas.dblclick()
    assert span(page) == whole


def test_the_keyboard_and_the_links_reach_every_stretch(page: Any) -> None:
    d, whole = example(), span(page)
    page.locator("#explorer canvas").first.press("+")
    low, high = span(page)
    assert high - low == pytest.approx(0.5 * (whole[1] - whole[0]), rel=1e-4)
    page.locator("#explorer canvas").first.press("0")
    assert span(page) == whole
    page.locator("a[data-from]").first.click()
    worst = max(d.segments, key=lambda s: s.share)
    assert span(page) == pytest.approx((worst.start, worst.end), abs=1e-5)
    page.get_by_role("button", name="whole").click()


def test_lines_and_effects_are_switched(page: Any) -> None:
    for name in ("recorded", "gravity on the link"):
        button = page.get_by_role("button", name=name)
        before = button.get_attribute("aria-pressed")
        picture = page.locator("#explorer canvas").first.screenshot()
        button.click()
        assert button.get_attribute("aria-pressed") != before
        assert page.locator("#explorer canvas").first.screenshot() != picture


def test_nothing_is_asked_of_a_network_and_nothing_fails(page: Any) -> None:
    assert page.said == []
    assert all(url.startswith("file:") for url in page.asked)


def test_a_phone_shows_it_without_scrolling_sideways(page: Any) -> None:
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.set_viewport_size({"width": 1000, "height": 900})
