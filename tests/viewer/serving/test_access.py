"""Who is let in: every header that a browser, another site or a stranger's program may send."""

import pytest

from mmi.foundation.errors import ParameterError
from viewer.serving.access import Door, content_policy, is_loopback, new_token, refusal, token_fits

HERE = Door()
EVERYWHERE = Door(frozenset({"localhost", "lab.example"}), loopback=False, token="a-token-of-ours")


def let_in(door, host, origin=None, **more):
    hosts = host if isinstance(host, list) else [host]
    return refusal(door, hosts=hosts, origins=[] if origin is None else [origin], **more) is None


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8080", "localhost:9", "LOCALHOST:9", "[::1]:80", "127.0.0.1", "127.3.2.1:1"]
)
def test_names_of_this_machine_are_known(host):
    assert let_in(HERE, host)
    assert let_in(HERE, host, f"http://{host}", socket=True)
    assert let_in(HERE, host, f"https://{host}", socket=True), "behind something that speaks TLS"


@pytest.mark.parametrize(
    "host",
    [
        "evil.example:8080",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "192.168.1.5:8080",
        "0.0.0.0:80",
        "",
        "localhost:80:80",
        "localhost/",
        "user@localhost",
        "local host",
        "localhost:99999999",
        "[::1",
        "::1",
        "localhost\n",
        "ⓛocalhost",
        [],
        ["localhost", "localhost"],
    ],
)
def test_other_names_are_not(host):
    assert not let_in(HERE, host)


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "http://127.0.0.1:9090",
        "http://localhost:8080",
        "http://127.0.0.1:8080.evil.example",
        "127.0.0.1:8080",
        "ws://127.0.0.1:8080",
        "",
        "http://127.0.0.1:8080/",
    ],
)
def test_pages_of_other_origins_are_refused(origin):
    assert not let_in(HERE, "127.0.0.1:8080", origin)
    assert not let_in(HERE, "127.0.0.1:8080", origin, socket=True)


def test_a_handshake_must_say_where_it_comes_from():
    assert let_in(HERE, "localhost:80")
    assert not let_in(HERE, "localhost:80", socket=True)
    assert refusal(HERE, hosts=["localhost"], origins=["http://localhost", "http://localhost"]) is not None


def test_requests_of_other_sites_pages_are_refused_and_links_are_not():
    assert not let_in(HERE, "localhost:80", site="cross-site", mode="no-cors")
    assert not let_in(HERE, "localhost:80", site="same-site", mode="cors")
    assert let_in(HERE, "localhost:80", site="cross-site", mode="navigate")
    assert let_in(HERE, "localhost:80", site="none", mode="navigate")
    assert let_in(HERE, "localhost:80", site="same-origin", mode="no-cors")


def test_a_server_for_others_is_known_by_its_names_and_by_addresses():
    for host in ("lab.example:80", "Lab.Example.", "10.0.0.7:8080", "[fe80::1]:80", "localhost"):
        assert let_in(EVERYWHERE, host), host
    for host in ("other.example", "lab.example.evil.example"):
        assert not let_in(EVERYWHERE, host), host


def test_loopback():
    assert all(map(is_loopback, ("127.0.0.1", "127.9.9.9", "::1", "localhost", "LocalHost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "10.0.0.1", "lab.example", "localhost.example", "")))


def test_the_token_is_asked_for():
    assert token_fits(EVERYWHERE, (None, "a-token-of-ours"))
    assert token_fits(EVERYWHERE, ("a-token-of-ours", "another"))
    for offered in (
        (),
        (None, None),
        ("", None),
        ("a-token-of-our",),
        ("a-token-of-ours ",),
        ("A-TOKEN-OF-OURS",),
        ("\ud800",),
    ):
        assert not token_fits(EVERYWHERE, offered), offered
    assert token_fits(HERE, ())


@pytest.mark.parametrize(
    "token", ["", "short", "with space in", "a" * 129, "semi;colon;", "ünïcodé-token", "new\nline-token"]
)
def test_tokens_that_an_address_cannot_hold_are_refused(token):
    with pytest.raises(ParameterError, match="token: 8 to 128"):
        Door(token=token)


def test_others_reach_no_server_without_a_token():
    with pytest.raises(ParameterError, match="token: one expected"):
        Door(loopback=False)


def test_new_tokens_are_long_and_differ():
    tokens = {new_token() for _ in range(50)}
    assert len(tokens) == 50
    assert all(len(token) >= 32 and Door(token=token) for token in tokens)


def test_the_policy_lets_nothing_in_from_elsewhere():
    policy = content_policy(HERE, "localhost:80")
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert "*" not in policy
    framed = content_policy(Door(framed_by=("http://localhost:8888",)), "localhost:80")
    assert framed.endswith("frame-ancestors http://localhost:8888")
    with pytest.raises(ParameterError, match="framed_by"):
        Door(framed_by=("http://a; script-src *",))
