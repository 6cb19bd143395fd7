"""How fast the viewer is end to end: frames a second on the screen, and the time from a key to its picture.

The program itself is started, and its page opened in a headless Chromium on the same machine, which walks a tour. Frames are
counted, and times taken, where the page draws them. A key is pressed every few frames; its time is from the event to the
picture that was drawn from where it has led.

    python benchmarks/viewing.py OUT [--size 1280x720] [--seconds 10]

What a frame takes is told part by part: plan and drawing, reading the picture back, composing, encoding (in other threads), the
way (sending, and the word that it was drawn back), and the page (decoding, and waiting for a frame of the screen).
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

from mmi.programs.command_line import size_option

PROGRAM = "from viewer.programs.view_impostors import view_impostors; view_impostors()"
MODES = (("one", "multi-mesh"), ("one", "full"), ("one", "multi-mesh-dynamic"), ("swipe", "multi-mesh"))
PARTS = ("render", "read", "compose", "encode", "way", "paint")


@contextmanager
def viewing(dataset: Path) -> Iterator[str]:
    """The address of the program's page."""
    command = [sys.executable, "-c", PROGRAM, str(dataset), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


def until(page: Page, expression: str, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        if time.monotonic() > end:
            raise TimeoutError(expression)
        page.wait_for_timeout(20)


def walked(page: Page, mode: str, technique: str, seconds: float) -> dict[str, Any]:
    """What the page measured on a tour, and then while keys were pressed."""
    page.evaluate("document.activeElement?.blur()")
    page.locator(f"[data-mode={mode}]").evaluate("(one) => one.click()")
    page.locator("#right").evaluate(
        "(one, value) => { one.value = value; one.dispatchEvent(new Event('change')); }", technique
    )
    page.wait_for_timeout(1500)
    page.keyboard.press("t")
    until(page, "viewer.state.header.playing === 'tour'")
    page.wait_for_timeout(2000)
    page.evaluate("viewer.restart()")
    page.wait_for_timeout(1000 * seconds)
    tour = page.evaluate("viewer.measured()")
    page.keyboard.press("t")
    until(page, "viewer.state.header.playing === null")
    page.evaluate("viewer.restart()")
    for i in range(int(4 * seconds)):
        key = "ad"[i % 2]
        page.keyboard.down(key)
        page.wait_for_timeout(130)
        page.keyboard.up(key)
        page.wait_for_timeout(97)
    return {"tour": tour, "keys": page.evaluate("viewer.measured()")}


def told(name: str, found: dict[str, Any]) -> str:
    """A row of the table."""
    drawn, ms = np.array(found["tour"]["drawn"]), found["tour"]["ms"]
    latencies = np.array(found["keys"]["latencies"])
    between = np.diff(drawn)
    means = {part: float(np.mean([one[part] for one in ms])) for part in PARTS}
    means["way"] = max(means["way"] - means["paint"], 0.0)
    busy = (means["render"] + means["read"] + means["compose"]) / between.mean()
    parts = " | ".join(f"{means[part]:.1f} ({100 * means[part] / sum(means.values()):.0f} %)" for part in PARTS)
    return (
        f"| {name} | {1e3 / between.mean():.1f} | {np.median(between):.1f} / {np.percentile(between, 95):.1f} "
        f"| {np.median(latencies):.0f} / {np.percentile(latencies, 95):.0f}, {2.0 * np.median(between) + 20.0:.0f} "
        f"| {parts} | {100 * busy:.0f} % |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="OUT")
    parser.add_argument("--size", type=size_option, default=(1280, 720), metavar="WxH", help="(default: 1280x720)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement (default: %(default)g)")
    options = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with viewing(options.dataset) as address, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        start = time.perf_counter()
        width, height = options.size
        page = browser.new_page(viewport={"width": width, "height": height})
        page.goto(address)
        until(page, "globalThis.viewer?.state.header")
        print(
            f"{options.dataset.name}: the first picture came {time.perf_counter() - start:.1f} s after the page was asked for"
        )
        page.evaluate("document.body.classList.add('folded'); document.getElementById('map').hidden = true")
        until(page, f"viewer.state.header.width === {width}")
        print(
            "| mode | frames a second | between frames, ms: p50 / p95 | key to picture, ms: p50 / p95, "
            "two frames and 20 ms | drawing ms "
            "| reading back | composing | encoding | sending and word back | page | the drawing thread is busy |"
        )
        print("|" + "---|" * 11)
        for mode, technique in MODES:
            print(told(f"{mode}, {technique}", walked(page, mode, technique, options.seconds)), flush=True)
        browser.close()


if __name__ == "__main__":
    main()
