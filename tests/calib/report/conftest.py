"""A real browser for the pages: Debian's Chromium, driven by Playwright, without a network."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.calib.report.browser import Visit

# A software WebGL logs this when a test reads its pixels back; a page can neither cause nor avoid it.
READBACK = "GPU stall due to ReadPixels"
SCREENSHOTS = Path(__file__).resolve().parents[3] / "build" / "screenshots"


@pytest.fixture(scope="session")
def _browser() -> Iterator[Any]:
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium is installed, so no page was opened in a browser (Debian: apt-get install chromium)")
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed, so no page was opened in a browser")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-dev-shm-usage"])
        yield browser
        browser.close()


@pytest.fixture
def visit(_browser: Any) -> Iterator[Callable[..., Visit]]:
    """Open a file: visit(path, dark=False, width=1280) -> Visit.

    `before` runs ahead of the page's own scripts. A screenshot is kept in build/screenshots.
    """
    contexts = []

    def opened(path: Path, dark: bool = False, width: int = 1280, shot: str | None = None, before: str = "") -> Visit:
        context = _browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light", offline=True
        )
        contexts.append(context)
        seen = Visit(context.new_page())
        seen.page.on(
            "console",
            lambda m: seen.complaints.append(m.text) if m.type in ("error", "warning") and READBACK not in m.text else None,
        )
        seen.page.on("pageerror", lambda e: seen.complaints.append(str(e)))
        seen.page.on("request", lambda r: seen.requests.append(r.url))
        seen.page.add_init_script(before)
        seen.page.goto(path.resolve().as_uri())
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        name = (shot or path.stem) + ("-dark" if dark else "") + ("" if width == 1280 else f"-{width}")
        seen.page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)
        seen.requests = [url for url in seen.requests if url != path.resolve().as_uri()]
        return seen

    yield opened
    for context in contexts:
        context.close()
