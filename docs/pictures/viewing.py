"""The pictures of the viewer in the documentation, and the animation at the top of the README, taken in a browser.

python docs/pictures/viewing.py OUT FOLDER [PART ...]

Parts: swipe, wrong, layers, side, difference, depth, objects, freeze, card, map, film; all of them by default.
OUT is the dataset that scripts/demo builds.
"""

import io
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from urllib.parse import urlencode

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from mmi import open_dataset
from viewer import tour

SIZE = {"width": 1280, "height": 720}
SHOWN = (960, 540)
FILM = (640, 360)
"""Pixels of pictures, and of the film."""
METRES, SPEED, FPS = 45.0, 5.0, 8.0
"""Of the film's walk, and its frames a second."""


def link(pose: tuple[float, ...] | None, look: Mapping[str, object]) -> str:
    """The fragment of a page's address that restores a view."""
    place = {} if pose is None else {"pose": ",".join(f"{value:.4f}" for value in pose)}
    return urlencode(place | {"look": json.dumps(look)})


def start_of(page: Page) -> tuple[float, ...]:
    """Where the viewer begins."""
    page.wait_for_function("viewer.state.header !== null", timeout=60_000)
    return tuple(page.evaluate("viewer.state.hello.pose"))


def shown(page: Page, address: str, pose: tuple[float, ...], look: Mapping[str, object], *, wait: float = 2.5) -> None:
    """Show a view, and wait until it is there and settled."""
    page.goto("about:blank")
    page.goto(f"{address}#{link(pose, look)}")
    page.wait_for_function("viewer.state.header !== null", timeout=60_000)
    if page.is_visible("#hint-close"):
        page.click("#hint-close")
    time.sleep(wait)


def change(page: Page, fragment: str) -> None:
    """Show what the fragment of an address says, without opening the page again."""
    page.evaluate("fragment => { location.hash = fragment; }", fragment)


def keep(page: Page, path: Path, size: tuple[int, int] = SHOWN) -> None:
    """Write what the page shows."""
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB").resize(size, Image.Resampling.LANCZOS)
    picture.save(path, quality=80, method=6)


def film(page: Page, poses: Sequence[tuple[float, ...]], path: Path) -> None:
    """A walk with the swipe going from side to side."""
    page.keyboard.press("p")
    frames = []
    for i, pose in enumerate(poses):
        swipe = 0.5 - 0.38 * math.sin(2.0 * math.pi * i / len(poses))
        before = page.evaluate("viewer.state.header.frame")
        change(page, link(pose, {"swipe": round(swipe, 3)}))
        page.wait_for_function("before => viewer.state.header.frame > before + 1", arg=before)
        shot = Image.open(io.BytesIO(page.screenshot(type="jpeg", quality=92))).convert("RGB")
        frames.append(shot.resize(FILM, Image.Resampling.LANCZOS))
    first, *rest = frames
    first.save(path, save_all=True, append_images=rest, duration=round(1000 / FPS), loop=0, quality=50, method=6)


def walked(dataset: Path) -> list[tuple[float, ...]]:
    """Poses of a tour along the streets of the dataset's cells."""
    manifest = open_dataset(dataset).manifest
    cells, neighbours = [one.viewing_cell for one in manifest.cells], {one.id: one.neighbours for one in manifest.cells}
    walk = tour(cells, neighbours, metres=METRES, speed=SPEED, seed=1)
    return [(*step.pose.eye, step.pose.azimuth, step.pose.pitch) for step in walk.frames(FPS)]


def main(dataset: str, folder: str, *parts: str) -> None:
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    server = subprocess.Popen(
        [Path(sys.executable).parent / "view-impostors", dataset, "--no-browser"], stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    address = server.stdout.readline().strip()
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            page = browser.new_page(viewport=SIZE, bypass_csp=True)
            page.goto(address)
            pose = start_of(page)
            above = (pose[0], pose[1], pose[2] + 45.0, pose[3], -0.45)
            looks: dict[str, Callable[[], None]] = {
                "swipe": lambda: shown(page, address, pose, {"right": "multi-mesh"}),
                "wrong": lambda: shown(page, address, pose, {"mode": "wrong", "worst": True}, wait=5.0),
                "layers": lambda: shown(page, address, pose, {"mode": "one", "show": "layers", "wireframe": True}),
                "side": lambda: shown(page, address, pose, {"mode": "side", "left": "local"}),
                "difference": lambda: shown(page, address, pose, {"mode": "difference"}),
                "depth": lambda: shown(page, address, pose, {"mode": "one", "show": "depth"}),
                "objects": lambda: shown(page, address, pose, {"mode": "one", "show": "objects"}),
                "freeze": lambda: frozen(page, address, pose, above),
                "card": lambda: asked(page, address, pose),
                "map": lambda: mapped(page, address, pose),
            }
            for name, show in looks.items():
                if not parts or name in parts:
                    show()
                    keep(page, out / f"viewer-{name}.webp")
            if not parts or "film" in parts:
                shown(page, address, pose, {})
                film(page, walked(Path(dataset)), out / "viewer.webp")
            browser.close()
    finally:
        server.terminate()
        server.wait(30)


def frozen(page: Page, address: str, pose: tuple[float, ...], above: tuple[float, ...]) -> None:
    """Impostors as they are for the street, seen from above."""
    shown(page, address, pose, {"mode": "one"})
    page.keyboard.press("g")
    time.sleep(0.5)
    change(page, link(above, {}))
    time.sleep(2.5)


def asked(page: Page, address: str, pose: tuple[float, ...]) -> None:
    """What the viewer says of a building."""
    shown(page, address, pose, {"mode": "one"})
    page.mouse.click(300, 330)
    page.wait_for_selector("#card:not([hidden])", timeout=30_000)
    time.sleep(3.0)


def mapped(page: Page, address: str, pose: tuple[float, ...]) -> None:
    """The large map."""
    shown(page, address, pose, {})
    page.keyboard.press("m")
    time.sleep(2.5)


if __name__ == "__main__":
    main(*sys.argv[1:])
