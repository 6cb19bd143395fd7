"""The window on the desktop: which browser shows it, with what, and that both end together. Most browsers here are scripts."""

import asyncio
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import aiohttp
import pytest
from fake_studio import FakeStudio

from mmi.foundation.errors import ParameterError
from viewer.serving import desktop
from viewer.serving.desktop import find_browser, has_screen, show_window
from viewer.serving.server import ServerOptions, ServerThread

ROOTS = [str(Path(__file__).parents[i]) for i in (2, 3)]


@pytest.fixture
def browser(tmp_path, monkeypatch):
    """Makes a script the only browser of a machine that has a screen; it may write into ``tmp_path``."""
    bare = tmp_path / "bin"
    bare.mkdir()
    monkeypatch.setattr(desktop, "_APPLICATIONS", ())
    monkeypatch.setenv("PATH", str(bare))
    monkeypatch.setenv("DISPLAY", ":77")

    def put(script, name="google-chrome"):
        path = bare / name
        path.write_text(f"#!/bin/sh\nPATH=/usr/bin:/bin\ncd {tmp_path}\n{script}\n")
        path.chmod(0o755)
        return path

    return put


def profile_of(arguments):
    return Path(next(one for one in arguments if one.startswith("--user-data-dir=")).partition("=")[2])


def test_a_browser_shows_the_address_and_nothing_else_in_a_profile_of_its_own(browser, tmp_path):
    browser(
        'printf "%s\\n" "$@" > arguments; for one; do case $one in --user-data-dir=*) ls -d "${one#*=}" > there;; esac; done'
    )
    show_window("http://127.0.0.1:8000/?token=abc", size=(900, 700))
    arguments = (tmp_path / "arguments").read_text().splitlines()
    assert {"--app=http://127.0.0.1:8000/?token=abc", "--window-size=900,700", "--no-first-run"} <= set(arguments)
    assert (tmp_path / "there").read_text().strip() == str(profile_of(arguments))
    assert not profile_of(arguments).exists(), "it is thrown away"
    assert ("--no-sandbox" in arguments) is (os.geteuid() == 0)


def test_it_returns_when_the_window_is_closed_and_not_before(browser):
    browser("sleep 0.5")
    start = time.monotonic()
    show_window("http://127.0.0.1:8000/")
    assert 0.5 <= time.monotonic() - start < 5.0


def test_a_browser_that_fails_is_quoted(browser):
    path = browser('echo "cannot open display" >&2; echo >&2; exit 3')
    with pytest.raises(ParameterError, match=f"{path}: a window expected, found: cannot open display$"):
        show_window("http://127.0.0.1:8000/")
    browser("exit 3")
    with pytest.raises(ParameterError, match="a window expected, found: exit status 3"):
        show_window("http://127.0.0.1:8000/")
    path.write_bytes(b"\x7fELF nothing")
    with pytest.raises(ParameterError, match="a browser expected, found: "):
        show_window("http://127.0.0.1:8000/")


def test_what_is_missing_is_named(browser, monkeypatch):
    with pytest.raises(ParameterError, match="Chromium, Google Chrome, Microsoft Edge or Brave expected, found none"):
        find_browser()
    path = browser("exit 0", "microsoft-edge")
    assert find_browser() == path
    assert browser("exit 0", "chromium") == find_browser(), "the first that there is"
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(ParameterError, match="a screen to show a window on expected"):
        show_window("http://127.0.0.1:8000/")


def test_windows_and_macos_have_a_screen(monkeypatch):
    for name, there in (("linux", False), ("darwin", True), ("win32", True)):
        monkeypatch.setattr(sys, "platform", name)
        assert has_screen({}) is there
        assert has_screen({"WAYLAND_DISPLAY": "wayland-0"})


def test_ctrl_c_ends_the_browser_and_its_children(browser, tmp_path):
    browser("sleep 60 & echo $! > child; echo $$ > parent; : > ready; wait")
    script = f"import sys; sys.path[:0] = {ROOTS!r}\nfrom viewer.serving.desktop import show_window\nshow_window('http://127.0.0.1:8000/')"
    process = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 20.0
    while not (tmp_path / "ready").exists() and time.monotonic() < until:
        time.sleep(0.02)
    pids = [int((tmp_path / name).read_text()) for name in ("child", "parent")]
    process.send_signal(signal.SIGINT)
    assert "KeyboardInterrupt" in process.communicate(timeout=10.0)[1]
    until = time.monotonic() + 20.0
    while any(map(running, pids)) and time.monotonic() < until:
        time.sleep(0.02)
    assert not any(map(running, pids))


def running(pid):
    """Whether a process is there and no zombie that nobody has asked for."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


async def closed_by_hand(said):
    """Waits until a browser shows a page of the viewer, and closes the browser, by its own protocol. Returns the page."""
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=10.0)) as session:
        while True:
            await asyncio.sleep(0.1)
            found = re.search(r"ws://127\.0\.0\.1:(\d+)/\S+", said.read_text() if said.exists() else "")
            if found is None:
                continue
            async with session.get(f"http://127.0.0.1:{found[1]}/json/list") as answer:
                pages = await answer.json(content_type=None)
            shown = [one for one in pages if one["type"] == "page" and "crossroads" in one["title"]]
            if shown:
                async with session.ws_connect(found[0]) as protocol:
                    await protocol.send_json({"id": 1, "method": "Browser.close"})
                    await protocol.receive()
                return shown[0]


def test_a_real_browser_shows_the_page_and_its_end_ends_the_window(browser, tmp_path):
    names = ("chromium", "google-chrome")
    real = next((found for name in names if (found := shutil.which(name, path="/usr/bin"))), None)
    if real is None:
        pytest.skip("needs Chromium")
    # Without a screen.
    browser(f'echo $$ > parent; exec {real} --headless=new --remote-debugging-port=0 "$@" 2> said')
    with (
        FakeStudio() as studio,
        ServerThread(studio, ServerOptions(token="a-token-of-tests")) as address,
        ThreadPoolExecutor(1) as pool,
    ):
        closing = pool.submit(lambda: asyncio.run(asyncio.wait_for(closed_by_hand(tmp_path / "said"), 40.0)))
        closing.add_done_callback(
            lambda done: done.exception() and os.kill(int((tmp_path / "parent").read_text()), signal.SIGKILL)
        )
        with suppress(ParameterError):  # then it says less than closing does
            show_window(address)
        shown = closing.result()
    assert shown["title"] == "crossroads – view-impostors"
    assert shown["url"].startswith(address.partition("?")[0])
