"""The local server answers its own page only: no other host or site, no stranger, nobody who dawdles."""

import http.client
import socket
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from tests.browser import visit
from tests.report.test_viewer import free_port
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.report import local_server
from vntoolkit.report.local_server import LocalServer
from vntoolkit.report.scene import scene_page


@pytest.fixture
def server() -> Iterator[LocalServer]:
    page = scene_page("a page", "live", {"records": True})
    served = LocalServer(
        ViewerOptions(port=free_port()),
        page,
        {"/packet": lambda query: b"the camera"},
        {"/record": lambda query: b""},
    )
    yield served
    served.close()


def answer(
    server: LocalServer, path: str, method: str = "GET", token: bool = True, **headers: str
) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request(method, f"{path}?token={server.token}" if token else path, headers=headers)
    reply = connection.getresponse()
    return reply.status, reply.read()


def test_the_page_itself_is_served(server: LocalServer) -> None:
    port = server.port
    own = {"Origin": f"http://127.0.0.1:{port}"}
    assert urlsplit(server.address).query == f"token={server.token}"
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", "localhost:9000"):  # the last: a forwarded port
        assert answer(server, "/packet", Host=host) == (200, b"the camera")
    assert answer(server, "/packet", **own) == (200, b"the camera")
    assert answer(server, "/record", "POST", **own)[0] == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1.evil.example"},
        {"Host": "192.0.2.7"},
        {"Host": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1"},
    ],
)
def test_other_hosts_and_origins_are_refused(server: LocalServer, headers: dict[str, str]) -> None:
    for path, method in (("/", "GET"), ("/packet", "GET"), ("/record", "POST")):
        status, content = answer(server, path, method, **headers)
        assert status == 403
        assert b"camera" not in content


def test_without_the_token_nothing_is_answered(server: LocalServer) -> None:
    for path, method in (("/", "GET"), ("/packet", "GET"), ("/record", "POST"), ("/?token=guess", "GET")):
        status, content = answer(server, path, method, token=False)
        assert status == 403
        assert b"open the whole address" in content
        assert server.token.encode() not in content


def test_the_name_of_another_machine_is_refused_on_all_addresses_too() -> None:
    served = LocalServer(ViewerOptions(host="0.0.0.0", port=free_port()), "", {})
    try:
        assert (
            answer(served, "/", Host="192.0.2.7")[0] == 200
        )  # written as an address: nobody can point it here
        assert answer(served, "/", Host=socket.gethostname())[0] == 200
        assert answer(served, "/", Host="evil.example")[0] == 403
    finally:
        served.close()


@pytest.mark.skipif(not socket.has_ipv6, reason="no IPv6 on this machine")
def test_an_address_of_ipv6_is_listened_on() -> None:
    served = LocalServer(ViewerOptions(host="::1", port=free_port()), "", {})
    served.close()
    assert served.address.startswith("http://[::1]:")


def test_no_frame_and_no_foreign_script(server: LocalServer) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    for path in (f"/?token={server.token}", "/nowhere", f"/packet?token={server.token}"):
        connection.request("GET", path)
        reply = connection.getresponse()
        reply.read()
        policy = reply.getheader("Content-Security-Policy", "")
        assert "frame-ancestors 'none'" in policy
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert reply.getheader("X-Frame-Options") == "DENY"
        assert reply.getheader("Referrer-Policy") == "no-referrer"
        assert "Python" not in reply.getheader("Server", "")


@pytest.mark.parametrize("sent", [b"", b"GET /packet", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"])
def test_a_request_that_never_ends_is_let_go(server, monkeypatch, sent):
    monkeypatch.setattr(local_server, "_REQUEST_S", 0.6)
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as dawdler:
        dawdler.sendall(sent)
        started = time.monotonic()
        for _ in range(4):  # a byte now and then does not help
            time.sleep(0.2)
            try:
                dawdler.sendall(b"a")
            except ConnectionError:
                break
        try:
            while dawdler.recv(1000):
                pass
        except ConnectionError:
            pass
        assert time.monotonic() - started < 5
    assert answer(server, "/packet")[0] == 200  # the others are served meanwhile


@pytest.mark.slow
def test_the_policy_lets_the_page_itself_work(server: LocalServer) -> None:
    with visit(server.address, width=500, height=700) as seen:
        assert seen.page.evaluate("typeof trianglesOf") == "function"  # its script ran
        assert seen.page.evaluate("getComputedStyle(document.body).display") == "grid"  # its style counts
        assert [text for text in seen.complaints if "Content Security" in text] == []
