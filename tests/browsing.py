"""A headless Chromium for tests of pages: the system's own, driven by Playwright."""

import os
import shutil
import time
from contextlib import contextmanager

import pytest
from playwright.sync_api import sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome")


def chromium():
    """The path of the browser; tests that need one are skipped where there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"a browser expected ({', '.join(NAMES)}), found none")
    return found


@contextmanager
def a_browser():
    """A browser; while it is open, nothing else in this thread can run a loop of asyncio."""
    root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium(), args=[*root, "--disable-gpu"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def a_page(browser, address, *, size=(900, 560), scheme="dark", touch=False):
    """The page at ``address`` in a window of ``size``. Whatever it says in its console fails the test."""
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, has_touch=touch, accept_downloads=True
    )
    page = context.new_page()
    said = []
    page.on("console", lambda one: said.append(f"{one.type}: {one.text}") if one.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    try:
        page.goto(address)
        yield page
    finally:
        context.close()
    unexpected = [one for one in said if "WebSocket connection" not in one and "ERR_CONNECTION" not in one]
    assert not unexpected


def until(page, expression, *, seconds=20.0):
    """The value of a JavaScript expression, once it is true; the page's policy forbids Playwright's own way to wait for it."""
    end = time.monotonic() + seconds
    while not (found := page.evaluate(expression)):
        assert time.monotonic() < end, f"not within {seconds:g} s: {expression}"
        page.wait_for_timeout(20)
    return found
