# SPDX-License-Identifier: MIT
"""Notebooks in a browser: what can be clicked or dragged is, as a student would.

With ``ENTER_SITE=1 docker/enter``, which brings Chromium and selenium; without them skipped.
"""

import base64
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import matplotlib.image
import numpy as np
import pytest
from conftest import ROOT

selenium = pytest.importorskip("selenium", reason="selenium is missing: ENTER_SITE=1 docker/enter")
from selenium import webdriver  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from selenium.webdriver.support.expected_conditions import (  # noqa: E402
    text_to_be_present_in_element,
)
from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

pytestmark = pytest.mark.slow
NOTEBOOKS = sorted((ROOT / "demos" / "notebooks").glob("[0-9]*.ipynb"))
LONG = 300  # s, against hangs only


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Address of a notebook server on a copy of the notebooks, and its token."""
    folder = tmp_path_factory.mktemp("notebooks")
    for file in NOTEBOOKS:
        shutil.copy(file, folder)
    words = [sys.executable, "-m", "notebook", "--no-browser", "--port-retries=50", folder]
    process = subprocess.Popen(
        [*words, "--allow-root"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    said, found, begun = "", None, time.monotonic()
    os.set_blocking(process.stdout.fileno(), False)
    while found is None and process.poll() is None and time.monotonic() - begun < LONG:
        time.sleep(0.2)
        said += (process.stdout.read() or b"").decode()
        found = re.search(r"(http://(?:localhost|127\.0\.0\.1):\d+)/\S*token=(\w+)", said)
    try:
        assert found, said
        yield found[1], found[2]
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.communicate(timeout=60)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A headless Chromium."""
    options = webdriver.ChromeOptions()
    profile = tmp_path_factory.mktemp("profile")
    for word in ("headless=new", "no-sandbox", "disable-dev-shm-usage", "window-size=1400,1000"):
        options.add_argument(f"--{word}")
    options.add_argument(f"--user-data-dir={profile}")
    options.binary_location = shutil.which("chromium")
    service = webdriver.ChromeService(shutil.which("chromedriver"))
    driver = webdriver.Chrome(options=options, service=service)
    yield driver
    driver.quit()


def opened(browser, server, name):
    """Open a notebook and wait until its cells are there."""
    address, token = server
    browser.get(f"{address}/notebooks/{name}?token={token}")
    loaded = "return window.Jupyter && Jupyter.notebook && Jupyter.notebook._fully_loaded"
    WebDriverWait(browser, LONG).until(lambda b: b.execute_script(loaded))


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_each_solution_is_hidden_and_opens_by_a_click(file, browser, server):
    """It looks like something to click, shows itself, and hides again."""
    opened(browser, server, file.name)
    solutions = browser.find_elements(By.TAG_NAME, "details")
    assert len(solutions) >= 2
    for solution in solutions:
        summary = solution.find_element(By.TAG_NAME, "summary")
        assert summary.text.strip().endswith("Solution (click to show it)")
        inside = solution.find_element(By.CSS_SELECTOR, "p, pre, div")
        browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", summary)
        assert not inside.is_displayed()
        summary.click()
        assert inside.is_displayed()
        summary.click()
        assert not inside.is_displayed()


def executed(browser, server, name):
    """Open a notebook, execute its cells and wait for its slider and picture.

    A server that is slow to begin a kernel loses the page's first messages: it is loaded again.
    """
    # Of a cell that waits the prompt is a star, of one that has run its number.
    ran = (
        "return Jupyter.notebook.get_cells().every(cell => cell.cell_type != 'code' "
        "|| !cell.get_text() || cell.input_prompt_number > 0)"
    )
    for _ in range(4):
        opened(browser, server, name)
        time.sleep(3)
        browser.execute_script("Jupyter.notebook.execute_all_cells()")
        begun = time.monotonic()
        while time.monotonic() - begun < 75:
            time.sleep(1)
            there = browser.find_elements(By.CSS_SELECTOR, ".noUi-handle")
            if browser.execute_script(ran) and there and shown(browser) is not None:
                return
    pytest.fail(f"{name} shows no slider")


def shown(browser):
    """Pixels of the last picture below the slider's cell; None while there is none."""
    found = browser.find_elements(By.CSS_SELECTOR, ".jupyter-widgets img")
    if not found:
        return None
    data = found[-1].get_attribute("src").partition("base64,")[2]
    return matplotlib.image.imread(io.BytesIO(base64.b64decode(data)))[..., :3]


def test_the_slider_of_shear_draws_every_traction(browser, server):
    """At both ends: at gamma = 2 Cauchy's tractions on all four faces are inside the picture."""
    executed(browser, server, "02_stresses.ipynb")
    handle, first = browser.find_element(By.CSS_SELECTOR, ".noUi-handle"), shown(browser)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", handle)
    for key, value in ((Keys.END, "2.00"), (Keys.HOME, "0.00")):
        handle.send_keys(key)
        readout = (By.CSS_SELECTOR, ".widget-readout")
        reads = text_to_be_present_in_element(readout, value)
        WebDriverWait(browser, LONG).until(reads)
        time.sleep(2)
        picture = shown(browser)
        green = (np.abs(picture - [0.173, 0.627, 0.173]) < 0.12).all(axis=2)
        if key == Keys.HOME:
            assert green.sum() == 0  # at rest there are none
        else:
            assert picture.shape != first.shape or np.abs(picture - first).max() > 0.5
            columns = np.flatnonzero(green.any(axis=0))
            assert columns.max() - columns.min() > 0.6 * picture.shape[1]
