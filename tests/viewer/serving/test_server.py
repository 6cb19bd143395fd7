"""The server as clients of all kinds meet it, over real sockets, with a studio that needs no OpenGL."""

import asyncio
import json
import socket
import time
from contextlib import ExitStack, asynccontextmanager, closing
from io import BytesIO
from urllib.parse import urlsplit

import aiohttp
import numpy as np
import pytest
from fake_studio import FakeStudio, stripes
from PIL import Image

from mmi.foundation.errors import DatasetError, ParameterError
from viewer.serving import server as serving
from viewer.serving.encoding import opened
from viewer.serving.server import Server, ServerOptions, ServerThread

SIZE = {"type": "size", "width": 320, "height": 200}


@pytest.fixture
def studio():
    with FakeStudio() as one:
        yield one


@pytest.fixture
def address(studio):
    with ServerThread(studio, ServerOptions()) as found:
        yield found


def run(visit):
    """What ``visit()``, a coroutine, returns; it has 20 seconds."""
    return asyncio.run(asyncio.wait_for(visit(), 20.0))


@asynccontextmanager
async def page(address, *, origin=None, query="", greet=True, headers=None):
    """A websocket as the page has one."""
    where = urlsplit(address)
    origin = f"{where.scheme}://{where.netloc}" if origin is None else origin
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(
            f"{where.scheme}://{where.netloc}/socket{query}", origin=origin, max_msg_size=0, headers=headers
        ) as one,
    ):
        if greet:
            await one.send_json(SIZE)
        yield one


async def hear(one, kind=None, *, ack=True):
    """The next reply of a kind, or the next frame (header, picture), which is acknowledged."""
    while True:
        received = await one.receive(5.0)
        if received.type is aiohttp.WSMsgType.TEXT:
            reply = json.loads(received.data)
            if kind is not None and reply["type"] == kind:
                return reply
        elif received.type is aiohttp.WSMsgType.BINARY:
            header, picture = opened(received.data)
            if ack and "saved" not in header:
                await one.send_json({"type": "ack", "frame": header["frame"]})
            if kind is None:
                return header, picture
        else:
            raise ConnectionResetError(received)


def connected(stack, where):
    return stack.enter_context(closing(socket.create_connection((where.hostname, where.port), 5.0)))


async def get(address, path="/", **more):
    async with aiohttp.ClientSession() as session, session.get(address.rstrip("/") + path, **more) as answer:
        return answer.status, answer.headers, await answer.read()


# ------------------------------------------------------------------------------------------------------------- files


def test_the_page_and_its_files_are_served_and_refer_to_nothing_else(address):
    async def visit():
        status, headers, body = await get(address)
        assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert b"://" not in body.replace(b"http://www.w3.org/2000/svg", b"")
        for path in ("/viewer.js", "/controls.js", "/map.js", "/graph.js", "/style.css", "/icon.svg"):
            status, headers, body = await get(address, path)
            assert status == 200, path
            assert headers["Content-Type"].split(";")[0] in ("text/javascript", "text/css", "image/svg+xml")
            assert b"//cdn" not in body
            assert b"https://" not in body
        status, _, body = await get(address, "/style.css", headers={"If-None-Match": headers["ETag"]})
        assert status == 200, "that was another file's tag"
        tag = (await get(address, "/style.css"))[1]["ETag"]
        assert (await get(address, "/style.css", headers={"If-None-Match": tag}))[0] == 304

    run(visit)


@pytest.mark.parametrize(
    "path",
    [
        "/index.html",
        "/server.py",
        "/../server.py",
        "/%2e%2e/server.py",
        "/..%2fserver.py",
        "/page/viewer.js",
        "//viewer.js",
        "/etc/passwd",
        "/films/../../etc/passwd",
        "/films/%2e%2e%2fx.mp4",
        "/films/",
        "/viewer.js/",
        "/viewer.js%00",
        "/__init__.py",
    ],
)
def test_nothing_else_is_served(address, path):
    where = urlsplit(address)
    with closing(socket.create_connection((where.hostname, where.port), 5.0)) as line:
        line.sendall(f"GET {path} HTTP/1.1\r\nHost: {where.netloc}\r\nConnection: close\r\n\r\n".encode())
        answer = b"".join(iter(lambda: line.recv(4096), b""))
    assert answer.startswith((b"HTTP/1.1 404 ", b"HTTP/1.1 400 ")), answer[:80]


def test_other_methods_names_and_sites_are_refused(address):
    async def visit():
        async with aiohttp.ClientSession() as session:
            for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
                async with session.request(method, address) as answer:
                    assert answer.status == 405, method
        assert (await get(address, headers={"Host": "evil.example"}))[0] == 403
        assert (await get(address, headers={"Origin": "http://evil.example"}))[0] == 403
        assert (
            await get(address, "/viewer.js", headers={"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"})
        )[0] == 403

    run(visit)


# ------------------------------------------------------------------------------------------------------------- token


def test_with_a_token_the_address_holds_it_and_a_cookie_keeps_it(studio):
    async def visit(address):
        where = urlsplit(address)
        bare = f"{where.scheme}://{where.netloc}"
        assert where.query == "token=secret-of-ours"
        for path in ("/", "/?token=", "/?token=secret-of-our", "/socket", "/films/a.mp4", "/nothing"):
            status, _, body = await get(bare, path)
            assert status == 403, path
            assert b"secret" not in body
        status, headers, _ = await get(bare, "/?token=secret-of-ours")
        assert status == 200
        cookie = headers["Set-Cookie"]
        assert all(word in cookie for word in ("HttpOnly", "SameSite=Strict", "Path=/"))
        name = f"viewer-{where.port}"
        assert (await get(bare, cookies={name: "secret-of-ours"}))[0] == 200
        assert (await get(bare, cookies={name: "secret-of-theirs"}))[0] == 403
        with pytest.raises(aiohttp.WSServerHandshakeError):
            async with page(bare):
                pass
        with pytest.raises(aiohttp.WSServerHandshakeError):
            async with page(bare, query="?token=wrong-token"):
                pass
        async with page(bare, query="?token=secret-of-ours") as one:
            assert (await hear(one, "hello"))["dataset"] == "crossroads"
        async with page(bare, headers={"Cookie": f"{name}=secret-of-ours"}) as one:
            assert (await hear(one, "hello"))["dataset"] == "crossroads"

    with ServerThread(studio, ServerOptions(token="secret-of-ours")) as address:
        run(lambda: visit(address))


def test_other_hosts_get_a_token_of_their_own():
    tokens = {ServerOptions(host=host).token for host in ("0.0.0.0", "::", "lab.example", "10.0.0.1")}
    assert len(tokens) == 4
    assert None not in tokens
    assert ServerOptions(host="localhost").token is ServerOptions(host="::1").token is ServerOptions().token is None


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"port": -1}, "port: 0 to 65535"),
        ({"port": 65536}, "port: 0 to 65535"),
        ({"host": ""}, "host: a name"),
        ({"host": "a b"}, "host: a name"),
        ({"token": "short"}, "token: 8 to 128"),
    ],
)
def test_options_without_meaning_are_refused(more, message):
    with pytest.raises(ParameterError, match=message):
        ServerOptions(**more)


def test_an_address_that_is_taken_is_said(studio, address):
    with pytest.raises(DatasetError, match=f"port {urlsplit(address).port}: an address to listen at expected"):
        ServerThread(studio, ServerOptions(port=urlsplit(address).port)).__enter__()


# ------------------------------------------------------------------------------------------------------------ frames


def test_a_client_gets_a_hello_and_frames_of_its_size(address):
    async def visit():
        async with page(address) as one:
            hello = await hear(one, "hello")
            assert hello["techniques"] == ["full", "visible", "multi-mesh"]
            header, picture = await hear(one)
            assert (header["width"], header["height"], header["format"], header["frame"]) == (320, 200, "jpeg", 1)
            assert header["ms"]["encode"] > 0.0
            found = np.asarray(Image.open(BytesIO(picture)), dtype=int)
            assert np.abs(found - stripes(header["pose"], 320, 200, 0.5)).mean() < 12.0

    run(visit)


def test_lossless_frames_are_the_pictures_of_the_studio(address):
    async def visit():
        async with page(address) as one:
            await hear(one)
            await one.send_json({"type": "look", "look": {"lossless": True}})
            header, picture = await hear(one)
            assert header["format"] == "png"
            np.testing.assert_array_equal(
                np.asarray(Image.open(BytesIO(picture))), stripes(header["pose"], 320, 200, 0.5)
            )
            await one.send_json({"type": "look", "look": {"lossless": False, "quality": 40}})
            header, _ = await hear(one)
            assert (header["format"], header["quality"]) == ("jpeg", 40)

    run(visit)


def test_two_frames_at_most_are_under_way(studio, address):
    async def visit():
        async with page(address) as one:
            header, _ = await hear(one)
            await one.send_json({"type": "input", "seq": 1, "held": {"forward": 1.0}})
            numbers = [(await hear(one, ack=False))[0]["frame"] for _ in range(2)]
            assert numbers == [2, 3]
            drawn = studio.drawn
            with pytest.raises(TimeoutError):
                await one.receive(0.4)
            assert studio.drawn == drawn, "nothing is drawn for a client that takes nothing"
            await one.send_json({"type": "ack", "frame": 2})
            assert (await hear(one, ack=False))[0]["frame"] == 4
            await one.send_json({"type": "ack", "frame": 4})
            header, _ = await hear(one)
            assert header["seq"] == 1
            assert header["pose"][0] > 0.0

    run(visit)


def test_nothing_is_drawn_while_nothing_changes(studio, address):
    async def visit():
        async with page(address) as one:
            await hear(one)
            with pytest.raises(TimeoutError):
                await one.receive(0.6)
            assert studio.drawn == 1
            await one.send_json({"type": "look", "look": {"mode": "side"}})
            await hear(one)

    run(visit)


def test_the_size_changes_at_most_ten_times_a_second_and_the_last_one_counts(studio, address):
    async def visit():
        async with page(address) as one:
            await hear(one)
            for width in range(400, 500):
                await one.send_json({"type": "size", "width": width, "height": 300})
            while (await hear(one))[0]["width"] != 499:
                pass
            told = [command for _, command in studio.told if type(command).__name__ == "Size"]
            assert len(told) < 10

    run(visit)


def test_a_large_window_is_drawn_small_until_its_page_has_drawn(address):
    async def visit():
        async with page(address, greet=False) as one:
            await one.send_json({"type": "size", "width": 3840, "height": 2160})
            header, _ = await hear(one, ack=False)
            assert (header["width"], header["height"]) == (1280, 720)
            await one.send_json({"type": "size", "width": 3800, "height": 2000})
            with pytest.raises(TimeoutError):
                await one.receive(0.4)
            await one.send_json({"type": "ack", "frame": header["frame"]})
            header, _ = await hear(one)
            assert (header["width"], header["height"]) == (3800, 2000)

    run(visit)


def test_a_frame_that_fails_is_said_and_the_next_one_comes(studio, address):
    async def visit():
        async with page(address) as one:
            await hear(one)
            studio.broken = True
            await one.send_json({"type": "look", "look": {"mode": "side"}})
            assert (await hear(one, "error"))["text"] == "a frame that could not be drawn"
            studio.broken = False
            await one.send_json({"type": "look", "look": {"mode": "swipe"}})
            await hear(one)

    run(visit)


def test_a_poor_picture_is_sent_again_when_all_stands_still(address):
    """A link that takes 150 ms more for each frame once there are several: the quality falls, and at rest it is made good."""

    async def visit():
        async with page(address) as one:
            await hear(one)
            await one.send_json({"type": "input", "seq": 1, "held": {"forward": 1.0}})
            for i in range(14):
                header, _ = await hear(one, ack=False)
                await asyncio.sleep(0.01 if i < 3 else 0.15)
                await one.send_json({"type": "ack", "frame": header["frame"]}) if "frame" in header else None
            assert header["quality"] < 80
            await one.send_json({"type": "input", "seq": 2, "held": {}})
            qualities = []
            while not qualities or qualities[-1] != 92:
                qualities.append((await hear(one))[0]["quality"])
            with pytest.raises(TimeoutError):
                await one.receive(0.6)

    run(visit)


def test_replies_say_what_they_are_for(address):
    async def visit():
        async with page(address) as one:
            await hear(one)
            await one.send_json({"type": "pick", "x": 3, "y": 4, "id": 77})
            reply = await hear(one, "picked")
            assert (reply["for"], reply["id"]) == (77, "way/42#0")
            await one.send_json({"type": "film", "id": 78})
            assert (await hear(one, "error")) == {"type": "error", "text": "Film: the fake studio cannot", "for": 78}

    run(visit)


def test_saved_pictures_are_whole_and_say_where_they_were_taken(address):
    async def visit():
        async with page(address) as one:
            shown, _ = await hear(one)
            await one.send_json({"type": "save", "id": 5})
            header, data = await hear(one)
            assert (header["saved"], header["for"], header["format"]) == (True, 5, "png")
            image = Image.open(BytesIO(data))
            np.testing.assert_array_equal(np.asarray(image), stripes(shown["pose"], 320, 200, 0.5))
            assert json.loads(image.text["pose"]) == shown["pose"]
            assert image.text["techniques"] == "full, multi-mesh"

    run(visit)


def test_films_are_served_once_they_are_made(tmp_path):
    async def visit(address):
        async with page(address) as one:
            await hear(one)
            (tmp_path / "other.mp4").write_bytes(b"not for all")
            assert (await get(address, "/films/tour.mp4"))[0] == 404
            await one.send_json({"type": "film", "id": 5})
            assert await hear(one, "progress") == {"type": "progress", "done": 3, "of": 9, "for": 5}
            assert await hear(one, "film") == {"type": "film", "url": "/films/tour.mp4", "for": 5}
            status, headers, body = await get(address, "/films/tour.mp4")
            assert (status, headers["Content-Type"], body) == (200, "video/mp4", b"a film")
            assert (await get(address, "/films/tour.mp4", headers={"Range": "bytes=2-5"}))[2] == b"film"
            assert (await get(address, "/films/other.mp4"))[0] == 404

    with FakeStudio(films=tmp_path) as studio, ServerThread(studio, ServerOptions()) as address:
        run(lambda: visit(address))


# ------------------------------------------------------------------------------------------------- clients that misbehave


@pytest.mark.parametrize(
    "nonsense",
    [
        "{",
        "[]",
        "null",
        '{"type": "fly"}',
        '{"type": "size", "width": 1e9, "height": 3}',
        '{"type": "size", "width": 0, "height": 0}',
        '{"type": "input", "seq": 1, "held": {"forward": 1e300}}',
        '{"type": "input", "seq": 1, "look": [NaN, Infinity]}',
        '{"type": "look", "look": {"__class__": 1}, "more": 1}',
        '{"type": "pose", "pose": [1, 2]}',
        '{"type": "ack", "frame": "one"}',
        "[" * 100_000,
        '{"type": "' + "x" * 100_000 + '"}',
        "\x00\x01\x02",
    ],
)
def test_nonsense_gets_an_error_and_the_connection_goes_on(address, nonsense):
    async def visit():
        async with page(address) as one:
            await hear(one)
            await one.send_str(nonsense)
            reply = await hear(one, "error")
            assert len(reply["text"]) < 500
            assert "Traceback" not in reply["text"]
            await one.send_json({"type": "look", "look": {"mode": "side"}})
            await hear(one)

    run(visit)


def test_who_says_nothing_but_nonsense_is_sent_away(address):
    async def visit():
        async with page(address) as one:
            with pytest.raises((ConnectionResetError, aiohttp.ClientError)):
                for _ in range(100):
                    await one.send_bytes(b"\xff" * 50)
                    await hear(one, "error")
            assert one.close_code == 1008

    run(visit)


def test_a_message_beyond_all_bounds_ends_the_connection(address):
    async def visit():
        async with page(address) as one:
            await hear(one)
            await one.send_str(" " * ((1 << 20) + 1))
            with pytest.raises(ConnectionResetError):
                await hear(one, "error")
            assert one.close_code == 1009

    run(visit)


def test_a_flood_is_read_slowly_and_another_client_does_not_notice(studio, address, capfd):
    async def visit():
        async with page(address) as calm, page(address) as flood:
            await hear(calm)
            await hear(flood)

            async def pour():
                for i in range(4000):
                    await flood.send_json({"type": "input", "seq": i, "held": {"turn": 0.0}})

            pouring = asyncio.create_task(pour())
            await calm.send_json({"type": "input", "seq": 1, "held": {"forward": 1.0}})
            start, frames = time.perf_counter(), 0
            while time.perf_counter() < start + 1.0:
                await hear(calm)
                frames += 1
            assert frames > 30
            told = [command for client, command in studio.told if client == "client 2"]
            assert len(told) < 2000
            pouring.cancel()
            flood._response.connection.transport.abort()

    run(visit)
    assert capfd.readouterr().err == ""


def test_tabs_that_close_in_the_middle_of_a_frame_do_no_harm(studio, address, capfd):
    async def visit():
        for _ in range(6):
            async with page(address) as one:
                await hear(one, "hello")
                await one.send_json({"type": "input", "seq": 1, "held": {"forward": 1.0}})
                await hear(one, ack=False)
                one._response.connection.transport.abort()
        async with page(address) as one:
            await hear(one)

    run(visit)
    assert not studio.clients or len(studio.left) >= 6
    assert capfd.readouterr().err == ""


def test_more_than_four_clients_wait_and_come_in(studio, address):
    async def visit():
        async with page(address) as a, page(address) as b, page(address) as c, page(address) as d:
            for one in (a, b, c, d):
                await hear(one)
            async with page(address) as e:
                assert (await hear(e, "waiting"))["before"] == 0
                assert len(studio.clients) == 4
                await e.send_json({"type": "look", "look": {"mode": "side"}})
                await b.close()
                await hear(e, "hello")
                await hear(e)

    run(visit)


def test_who_stalls_gives_its_place_to_who_waits(studio, monkeypatch):
    from viewer.serving import client

    monkeypatch.setattr(client, "_STALLED", 0.3)

    async def visit(address):
        async with page(address) as stalled, page(address) as waiting:
            await hear(stalled)
            await stalled.send_json({"type": "input", "seq": 1, "held": {"forward": 1.0}})
            numbers = [(await hear(stalled, ack=False))[0]["frame"] for _ in range(2)]
            assert (await hear(waiting, "waiting"))["before"] == 0
            await hear(waiting, "hello")
            await hear(waiting)
            assert (await hear(stalled, "waiting"))["before"] is None
            await stalled.send_json({"type": "ack", "frame": numbers[-1]})
            await stalled.send_json({"type": "look", "look": {}})
            assert (await hear(stalled, "waiting"))["before"] == 0
            await waiting.close()
            await hear(stalled, "hello")

    with ServerThread(studio, ServerOptions(places=1)) as address:
        run(lambda: visit(address))


def test_who_never_says_its_size_is_let_go(studio, monkeypatch):
    from viewer.serving import client

    monkeypatch.setattr(client, "_PATIENCE", 0.2)

    async def visit(address):
        async with page(address, greet=False) as one:
            assert (await one.receive(2.0)).type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED)
        assert not studio.clients

    with ServerThread(studio, ServerOptions()) as address:
        run(lambda: visit(address))


def test_websockets_of_other_sites_are_refused(address):
    async def visit():
        for origin in ("http://evil.example", "null", "http://localhost:1"):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with page(address, origin=origin):
                    pass
            assert refused.value.status == 403
        status, _, _ = await get(address, "/socket", headers={"Origin": address.rstrip("/")})
        assert status == 400, "no handshake"

    run(visit)


@pytest.mark.parametrize(
    "data",
    [
        b"\x00\xff" * 200,
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
        b"GET /" + b"a" * 20000 + b" HTTP/1.1\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999999\r\n\r\nabc",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nZZZ\r\n",
    ],
)
def test_what_is_no_http_gets_an_error_or_nothing(address, data, capfd):
    where = urlsplit(address)
    with closing(socket.create_connection((where.hostname, where.port), 5.0)) as line:
        line.sendall(data)
        line.shutdown(socket.SHUT_WR)
        answer = line.recv(4096)
    assert answer == b"" or answer.split()[1] in (b"400", b"403", b"405")
    assert b"Traceback" not in answer
    assert run(lambda: get(address))[0] == 200
    assert capfd.readouterr().err == ""


def test_sockets_on_which_nothing_is_asked_are_closed(studio, monkeypatch):
    monkeypatch.setattr(serving, "_SILENCE", 0.3)
    with ServerThread(studio, ServerOptions()) as address:
        where = urlsplit(address)
        with ExitStack() as stack:
            lines = [connected(stack, where) for _ in range(20)]
            lines[3].sendall(b"GET / HT")
            assert all(line.recv(1) == b"" for line in lines)


def test_connections_beyond_a_bound_are_closed_at_once(studio, monkeypatch):
    monkeypatch.setattr(serving, "_MOST_CONNECTIONS", 5)
    with ServerThread(studio, ServerOptions()) as address:
        where = urlsplit(address)
        with ExitStack() as stack:
            lines = [connected(stack, where) for _ in range(8)]
            assert [line.recv(1) for line in lines[5:]] == [b""] * 3
            lines[0].close()
            time.sleep(0.05)
            assert run(lambda: get(address))[0] == 200


# --------------------------------------------------------------------------------------------------------------- end


def test_the_server_ends_at_once_with_clients_connected(studio):
    async def visit():
        async with Server(studio, ServerOptions()) as server:
            server.open()
            sockets = []
            async with aiohttp.ClientSession() as session:
                for _ in range(6):
                    where = urlsplit(server.address)
                    one = await session.ws_connect(server.address + "socket", origin=f"http://{where.netloc}")
                    await one.send_json(SIZE)
                    sockets.append(one)
                await hear(sockets[0])
                start = time.perf_counter()
                await server.__aexit__(None, None, None)
                assert time.perf_counter() - start < 2.0
                for one in sockets:
                    await one.close()
                return

    run(visit)
    assert not studio.clients
