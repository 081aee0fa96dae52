# SPDX-License-Identifier: MIT
"""The rendered site: complete, without a dead link or raw TeX; in Chromium without an error.

With ``ENTER_SITE=1 docker/enter``, which brings Sphinx and Chromium; without them skipped.
"""

import io
import re
import shutil
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest

from demos.pages.turning import TURNED
from demos.site import __main__ as command

for name in ("sphinx", "myst_nb", "furo", "plotly"):
    pytest.importorskip(name, reason=f"{name} is missing: ENTER_SITE=1 docker/enter")

pytestmark = pytest.mark.slow
MAIN = ["index", "demos/README", "demos/first_hour/README", "demos/recipes/README"]
MAIN += ["demos/documents/README", "demos/notebooks/02_stresses", "forms/README", "meshes/README"]
MAIN += ["api/forms", "api/energies", "api/meshes", "search"]
# Each formula has been set by MathJax.
SET = "return [...document.querySelectorAll('.math')].every(m => m.querySelector('.mjx-math'))"


class Page(HTMLParser):
    """Links and ids of a page, its text outside of code and formulas, and its formulas."""

    VOID = ("area", "base", "br", "col", "embed", "hr", "img", "input", "link", "meta", "source")

    def __init__(self, file):
        super().__init__()
        self.links, self.ids, self.text, self.formulas, self.inside = [], set(), "", 0, []
        self.feed(file.read_text())

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.ids.add(found.get("id"))
        self.links += [found[key] for key in ("href", "src") if found.get(key)]
        math = "math" in (found.get("class") or "").split()
        self.formulas += math
        if tag not in self.VOID:
            self.inside.append((tag, math or tag in ("code", "pre", "script", "style", "svg")))

    def handle_endtag(self, tag):
        while self.inside and self.inside.pop()[0] != tag:
            pass

    def handle_data(self, data):
        if not any(hidden for _, hidden in self.inside):
            self.text += data


@pytest.fixture(scope="module")
def site(run, tmp_path_factory):
    """Its folder, built by the command of the pages, and what Sphinx said."""
    folder = tmp_path_factory.mktemp("site")
    done = run("-m", "demos.site", folder, cwd=folder)
    assert f"{folder / 'index.html'}: " in done.stdout
    return folder, done.stderr


@pytest.fixture(scope="module")
def pages(site):
    return {file: Page(file) for file in site[0].glob("**/*.html")}


def test_nothing_is_warned_of(site):
    """No reference that leads nowhere, no page out of the menu, no markup that is none."""
    assert site[1] == ""


def test_the_main_pages_are_there(site, pages):
    assert [name for name in MAIN if site[0] / f"{name}.html" not in pages] == []
    assert len(list(site[0].glob("demos/notebooks/[0-9]*.html"))) == 12
    reference = (site[0] / "api/energies.html").read_text()
    assert 'id="variform.forms.energies.neo_hookean"' in reference
    assert "psi = mu/2" in reference


def dead(pages, folder):
    """Links to a file, or to an id in it, that is not there, and to the web for what it needs."""
    found = []
    for file, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            if not target.is_relative_to(folder) or not target.is_file():
                found.append((file.name, link))
            elif parts.fragment and unquote(parts.fragment) not in (pages[target].ids | {"top"}):
                found.append((file.name, link))
    return found


def test_each_link_leads_to_a_file_and_an_id(site, pages):
    assert sum(len(page.links) for page in pages.values()) > 1000
    assert dead(pages, site[0]) == []


def test_a_dead_link_would_be_found(tmp_path):
    (tmp_path / "a.html").write_text('<p id="b"><a href="#b"/><a href="#c"/><img src="d.png"></p>')
    pages = {tmp_path / "a.html": Page(tmp_path / "a.html")}
    assert dead(pages, tmp_path) == [("a.html", "#c"), ("a.html", "d.png")]


def test_formulas_are_no_raw_tex(pages):
    """No dollar signs or commands of TeX in the text; the notebooks' formulas are marked."""
    raw = {f.name: re.findall(r".*(?:\$\$|\\frac|\\mathrm).*", p.text) for f, p in pages.items()}
    assert {name: found for name, found in raw.items() if found} == {}
    assert sum(page.formulas for page in pages.values()) > 100


def test_nothing_comes_from_another_server(pages):
    """Scripts, styles, pictures and fonts are the site's own."""
    wanted = re.compile(
        r"<(?:script|img)[^>]*src=\"(\w*:?//[^\"]+)|<link[^>]*href=\"(\w*:?//[^\"]+)"
    )
    assert {file.name for file in pages if wanted.search(file.read_text())} == set()


def test_what_it_refuses(run, tmp_path, monkeypatch, capsys):
    """A folder of something else is not written over; it has no options, and needs its parts."""
    monkeypatch.setattr(command, "MATHJAX", tmp_path / "nowhere")
    assert command.main([]) == 1
    assert (
        capsys.readouterr().out
        == "The site needs MathJax: ENTER_SITE=1 docker/enter brings them.\n"
    )
    (tmp_path / "mine").write_text("mine")
    done = run("-m", "demos.site", tmp_path, check=False)
    assert "has something else in it than a site: name another folder." in done.stdout
    assert done.returncode == 2 and (tmp_path / "mine").read_text() == "mine"
    done = run("-m", "demos.site", "--fast", check=False)
    assert done.stdout == "One folder is all that can be given, not --fast.\n"
    assert done.returncode == 2


@pytest.fixture
def browser(tmp_path):
    """A headless Chromium, whose console is kept."""
    pytest.importorskip("selenium", reason="selenium is missing: ENTER_SITE=1 docker/enter")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    words = ("headless=new", "no-sandbox", "disable-dev-shm-usage", "window-size=1400,1000")
    for word in (*words, "enable-unsafe-swiftshader"):  # WebGL without a graphics card
        options.add_argument(f"--{word}")
    options.add_argument(f"--user-data-dir={tmp_path}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    options.binary_location = shutil.which("chromium")
    service = webdriver.ChromeService(shutil.which("chromedriver"))
    driver = webdriver.Chrome(options=options, service=service)
    yield driver
    driver.quit()


def waited(browser, condition):
    """What a condition gives once it holds."""
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(browser, 120).until(condition)


def severe(browser):
    return [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def test_chromium_opens_the_main_pages(site, browser):
    """From the disk, without an error in the console; formulas are set, and the search finds."""
    from selenium.webdriver.common.by import By

    for name in MAIN:
        browser.get(f"file://{site[0]}/{name}.html")
        waited(browser, lambda b: b.execute_script(SET))
        assert browser.find_elements(By.CSS_SELECTOR, ".mjx-merror, .MathJax_Error") == []
        broken = "return [...document.images].filter(i => i.complete && !i.naturalWidth).length"
        assert browser.execute_script(broken) == 0
    browser.get(f"file://{site[0]}/search.html?q=neo_hookean")
    waited(browser, lambda b: b.find_elements(By.CSS_SELECTOR, "#search-results li a"))
    assert severe(browser) == []


def turned(browser, name):
    """Open a body's frame, which is loaded then and not before, and drag the mouse across it.

    Returns:
        The share of the frame that is inked, what of it changes by itself, and by the drag.
    """
    import matplotlib.image
    import numpy as np
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By

    frame = browser.find_element(By.CSS_SELECTOR, f"iframe[data-page='figures/{name}.html']")
    summary = frame.find_element(By.XPATH, "../summary")
    scroll = "arguments[0].scrollIntoView({block: 'start', behavior: 'instant'})"
    browser.execute_script(scroll, frame.find_element(By.XPATH, ".."))
    browser.switch_to.frame(frame)
    assert browser.execute_script("return document.URL") == "about:blank"
    browser.switch_to.default_content()
    assert not frame.is_displayed()
    summary.click()
    assert frame.is_displayed()
    browser.switch_to.frame(frame)
    canvas = waited(browser, lambda b: b.find_elements(By.CSS_SELECTOR, ".gl-container canvas"))[0]

    def seen():
        with io.BytesIO(canvas.screenshot_as_png) as png:
            return matplotlib.image.imread(png)[..., :3]

    def share(picture):  # of pixels that differ
        return (np.abs(picture - before).max(axis=2) > 0.1).mean()

    waited(browser, lambda b: np.ptp(seen()) > 0.5)
    before = seen()
    still = share(seen())
    drag = ActionChains(browser).move_to_element(canvas).click_and_hold()
    drag.move_by_offset(150, 40).move_by_offset(50, 10).release().perform()
    waited(browser, lambda b: share(seen()) > 0.005)
    found = (before.min(axis=2) < 0.9).mean(), still, share(seen())
    browser.switch_to.default_content()
    return found


def test_bodies_are_turned_by_the_mouse(site, browser):
    """A drag changes most of what is drawn; without one it stands still; no error is told."""
    for name in TURNED:
        browser.get(f"file://{site[0]}/demos/README.html")
        inked, still, changed = turned(browser, name)
        assert inked > 0.03 and still == 0 and changed > 0.3 * inked, name
    assert severe(browser) == []
