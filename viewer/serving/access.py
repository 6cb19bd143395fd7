"""Whom the server answers, decided from a request's headers alone: nobody, unless everything fits.

A page of any other site may send requests to a server on this machine, and with a name of its own that leads here it may even
read the answers (DNS rebinding). So a request must name a host that this server is known by, and where a browser says which
page it comes from, that must be the server's own. A server that others than this machine can reach wants a token as well.
Pure functions of text; nothing here opens a socket.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

from mmi.foundation.errors import ParameterError

__all__ = ["Door", "content_policy", "is_loopback", "new_token", "refusal", "token_fits"]

_HOST = re.compile(r"(?P<name>\[[0-9a-fA-F:.]{2,45}\]|[A-Za-z0-9._-]{1,253})(?::(?P<port>[0-9]{1,5}))?", re.ASCII)
_TOKEN = re.compile(r"[A-Za-z0-9_.~-]{8,128}", re.ASCII)
_FRAMING = re.compile(r"https?://[A-Za-z0-9.\[\]:*_-]{1,253}|vscode-webview:", re.ASCII)


@dataclass(frozen=True, slots=True)
class Door:
    """Who may come in.

    ``names`` are the names that the server is known by, besides addresses; ``loopback`` says that it is bound to this machine
    only, so that no other address can be meant. ``token`` is what a client has to show, None where none is asked for.
    ``framed_by`` are the origins whose pages may show this one in a frame (a notebook's). Raises ParameterError for a
    token that a URL cannot hold as it is or that is easy to guess, and where others can reach the server without one.
    """

    names: frozenset[str] = frozenset({"localhost"})
    loopback: bool = True
    token: str | None = None
    framed_by: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.token is not None and not _TOKEN.fullmatch(self.token):
            raise ParameterError("token: 8 to 128 letters, digits and - _ . ~ expected")
        if self.token is None and not self.loopback:
            raise ParameterError("token: one expected, since other machines can reach this server")
        for origin in self.framed_by:
            if not _FRAMING.fullmatch(origin):
                raise ParameterError(f"framed_by: origins such as http://localhost:8888 expected, found {origin!r}")


def new_token() -> str:
    """A token that nobody guesses: 192 random bits."""
    return secrets.token_urlsafe(24)


def is_loopback(host: str) -> bool:
    """Whether a server that is bound to ``host`` can be reached from this machine only."""
    if host.lower() == "localhost":
        return True
    address = _address(host)
    return address is not None and address.is_loopback


def refusal(
    door: Door,
    *,
    hosts: Sequence[str],
    origins: Sequence[str],
    site: str | None = None,
    mode: str | None = None,
    socket: bool = False,
) -> str | None:
    """Why a request is refused, in words for who sent it; None where it is not.

    ``hosts`` and ``origins`` are the values of the request's Host and Origin headers, ``site`` and ``mode`` those of
    Sec-Fetch-Site and Sec-Fetch-Mode. A handshake of a websocket (``socket``) has to have an Origin: browsers send one always.
    """
    if len(hosts) != 1:
        return "one Host header expected"
    host = hosts[0]
    found = _HOST.fullmatch(host)
    if found is None or not _known(door, found["name"]):
        return "this server is not known by that name"
    if len(origins) > 1:
        return "one Origin header expected"
    if socket and not origins:
        return "an Origin header expected"
    if origins and origins[0].lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
        return "pages of other sites are not answered"
    if site not in (None, "none", "same-origin") and mode != "navigate":
        return "pages of other sites are not answered"
    return None


def token_fits(door: Door, offered: Sequence[str | None]) -> bool:
    """Whether any of what a client offers (in the address, in a cookie) is the token; takes as long whatever is offered."""
    if door.token is None:
        return True
    wanted = door.token.encode()
    fits = [hmac.compare_digest(wanted, one.encode(errors="replace")) for one in offered if one is not None]
    return any(fits)


def content_policy(door: Door, host: str) -> str:
    """The Content-Security-Policy of the page, whose address has this (known) ``host``: nothing but the viewer's own files."""
    return "; ".join(
        (
            "default-src 'none'",
            "script-src 'self'",
            "style-src 'self'",
            "img-src 'self' blob:",
            "media-src 'self'",
            f"connect-src 'self' ws://{host} wss://{host}",
            "base-uri 'none'",
            "form-action 'none'",
            f"frame-ancestors {' '.join(door.framed_by) or chr(39) + 'none' + chr(39)}",
        )
    )


def _known(door: Door, name: str) -> bool:
    address = _address(name)
    if address is not None:
        return address.is_loopback or not door.loopback
    return name.lower().rstrip(".") in door.names


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return None
