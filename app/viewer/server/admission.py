"""Who may come in: the viewer's own pages, and whoever has the token of its link.

A browser that has the viewer open also runs the pages of others, and these may send requests to
any address, ``localhost`` included. What tells them apart is what a page cannot forge: the
``Origin`` that the browser states, and the ``Host`` that it believes to be talking to. Both are
compared whole with what is expected. A beginning is not enough: ``localhost.evil.com`` begins well.
"""

import ipaddress
import re
import secrets
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from typing import TypeAlias
from urllib.parse import parse_qsl, urlsplit

from gpgrad_core.errors import InputError

HeaderValues: TypeAlias = Callable[[str], Sequence[str]]
"""Gives all values of a header: each may come several times."""

DEFAULT_PORTS: Mapping[str, int] = {"http": 80, "https": 443}
HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::([0-9]{1,5}))?", re.ASCII)
ORIGIN = re.compile(rf"(https?)://(?:{HOST.pattern})", re.ASCII)
TOKEN = re.compile(r"[A-Za-z0-9._~-]{8,200}", re.ASCII)
ELSEWHERE = frozenset({"websocket", "playbackPath"})
"""With these words in its address the page takes its contents, and so its programs, from another
server, although the browser believes it to be ours."""


@dataclass(frozen=True)
class Admission:
    """Who may come in: what the person who starts the viewer says, and what `at` adds to it."""

    # pages of these origins may talk to the viewer too, and their hosts may lead to it; as
    # `as_origin` gives them
    origins: tuple[str, ...] = ()
    # what everybody must have; `at` makes one where the viewer can be reached from other machines.
    # None asks nobody
    token: str | None = field(default=None, repr=False)
    without_token: bool = False  # ask nobody for a token
    # what the viewer's own host may be called, besides the address that was reached
    names: frozenset[str] = frozenset({"localhost", "127.0.0.1", "[::1]"})

    def at(self, host: str) -> "Admission":
        """Apply it to an address to serve on."""
        token, names = self.token, set(self.names)
        if not _is_everywhere(host):
            names.add(_spelled(host))
        if not is_loopback(host):
            names.add(socket.gethostname().lower())
            if token is None and not self.without_token:
                token = secrets.token_urlsafe(24)
        return replace(self, token=token, names=frozenset(names))

    def refusal(
        self, given: HeaderValues, path: str, address: tuple[str, int], *, socket_wanted: bool
    ) -> tuple[HTTPStatus, str] | None:
        """Why a request for a path, with its question mark, is refused; None lets it in.

        The address is the one of ours that was reached. Browsers state the origin of all
        websockets, so one without is refused; the address of a page is often typed.
        """
        host = self._host(given, address)
        if host is None:
            return (
                HTTPStatus.MISDIRECTED_REQUEST,
                "The viewer does not know itself by this name. Open the address that gpgrad view "
                "printed, or start it with --allow-origin http://NAME:PORT.\n",
            )
        origins, site = given("Origin"), given("Sec-Fetch-Site")
        own = f"http://{host}" if host not in self._hosts else None
        is_ours = len(origins) == 1 and (origins[0] == own or origins[0] in self.origins)
        is_part = list(given("Sec-Fetch-Mode")) != ["navigate"]  # of a page; a link may be followed
        query = parse_qsl(path.partition("?")[2], keep_blank_values=True)
        text = None
        if (origins or socket_wanted) and not is_ours:
            text = (
                "Pages of another origin may not talk to the viewer. To allow one, start gpgrad "
                "view with --allow-origin ORIGIN.\n"
            )
        elif not is_ours and is_part and not {*site} <= {"same-origin", "none"}:
            text = "Other pages may not load parts of the viewer.\n"
        elif any(key in ELSEWHERE for key, _ in query):
            text = "The viewer shows nothing that another server sends.\n"
        elif self.token is not None and not self._has_token(query, given, address[1]):
            text = (
                "The viewer asks for a token. Open the whole address that gpgrad view printed, "
                "with ?token=... at its end.\n"
            )
        return None if text is None else (HTTPStatus.FORBIDDEN, text)

    def answer_headers(self, given: HeaderValues, port: int) -> dict[str, str]:
        """The headers of an answer to a request that was let in, and so had the token.

        The page gets it as a cookie, which its websocket sends. It may talk to its own server only,
        and only pages of `origins` may frame it.
        """
        host = "".join(given("Host")[:1])
        framed_by = " ".join(["'self'", *sorted(self.origins)])
        headers = {
            "Content-Security-Policy": f"default-src 'self' ws://{host} wss://{host} blob: data: "
            "'unsafe-inline' 'unsafe-eval'; base-uri 'none'; form-action 'none'; "
            f"object-src 'none'; frame-ancestors {framed_by}",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-store",
        }
        if self.token is not None:
            cookie = f"{cookie_name(port)}={self.token}; Path=/; HttpOnly; SameSite=Lax"
            headers["Set-Cookie"] = cookie
        return headers

    @property
    def _hosts(self) -> frozenset[str]:
        return frozenset(origin.partition("://")[2] for origin in self.origins)

    def _host(self, given: HeaderValues, address: tuple[str, int]) -> str | None:
        asked = given("Host")
        if len(asked) != 1:
            return None
        host = asked[0].lower()
        if host in self._hosts:
            return host
        parts = HOST.fullmatch(host)
        if parts is None or int(parts[2] or DEFAULT_PORTS["http"]) != address[1]:
            return None
        return host if parts[1] in self.names | {_spelled(address[0])} else None

    def _has_token(self, query: list[tuple[str, str]], given: HeaderValues, port: int) -> bool:
        shown = [value for key, value in query if key == "token"]
        for line in given("Cookie"):
            for cookie in line.split(";"):
                name, _, value = cookie.strip().partition("=")
                shown += [value] if name == cookie_name(port) else []
        return any([self._is_token(value) for value in shown])  # noqa: C419 - all, for equal time

    def _is_token(self, value: str) -> bool:
        assert self.token is not None
        shown = value.encode(errors="backslashreplace")
        return secrets.compare_digest(shown, self.token.encode())


def cookie_name(port: int) -> str:
    """Name the cookie that holds the token: browsers share cookies between ports.

    >>> cookie_name(8080)
    'gpgrad-token-8080'
    """
    return f"gpgrad-token-{port}"


def as_origin(text: str) -> str:
    """Write an origin as browsers do; ``*`` and ``null`` stand for anybody, and are refused.

    >>> as_origin("HTTPS://Viewer.Lab.org:443/")
    'https://viewer.lab.org'
    """
    parts = ORIGIN.fullmatch(text.lower().removesuffix("/"))
    if parts is None or (parts[3] is not None and not 0 < int(parts[3]) < 65536):
        raise InputError(
            f"--allow-origin {text}: must be http://HOST, https://HOST, or the same with :PORT"
        )
    port = urlsplit(parts[0]).port
    shown = "" if port in (None, DEFAULT_PORTS[parts[1]]) else f":{port}"
    return f"{parts[1]}://{parts[2]}{shown}"


def check_token(text: str) -> str:
    """Refuse a token that is too easy to guess, or that no link can hold; returns it."""
    if not TOKEN.fullmatch(text):
        raise InputError("--token must have 8 to 200 letters, digits and . _ ~ -")
    return text


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine only."""
    try:
        addresses = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)
    except OSError:
        return False
    return all(ipaddress.ip_address(str(address[4][0])).is_loopback for address in addresses)


def _is_everywhere(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:  # a name
        return not host


def _spelled(host: str) -> str:
    """Write a name or an IP address as in a URL; an IPv4 address within IPv6 as IPv4."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host.lower()
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    return str(address.ipv4_mapped or f"[{address}]")
