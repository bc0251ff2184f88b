"""Who may come in: each case is one by which another program was entered, or could be."""

import re
import socket
from http import HTTPStatus

import pytest
from websockets.datastructures import Headers

from app.viewer.server.admission import Admission, as_origin, check_token, is_loopback
from gpgrad_core.errors import InputError

OURS = ("127.0.0.1", 8080)
LOCAL = Admission().at("127.0.0.1")


def ask(
    gate: Admission = LOCAL,
    host: str | None = "localhost:8080",
    origin: str | None = None,
    path: str = "/",
    *,
    page: bool = True,
    address: tuple[str, int] = OURS,
    **others: str,
) -> HTTPStatus | None:
    """Give the status of a refusal; None is let in."""
    given = {"Host": host, "Origin": origin, **{k.replace("_", "-"): v for k, v in others.items()}}
    headers = Headers({name: value for name, value in given.items() if value is not None})
    refusal = gate.refusal(headers.get_all, path, address, socket_wanted=not page)
    return None if refusal is None else refusal[0]


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1:8080", "[::1]:8080"])
def test_the_own_page_comes_in(host: str) -> None:
    assert ask(host=host) is None
    assert ask(host=host, origin=f"http://{host}", page=False) is None
    assert ask(host="localhost", address=("127.0.0.1", 80)) is None  # whose port need not be said


@pytest.mark.parametrize(
    "origin",
    [
        "null",  # a sandboxed frame or a file
        "http://evil.com",
        "http://localhost.evil.com:8080",  # compared by its beginning: Bokeh, Jupyter
        "http://localhost:8080.evil.com",
        "http://localhost:8080@evil.com",
        "http://evil.com/localhost:8080",
        "http://localhost:80800",
        "http://localhost:8081",  # another program on this machine
        "http://localhost",
        "https://localhost:8080",
        "http://127.0.0.1:8080",  # not what this page is called: localhost may be [::1], another's
        "HTTP://LOCALHOST:8080 ",
        "",
        "*",
    ],
)
@pytest.mark.parametrize("page", [True, False])
def test_a_foreign_origin_is_refused_on_every_socket(origin: str, page: bool) -> None:
    assert ask(origin=origin, page=page) == HTTPStatus.FORBIDDEN


def test_no_origin_two_origins_and_two_hosts_are_refused() -> None:
    assert ask(page=False) == HTTPStatus.FORBIDDEN
    headers = Headers([("Host", "localhost:8080")])
    headers["Origin"] = "http://localhost:8080"
    headers["Origin"] = "http://evil.com"
    assert LOCAL.refusal(headers.get_all, "/", OURS, socket_wanted=True) is not None
    headers = Headers([("Host", "localhost:8080"), ("Host", "evil.com")])
    assert LOCAL.refusal(headers.get_all, "/", OURS, socket_wanted=False) is not None


@pytest.mark.parametrize(
    "host",
    [
        None,
        "",
        "evil.com:8080",  # a name that was made to lead here: DNS rebinding
        "evil.com",
        "localhost",
        "localhost:80",
        "localhost:8081",
        "localhost.:8080",
        "localhost.evil.com:8080",
        "127.0.0.1.evil.com:8080",
        "127.0.0.2:8080",
        "127.1:8080",
        "2130706433:8080",
        "0.0.0.0:8080",
        "[::]:8080",
        "localhost:8080:8080",
        "user@localhost:8080",
        "localhost:8080/",
    ],
)
@pytest.mark.parametrize("page", [True, False])
def test_another_host_is_refused(host: str | None, page: bool) -> None:
    origin = None if page else f"http://{host}"
    assert ask(host=host, origin=origin, page=page) == HTTPStatus.MISDIRECTED_REQUEST


def test_an_allowed_origin_comes_in_and_its_host_leads_here() -> None:
    gate = Admission(origins=("https://viewer.lab.org", "http://localhost:9000")).at("127.0.0.1")
    assert ask(gate, "viewer.lab.org", "https://viewer.lab.org", page=False) is None
    assert ask(gate, "localhost:9000", "http://localhost:9000", page=False) is None
    assert ask(gate, "localhost:8080", "https://viewer.lab.org", page=False) is None
    for origin in ("https://viewer.lab.org.evil.com", "http://viewer.lab.org", "https://lab.org"):
        assert ask(gate, "viewer.lab.org", origin, page=False) == HTTPStatus.FORBIDDEN
    assert ask(gate, "viewer.lab.org:8080") == HTTPStatus.MISDIRECTED_REQUEST


def test_what_is_no_origin_cannot_be_allowed() -> None:
    assert as_origin("http://LocalHost:80/") == "http://localhost"
    for text in ("*", "null", "lab.org", "ftp://lab.org", "http://", "http://a/b", "http://a:0"):
        with pytest.raises(InputError, match="--allow-origin"):
            as_origin(text)


def test_parts_of_the_viewer_are_not_given_to_other_pages() -> None:
    assert ask(Sec_Fetch_Site="none", Sec_Fetch_Mode="navigate") is None
    assert ask(Sec_Fetch_Site="same-origin", Sec_Fetch_Mode="no-cors") is None
    assert ask(Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate") is None  # a link
    for site in ("cross-site", "same-site"):  # another port of this machine is the same site
        assert ask(Sec_Fetch_Site=site, Sec_Fetch_Mode="no-cors") == HTTPStatus.FORBIDDEN


@pytest.mark.parametrize(
    "query", ["websocket=ws://evil.com", "a=1&%77ebsocket=", "playbackPath=http://evil.com/x"]
)
def test_the_page_takes_its_contents_from_nobody_else(query: str) -> None:
    assert ask(path=f"/?{query}") == HTTPStatus.FORBIDDEN
    assert ask(path="/?fixedDpr=1&darkMode") is None


def test_on_a_network_a_token_is_made_and_asked_for() -> None:
    gate, other = (Admission().at("0.0.0.0") for _ in range(2))
    assert gate.token is not None
    assert gate.token != other.token
    assert len(gate.token) >= 32
    assert gate.token not in repr(gate)
    lan = {"host": "192.168.1.5:8080", "address": ("192.168.1.5", 8080)}
    assert ask(gate, **lan) == HTTPStatus.FORBIDDEN
    assert ask(gate, **lan, path=f"/?token={gate.token}") is None
    assert ask(gate, **lan, path="/?token=ü\udcff") == HTTPStatus.FORBIDDEN
    for wrong in ("", gate.token[:-1], f"{gate.token}x", other.token):
        assert ask(gate, **lan, path=f"/?token={wrong}") == HTTPStatus.FORBIDDEN
        assert ask(gate, **lan, Cookie=f"gpgrad-token-8080={wrong}") == HTTPStatus.FORBIDDEN
    socket_of_page = {**lan, "origin": "http://192.168.1.5:8080", "page": False}
    assert ask(gate, **socket_of_page) == HTTPStatus.FORBIDDEN
    cookies = f'a="{{b;}}"; gpgrad-token-8080={gate.token}; c=d'
    assert ask(gate, **socket_of_page, Cookie=cookies) is None
    assert ask(gate, **socket_of_page, Cookie=f"gpgrad-token-8081={gate.token}") is not None
    # A token does not replace the other checks.
    assert ask(gate, **{**lan, "host": "evil.com:8080"}, path=f"/?token={gate.token}") is not None
    assert ask(gate, **{**socket_of_page, "origin": "http://evil.com"}, Cookie=cookies) is not None


def test_the_page_gets_the_token_in_a_cookie_and_talks_to_nobody_else() -> None:
    host = Headers({"Host": "localhost:8080"}).get_all
    given = Admission(token="a-token-to-share").at("127.0.0.1").answer_headers(host, 8080)
    assert given["Set-Cookie"] == (
        "gpgrad-token-8080=a-token-to-share; Path=/; HttpOnly; SameSite=Lax"
    )
    assert given["Referrer-Policy"] == "no-referrer"  # the link stays here
    assert "Set-Cookie" not in LOCAL.answer_headers(host, 8080)
    policy = given["Content-Security-Policy"]
    rules = dict(rule.split(" ", 1) for rule in re.split("; ?", policy))
    assert rules["frame-ancestors"] == "'self'"
    assert {"'self'", "ws://localhost:8080", "blob:", "data:"} < set(rules["default-src"].split())
    assert not re.search(r"\*|https?:", policy)


def test_a_token_can_be_chosen_or_left_out_on_a_network_and_is_not_asked_for_elsewhere() -> None:
    for host in ("127.0.0.1", "localhost", "127.0.0.2"):
        assert is_loopback(host)
        assert Admission().at(host).token is None
        assert Admission(token="chosen-by-hand").at(host).token == "chosen-by-hand"
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("nowhere.invalid")
    assert Admission(token="chosen-by-hand").at("0.0.0.0").token == "chosen-by-hand"
    open_to_all = Admission(without_token=True).at("0.0.0.0")
    assert open_to_all.token is None
    lan = ("10.0.0.7", 8080)
    assert ask(open_to_all, "10.0.0.7:8080", address=lan) is None
    assert ask(open_to_all, f"{socket.gethostname()}:8080".lower(), address=lan) is None
    assert ask(open_to_all, "[fd00::7]:8080", address=("fd00::7", 8080)) is None
    assert ask(open_to_all, "10.0.0.7:8080", address=("::ffff:10.0.0.7", 8080)) is None
    assert ask(open_to_all, "10.0.0.8:8080", address=lan) == HTTPStatus.MISDIRECTED_REQUEST
    assert ask(open_to_all, "evil.com:8080", address=lan) == HTTPStatus.MISDIRECTED_REQUEST


def test_a_token_is_hard_to_guess_and_fits_a_link() -> None:
    assert check_token("long-enough") == "long-enough"
    for text in ("short", "with a blank", "semi;colon", "x" * 201, "ümlaut-token"):
        with pytest.raises(InputError, match="--token"):
            check_token(text)
