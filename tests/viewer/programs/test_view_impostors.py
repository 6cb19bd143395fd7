"""``view-impostors`` as a user meets it: its first line of output, Ctrl-C, and one line for each mistake."""

import asyncio
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from contextlib import AsyncExitStack, contextmanager

import aiohttp
import pytest

from viewer.programs import view_impostors as program
from viewer.programs.view_impostors import view_impostors
from viewer.serving import server

START = "from viewer.programs.view_impostors import view_impostors; view_impostors()"


@contextmanager
def started(*arguments):
    """(process, the first line of its output): the program as it is started in a shell."""
    command = [sys.executable, "-c", START, *map(str, arguments), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        watchdog = threading.Timer(60.0, process.kill)
        watchdog.start()
        try:
            yield process, process.stdout.readline().rstrip("\n")
        finally:
            watchdog.cancel()
            process.kill()


def get(address):
    with urllib.request.urlopen(address, timeout=10.0) as answer:
        return answer.read().decode()


def test_the_first_line_is_the_address_and_ctrl_c_ends_it(dataset):
    with started(dataset.path) as (process, line):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", line)
        assert "<title>view-impostors</title>" in get(line)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=10.0)
    assert process.returncode == 130
    assert out == ""
    assert err.splitlines() == ["Ctrl-C ends the viewer.", "view-impostors: interrupted; the viewer was ended"]


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_to_be_told_to_end_takes_the_films_along(dataset, tmp_path, monkeypatch, name):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with started(dataset.path) as (process, line):
        asyncio.run(_begin_a_film(line))
        assert list(tmp_path.glob("view-impostors-*"))
        process.send_signal(getattr(signal, name))
        _, err = process.communicate(timeout=20.0)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "view-impostors: interrupted; the viewer was ended"
    assert not list(tmp_path.glob("view-impostors-*"))


async def _begin_a_film(address):
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(asyncio.timeout(50.0))
        session = await stack.enter_async_context(aiohttp.ClientSession())
        one = await stack.enter_async_context(session.ws_connect(f"{address}socket", origin=address.rstrip("/")))
        await one.send_json({"type": "size", "width": 64, "height": 64})
        async for heard in one:
            kind = heard.json()["type"] if heard.type is aiohttp.WSMsgType.TEXT else "frame"
            if kind == "hello":
                await one.send_json({"type": "film", "id": 1})
            if kind == "progress":
                return


def test_another_host_has_a_token_in_its_address(dataset):
    with started(dataset.path, "--host", "127.0.0.1", "--token", "of-the-tests-own") as (_, line):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=of-the-tests-own", line)
        get(line)
        with pytest.raises(urllib.error.HTTPError, match="403"):
            get(line.partition("?")[0])


def run(capsys, *arguments):
    """(exit status, output, errors)."""
    with pytest.raises(SystemExit) as left:
        view_impostors([str(one) for one in arguments])
    captured = capsys.readouterr()
    return left.value.code, captured.out, captured.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "the following arguments are required: OUT"),
        (("{nowhere}",), "nowhere: the folder of a dataset"),
        (("{dataset}", "--port", "70000"), "--port: 0 to 65535 expected, found 70000"),
        (("{dataset}", "--port", "http"), "argument --port: invalid int value: 'http'"),
        (("{dataset}", "--port", "{taken}"), "an address to listen at expected, found: "),
        (("{dataset}", "--host", "nowhere.invalid"), "nowhere.invalid, port 0: an address to listen at expected"),
        (("{dataset}", "--host", "a b"), "--host: a name or an address of this machine expected"),
        (("{dataset}", "--host", "a..b"), "--host: a name or an address of this machine expected, found 'a..b'"),
        (("{dataset}", "--host", 400 * "x"), "--host: a name or an address of this machine expected, found 'xxx"),
        (("{dataset}", "--token", "short"), "--token: 8 to 128 letters"),
        (("{dataset}", "--cache", "nan"), "--cache: 1 to 1000000 MB expected, found nan"),
        (("{dataset}", "--techniques", "full,nothing-like-it"), "nothing-like-it"),
        (("{dataset}", "--techniques", "full,,visible"), "names with commas between expected"),
        (("{dataset}", "--techniques", "full,single-mesh"), "single-mesh needs a dataset of its own"),
    ],
)
def test_mistakes_get_one_line(capsys, dataset, tmp_path, arguments, message):
    with socket.create_server(("127.0.0.1", 0)) as busy:
        values = {"dataset": dataset.path, "nowhere": tmp_path / "nowhere", "taken": busy.getsockname()[1]}
        status, out, err = run(capsys, *(one.format(**values) for one in arguments))
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("view-impostors: error: ")
    assert message in err


def test_missing_packages_are_named(dataset):
    without = f"import sys; sys.modules['aiohttp'] = None; {START}"
    found = subprocess.run([sys.executable, "-c", without, dataset.path], capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr == (
        "view-impostors: error: aiohttp: a package of the viewer expected; "
        'pip install "multi-mesh-impostors[viewer]" brings it\n'
    )


def test_techniques_are_offered_and_the_first_and_last_are_compared(dataset, monkeypatch):
    offered = []
    monkeypatch.setattr(server, "serve", lambda studio, *_, **__: offered.append(studio.options))
    with pytest.raises(SystemExit):
        view_impostors([str(dataset.path), "--techniques", "visible,full,local", "--cache", "20"])
    (options,) = offered
    assert options.techniques == ("visible", "full", "local")
    assert (options.look.left, options.look.right, options.cache) == ("visible", "local", 20_000_000)


def test_help_has_examples_that_are_read_as_they_stand(capsys):
    _, out, _ = run(capsys, "--help")
    examples = [
        line.strip().split("   ")[0] for line in out.splitlines() if line.strip().startswith("view-impostors out")
    ]
    assert len(examples) >= 4
    parsed = []
    for example in examples:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(program, "_view", parsed.append)
            with pytest.raises(SystemExit) as left:
                view_impostors(shlex.split(example)[1:])
            assert left.value.code == 0, example
    assert len(parsed) == len(examples)


def test_a_window_of_its_own_ends_the_program_when_it_is_closed(capsys, dataset, tmp_path, monkeypatch):
    """The only browser here is a script that asks for its address, as a browser does, and ends."""
    browser = tmp_path / "chromium"
    fetch = "import sys, urllib.request as u; print(u.urlopen(sys.argv[1].partition('=')[2], timeout=9).status)"
    browser.write_text(f'#!/bin/sh\n{sys.executable} -c "{fetch}" "$1" > {tmp_path}/status\n')
    browser.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("DISPLAY", ":77")
    status, out, err = run(capsys, dataset.path, "--window")
    assert (status, err) == (0, "")
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\n", out)
    assert (tmp_path / "status").read_text() == "200\n"

    browser.write_text("#!/bin/sh\necho no display >&2\nexit 1\n")
    status, _, err = run(capsys, dataset.path, "--window")
    assert (status, err) == (2, f"view-impostors: error: --window: {browser}: a window expected, found: no display\n")
    browser.unlink()
    status, out, err = run(capsys, dataset.path, "--window")
    assert (status, out) == (2, "")
    assert "--window: Chromium, Google Chrome, Microsoft Edge or Brave expected, found none; install one" in err
    assert "not allowed with argument" in run(capsys, dataset.path, "--window", "--no-browser")[2]
