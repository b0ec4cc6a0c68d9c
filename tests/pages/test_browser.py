"""The pages in a browser: nothing is asked of a network, nothing fails, charts answer.

Needs Playwright for Python and a Chromium: that of `playwright install chromium`, or the program
that the variable CHROMIUM names.
"""

import os
import time

import pytest
from test_page import run, sweep  # noqa: F401 - fixtures

from resc.pages.write import write_page

pytestmark = pytest.mark.slow
ALONE = ["--no-sandbox", "--no-zygote", "--single-process", "--in-process-gpu"]
"""What a Chromium takes that runs in a container, as root."""
LONGEST_S = 2.0


@pytest.fixture(scope="module")
def browser():
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with api.sync_playwright() as play:
        try:
            own = os.environ.get("CHROMIUM")
            opened = play.chromium.launch(executable_path=own, args=ALONE if own else [])
        except api.Error as error:
            pytest.skip(f"no Chromium opens here: {error}".splitlines()[0])
        yield opened
        opened.close()


@pytest.fixture
def look(browser):
    """Opens a page; complains of what it asks for and of what it says."""

    def opened(path):
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        page.said = []
        page.on("console", lambda message: page.said.append(message.text))
        page.on("pageerror", lambda error: page.said.append(str(error)))
        page.on("request", lambda request: page.said.append(request.url))
        began = time.perf_counter()
        page.goto(path.as_uri())
        assert time.perf_counter() - began < LONGEST_S
        asked = [text for text in page.said if not text.startswith("data:")]
        assert asked == [path.as_uri()]
        broken = "[...document.images].filter(image => !image.naturalWidth).length"
        assert page.evaluate(broken) == 0
        return page

    return opened


def test_curves_of_a_run_answer(run, look):  # noqa: F811
    page = look(write_page(run))
    figure = page.locator("figure[data-chart]").first
    figure.locator("svg[role=img]").hover()
    assert "outcome/success" in figure.locator(".tip").inner_text()
    assert figure.locator("path.line").count() == 1
    figure.locator("button").click()
    assert figure.locator("path.line").count() == 0


def test_a_sweep_is_filtered(sweep, look):  # noqa: F811
    page = look(write_page(sweep))
    assert page.locator("tr[data-run]:visible").count() == 4
    page.locator("#choice fieldset", has_text="obstacle_observation").locator(
        "input"
    ).last.uncheck()
    assert page.locator("tr[data-run]:visible").count() == 2
    assert page.locator("tr[data-variant]:visible").count() == 1
