"""The viewer in a notebook's cell: what the cell shows, who may frame it, and that it ends."""

import asyncio
import re
import subprocess
import sys
import threading
from html import unescape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
from browsing import a_browser, a_page, until
from fake_studio import FakeStudio

from mmi.foundation.errors import DatasetError, ParameterError
from viewer.serving.notebook import NOTEBOOKS, NotebookViewer, show_in_notebook
from viewer.serving.server import ServerOptions

OPTIONS = ServerOptions(token="a-token-of-tests", framed_by=NOTEBOOKS)


def frame_of(shown):
    """The address in what a notebook is given."""
    return unescape(re.search(r'<iframe src="([^"]+)"', shown._repr_html_())[1])


def test_a_cell_shows_a_frame_with_the_page_and_its_token():
    with NotebookViewer(FakeStudio(), OPTIONS, height=432) as shown:
        assert frame_of(shown) == shown.address
        assert 'height="432"' in shown._repr_html_()
        where = urlsplit(shown.address)
        assert (where.hostname, where.query) == ("127.0.0.1", "token=a-token-of-tests")
        with urlopen(shown.address, timeout=5.0) as answer:
            policy = answer.headers["Content-Security-Policy"]
            assert b"<html" in answer.read().lower()
        ancestors = re.search(r"frame-ancestors ([^;]*)", policy)[1].split()
        assert set(ancestors) >= {"http://localhost:*", "http://127.0.0.1:*"} and "*" not in ancestors
        assert repr(shown) == f"a viewer at {shown.address}"


def test_a_viewer_that_was_closed_says_so_and_lets_go_of_all():
    before = set(threading.enumerate())
    shown = NotebookViewer(FakeStudio(), OPTIONS)
    address = shown.address
    shown.close()
    shown.close()
    assert "closed" in shown._repr_html_() and "iframe" not in shown._repr_html_()
    assert repr(shown) == "a viewer that was closed"
    with pytest.raises(OSError, match="refused"):
        urlopen(address, timeout=5.0)
    assert set(threading.enumerate()) <= before


def test_a_viewer_runs_beside_the_loop_of_a_kernel():
    async def cell():
        return NotebookViewer(FakeStudio(), OPTIONS)

    shown = asyncio.run(cell())
    with shown, urlopen(shown.address, timeout=5.0) as answer:
        assert answer.status == 200


def test_it_ends_with_the_process_that_forgot_it():
    script = (
        f"import sys; sys.path[:0] = {[str(Path(__file__).parents[i]) for i in (2, 3)]!r}\n"
        "from fake_studio import FakeStudio\n"
        "from viewer.serving.notebook import NotebookViewer\n"
        "from viewer.serving.server import ServerOptions\n"
        "print(NotebookViewer(FakeStudio(), ServerOptions(token='a-token-of-tests')).address)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30.0, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    with pytest.raises(OSError, match="refused"):
        urlopen(done.stdout.strip(), timeout=5.0)


def test_mistakes_are_told_before_anything_runs(tmp_path):
    before = set(threading.enumerate())
    with pytest.raises(DatasetError, match="nowhere"):
        show_in_notebook(tmp_path / "nowhere")
    with pytest.raises(ParameterError, match="height: 200 to 4000 pixels expected, found 3"):
        NotebookViewer(FakeStudio(), OPTIONS, height=3)
    assert set(threading.enumerate()) == before


def test_two_viewers_have_an_address_each():
    with NotebookViewer(FakeStudio(), OPTIONS) as one, NotebookViewer(FakeStudio(), OPTIONS) as other:
        assert one.address != other.address


class Notebook(BaseHTTPRequestHandler):
    """A page of another site (localhost, where the viewer is at 127.0.0.1) that shows what a cell gives."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(self.server.shown.encode())

    def log_message(self, *_):
        pass


def test_a_browser_shows_it_within_the_notebook_with_its_film(tmp_path):
    """No cookie goes to a frame of another site."""
    with (
        NotebookViewer(FakeStudio(films=tmp_path), OPTIONS) as shown,
        ThreadingHTTPServer(("127.0.0.1", 0), Notebook) as notebook,
        a_browser() as browser,
        a_page(browser, shown.address) as page,
    ):
        notebook.shown = f"<!doctype html><title>notebook</title>{shown._repr_html_()}"
        threading.Thread(target=notebook.serve_forever, daemon=True).start()
        try:
            page.goto(f"http://localhost:{notebook.server_port}/")
            frame = page.frames[1]
            until(frame, "document.title === 'crossroads – view-impostors'")
            frame.evaluate("document.getElementById('film').click()")
            until(frame, "document.querySelector('#result a') !== null")
            film = frame.evaluate(
                "fetch(document.querySelector('#result a').href).then((one) => one.text().then((text) => [one.status, text]))"
            )
            assert film == [200, "a film"]
            assert frame.evaluate("document.querySelector('#result a').download") == "tour.mp4"
        finally:
            notebook.shutdown()
