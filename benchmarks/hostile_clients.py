"""What clients that misbehave do to one that does not: fifty of them against the viewer, on this machine only.

    python benchmarks/hostile_clients.py OUT [--seconds 60] [--clients 50] [--share 0.05]

The program itself is started, on 127.0.0.1. A well-behaved client looks around and takes every frame; its frames are counted
alone, beside the attackers, and alone again. The attackers share a process that is held to ``--share`` of a core, since beyond
that they would measure the machine, and end by themselves. Each is one of these, over and over:

    noise      random bytes to a new connection
    silence    a connection on which nothing is asked, or a request that never ends
    absurd     messages of absurd sizes and values, windows of every size
    flood      messages as fast as they can be sent
    closing    a page that is closed in the middle of a frame

The memory is that of the program: what it has after the first part, the most while it is attacked, and what it has in the end.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager, suppress
from multiprocessing import get_context
from multiprocessing.queues import Queue
from pathlib import Path
from urllib.parse import urlsplit

import aiohttp
import numpy as np

from viewer.serving.encoding import opened

PROGRAM = "from viewer.programs.view_impostors import view_impostors; view_impostors()"
SIZE = {"type": "size", "width": 1280, "height": 720}
EXPECTED = (ConnectionError, TimeoutError, aiohttp.ClientError, OSError, TypeError, asyncio.IncompleteReadError)
"""What attackers meet when they are sent away."""


# ------------------------------------------------------------------------------------------------------ the attackers


class Budget:
    """Holds this process to a share of a core: whoever is about to do something waits until there is time for it."""

    def __init__(self, share: float) -> None:
        self.share, self.start, self.used = share, time.perf_counter(), time.process_time()
        self.done: Counter[str] = Counter()

    async def turn(self, what: str) -> None:
        """Wait for time to do something, and count it."""
        while True:
            over = (time.process_time() - self.used) - self.share * (time.perf_counter() - self.start)
            if over <= 0.0:
                break
            await asyncio.sleep(min(over / self.share, 1.0) + 0.01 * random.random())
        self.done[what] += 1


def address_of(url: str) -> tuple[str, int]:
    where = urlsplit(url)
    assert where.hostname == "127.0.0.1", "only ever against this machine"
    return where.hostname, int(where.port or 0)


async def noise(url: str, budget: Budget, _: aiohttp.ClientSession) -> None:
    reader, writer = await asyncio.open_connection(*address_of(url))
    try:
        for _ in range(5):
            await budget.turn("noise")
            writer.write(random.randbytes(random.randint(1, 4000)))
            await writer.drain()
            await asyncio.wait_for(reader.read(1000), 0.5)
    finally:
        writer.close()


async def silence(url: str, budget: Budget, _: aiohttp.ClientSession) -> None:
    await budget.turn("silence")
    reader, writer = await asyncio.open_connection(*address_of(url))
    try:
        writer.write(random.choice((b"", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ", b"G")))
        await asyncio.wait_for(reader.read(1), 30.0)
    finally:
        writer.transport.abort()


def page(url: str, session: aiohttp.ClientSession) -> AbstractAsyncContextManager[aiohttp.ClientWebSocketResponse]:
    return session.ws_connect(
        url + "socket", origin=url.rstrip("/"), max_msg_size=0, timeout=aiohttp.ClientWSTimeout(ws_close=1.0)
    )


async def absurd(url: str, budget: Budget, session: aiohttp.ClientSession) -> None:
    async with page(url, session) as socket:
        for _ in range(30):
            await budget.turn("absurd")
            text = random.choice(
                (
                    json.dumps({"type": "size", "width": random.randint(-9, 9000), "height": random.randint(-9, 9000)}),
                    json.dumps(
                        {"type": "size", "width": random.choice((64, 3840)), "height": random.choice((64, 2160))}
                    ),
                    json.dumps({"type": "input", "seq": 10**30, "look": [1e308, 1e308]}),
                    "[" * random.randint(1, 60_000),
                    json.dumps({"type": "walk", "do": "replay", "walk": {"keyframes": [0] * 1000}}),
                    " " * 300_000,
                    json.dumps({"type": "pose", "pose": [1e9, -1e9, 1e9, 0, 0]}),
                    json.dumps({"type": "look", "look": {"left": "x" * 1000}}),
                )
            )
            await socket.send_str(text)
            with suppress(TimeoutError):
                await socket.receive(0.05)


async def flood(url: str, budget: Budget, session: aiohttp.ClientSession) -> None:
    async with page(url, session) as socket:
        await socket.send_json(SIZE)
        for i in range(400):
            await budget.turn("flood")
            for k in range(20):
                await asyncio.wait_for(
                    socket.send_json({"type": "input", "seq": 20 * i + k, "held": {"turn": 1.0}}), 5.0
                )


async def closing(url: str, budget: Budget, session: aiohttp.ClientSession) -> None:
    async with page(url, session) as socket:
        await budget.turn("closing")
        await socket.send_json(SIZE)
        await socket.send_json({"type": "input", "seq": 1, "held": {"forward": 1.0}})
        for _ in range(random.randint(1, 3)):
            await socket.receive(3.0)
        socket._response.connection.transport.abort()


KINDS: tuple[Callable[[str, Budget, aiohttp.ClientSession], Awaitable[None]], ...] = (
    noise,
    silence,
    absurd,
    flood,
    closing,
)


async def attack(url: str, seconds: float, clients: int, share: float) -> dict[str, int]:
    budget = Budget(share)
    end = time.perf_counter() + seconds

    async def one(kind: Callable[[str, Budget, aiohttp.ClientSession], Awaitable[None]]) -> None:
        while time.perf_counter() < end:
            with suppress(*EXPECTED):
                await kind(url, budget, session)
            budget.done["connections"] += 1
            await asyncio.sleep(0.05)

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        tasks = [asyncio.create_task(one(KINDS[i % len(KINDS)])) for i in range(clients)]
        await asyncio.wait(tasks, timeout=seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    used = time.process_time() - budget.used
    return dict(budget.done) | {"percent of a core": round(100 * used / (time.perf_counter() - budget.start))}


def attackers(url: str, seconds: float, clients: int, share: float, results: Queue[dict[str, int]]) -> None:
    results.put(asyncio.run(attack(url, seconds, clients, share)))


# -------------------------------------------------------------------------------------------------- who behaves well


class Visitor:
    """A client as the page is one, which does not decode what it is sent."""

    def __init__(self, url: str) -> None:
        self.url, self.errors = url, 0
        self.at: list[float] = []

    async def run(self, joined: asyncio.Event) -> None:
        """Look around for ever; ``joined`` is set with the first frame."""
        async with aiohttp.ClientSession() as session, page(self.url, session) as socket:
            await socket.send_json(SIZE)
            async for received in socket:
                if received.type is aiohttp.WSMsgType.BINARY:
                    header, _ = opened(received.data)
                    await socket.send_json({"type": "ack", "frame": header["frame"]})
                    self.at.append(time.perf_counter())
                    if not joined.is_set():
                        await socket.send_json({"type": "input", "seq": 1, "held": {"turn": 0.5}})
                    joined.set()
                elif json.loads(received.data)["type"] == "error":
                    self.errors += 1
        raise ConnectionError("the well-behaved client was sent away")

    def rate(self, start: float, end: float) -> tuple[float, float]:
        """(frames a second, the longest time between two in ms)."""
        frames = np.array([one for one in self.at if start <= one <= end])
        return len(frames) / (end - start), 1e3 * float(np.diff(frames).max(initial=0.0))


def megabytes(process: int) -> float:
    """The memory that a process has in use."""
    line = next(one for one in Path(f"/proc/{process}/status").read_text().splitlines() if one.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


async def measured(url: str, process: int, options: argparse.Namespace) -> None:
    visitor, joined = Visitor(url), asyncio.Event()
    visiting = asyncio.create_task(visitor.run(joined))
    await asyncio.wait_for(joined.wait(), 60.0)
    await asyncio.sleep(max(8.0, options.seconds / 3.0))  # cells are loaded, and all is warm
    context = get_context("spawn")
    results = context.Queue()
    parts, memory = [], [megabytes(process)]
    for part in ("alone", "attacked", "alone again"):
        attacker = None
        if part == "attacked":
            arguments = (url, options.seconds, options.clients, options.share, results)
            attacker = context.Process(target=attackers, args=arguments)
            attacker.start()
            await asyncio.sleep(1.5)  # it has started
        start = time.perf_counter()
        seconds = options.seconds if attacker is not None else options.seconds / 3.0
        while time.perf_counter() < start + seconds - (1.5 if attacker is not None else 0.0):
            await asyncio.sleep(0.25)
            if attacker is not None:
                memory.append(megabytes(process))
            if visiting.done():
                await visiting
        parts.append((part, *visitor.rate(start, time.perf_counter())))
        if attacker is not None:
            done = await asyncio.to_thread(results.get, True, 30.0)
            attacker.join()
            await asyncio.sleep(2.0)
    memory.append(megabytes(process))
    visiting.cancel()
    for part, rate, longest in parts:
        print(f"{part}: {rate:.1f} frames a second, the longest pause {longest:.0f} ms")
    alone = 0.5 * (parts[0][1] + parts[2][1])
    print(
        f"the well-behaved client kept {100 * parts[1][1] / alone:.0f} % of its frames, and was told {visitor.errors} errors"
    )
    print(
        f"memory: {memory[0]:.0f} MB before, at most {max(memory):.0f} MB ({100 * (max(memory) / memory[0] - 1):+.1f} %), "
        f"{memory[-1]:.0f} MB in the end ({100 * (memory[-1] / memory[0] - 1):+.1f} %)"
    )
    print(f"{options.clients} attackers: " + ", ".join(f"{count} {what}" for what, count in sorted(done.items())))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="OUT")
    parser.add_argument("--seconds", type=float, default=60.0, help="that they attack (default: %(default)g)")
    parser.add_argument("--clients", type=int, default=50, help="that misbehave, 100 at most (default: %(default)s)")
    parser.add_argument(
        "--share", type=float, default=0.05, help="of a core that they use together (default: %(default)g)"
    )
    options = parser.parse_args()
    if not (1 <= options.clients <= 100 and 1.0 <= options.seconds <= 600.0 and 0.0 < options.share <= 1.0):
        parser.error("1 to 100 clients, 1 to 600 seconds and a share up to 1 expected")
    command = [sys.executable, "-c", PROGRAM, str(options.dataset), "--no-browser"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ
    ) as program:
        try:
            assert program.stdout is not None
            asyncio.run(measured(program.stdout.readline().strip(), program.pid, options))
            assert program.poll() is None, "the viewer has ended"
        finally:
            program.terminate()
        assert program.stderr is not None
        lines = program.stderr.read().splitlines()
        print(f"the viewer said {len(lines) - 1} lines: " + "; ".join(lines[1:4]))


if __name__ == "__main__":
    main()
