"""The viewer in a window of its own: an installed Chromium, Chrome, Edge or Brave without its bars, in a profile of its own.

A window library was measured first. pywebview 6.2 brings 530 MB with Qt, wants Debian packages that only its error messages
name, and refuses to run as root; with GTK it wants 72 Debian packages, one of which (python3-gi) virtual environments do
not see. A browser that is there already needs nothing, and shows the page as it was tested.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from mmi.foundation.errors import ParameterError

__all__ = ["find_browser", "has_screen", "show_window"]

_NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "microsoft-edge",
    "microsoft-edge-stable",
    "brave-browser",
    "msedge",
    "chrome",
)
_APPLICATIONS = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    "/Applications/Brave Browser.app/Contents/MacOS/Brave Browser",
)
"""Where macOS has them; none is on the path there."""
_PROGRAMS = (
    r"Microsoft\Edge\Application\msedge.exe",
    r"Google\Chrome\Application\chrome.exe",
    r"Chromium\Application\chrome.exe",
)
"""Where Windows has them, within its folders of programs."""
_SILENT = (
    "--no-first-run",
    "--no-default-browser-check",
    "--no-service-autorun",
    "--disable-background-mode",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-sync",
    "--disable-features=Translate,MediaRouter",
    "--password-store=basic",
    "--use-mock-keychain",
)
"""It asks nothing, fetches nothing, and stays for nobody."""


def show_window(address: str, *, size: tuple[int, int] = (1280, 800)) -> None:
    """Open a window with the page at ``address``, ``size`` pixels large, and return when somebody has closed it.

    Whatever is raised meanwhile (KeyboardInterrupt) closes it. Raises ParameterError where there is no screen or no browser,
    and where the browser fails.
    """
    if not has_screen(os.environ):
        raise ParameterError("a screen to show a window on expected (DISPLAY or WAYLAND_DISPLAY), found none")
    browser = find_browser()
    with TemporaryDirectory(prefix="view-impostors-", ignore_cleanup_errors=True) as profile:
        log = Path(profile) / "log"
        with log.open("wb") as said, _running(_command(browser, address, profile, size), said.fileno()) as process:
            status = process.wait()
        if status != 0:
            lines = log.read_text(errors="replace").split("\n")
            why = next((line.strip() for line in reversed(lines) if line.strip()), f"exit status {status}")
            raise ParameterError(f"{browser}: a window expected, found: {why[:300]}")


def find_browser() -> Path:
    """A browser that can show a page without its bars. Raises ParameterError that says what to install."""
    for name in _NAMES:
        found = shutil.which(name)
        if found is not None:
            return Path(found)
    folders = [os.environ.get(name) for name in ("PROGRAMFILES", "PROGRAMFILES(X86)", "LOCALAPPDATA")]
    places = [Path(one) for one in _APPLICATIONS] + [Path(one) / name for one in folders if one for name in _PROGRAMS]
    for place in places:
        if place.is_file():
            return place
    raise ParameterError(
        "Chromium, Google Chrome, Microsoft Edge or Brave expected, found none; install one (on Debian: apt-get install "
        "chromium), or open the page's address in any other browser"
    )


def has_screen(environment: Mapping[str, str]) -> bool:
    """Whether a program can open a window here."""
    return sys.platform in ("darwin", "win32") or any(environment.get(one) for one in ("DISPLAY", "WAYLAND_DISPLAY"))


def _command(browser: Path, address: str, profile: str, size: tuple[int, int]) -> list[str]:
    own = [f"--app={address}", f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
    # Browsers refuse to run as root with a sandbox, and warn of running without, unless it is a test. All that this one
    # opens is the viewer's own page.
    root = ["--no-sandbox", "--test-type"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    return [str(browser), *own, *_SILENT, *root]


@contextmanager
def _running(command: list[str], log: int) -> Iterator[subprocess.Popen[bytes]]:
    """A process with a group of its own, which Ctrl-C in a terminal does not reach; it and its children end with the block."""
    try:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
    except OSError as error:
        raise ParameterError(f"{command[0]}: a browser expected, found: {error.strerror or error}") from error
    try:
        yield process
    finally:
        _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """At once, with all its children: its profile vanishes with it, so there is nothing to put in order."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):  # no one is left
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
