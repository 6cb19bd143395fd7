"""The page in a real browser, on the real studio: what somebody does with it, and what is on the screen then."""

import io
import json
from contextlib import ExitStack
from urllib.parse import unquote

import numpy as np
import pytest
from browsing import a_browser, a_page, until
from PIL import Image

from mmi.walks.walk import Pose
from viewer.serving.server import ServerOptions, ServerThread
from viewer.window.options import StudioOptions
from viewer.window.studio import Studio

FIRST = "globalThis.viewer?.state.header"
POSE = "viewer.state.header.pose"


@pytest.fixture(scope="module")
def studio(dataset):
    with Studio(dataset.path, StudioOptions()) as one:
        yield one


@pytest.fixture(scope="module")
def address(studio):
    with ServerThread(studio, ServerOptions(places=8)) as found:
        yield found


@pytest.fixture(scope="module")
def browser():
    with a_browser() as one:
        yield one


@pytest.fixture
def page(browser, address):
    """The page, with its first picture."""
    with a_page(browser, address) as one:
        until(one, FIRST)
        yield one


def on_canvas(page):
    """(h, w, 3) what the canvas shows."""
    data = page.evaluate("document.getElementById('picture').toDataURL('image/png')")
    raw = page.request.get(data).body() if data.startswith("http") else __import__("base64").b64decode(data.split(",", 1)[1])
    return np.asarray(Image.open(io.BytesIO(raw)).convert("RGB"))


def settled(page):
    """Wait until no new picture has come for a while."""
    count = -1
    while count != (count := page.evaluate("viewer.state.header.frame")):
        page.wait_for_timeout(500)
