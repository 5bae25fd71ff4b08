"""A small web server for the live page: one request, one packet; what is not asked for is not sent."""

from __future__ import annotations

import contextlib
import errno
import socket
import socketserver
import threading
from collections.abc import Callable
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qs, urlsplit

from vntoolkit.errors import BadInput, CannotWrite
from vntoolkit.live.packet import PacketSizes
from vntoolkit.report.serving import cannot_serve

_PORTS_TRIED = 100


class LiveServer:
    """Serves the page at `/`, what `answer` returns at `/packet`, and calls `record` on a POST to `/record`.

    Each runs in the thread of its connection. answer(page, serial, ago_s, sizes): the page's own name, the
    packet that it drew last, how long ago, and how large the next may be; it returns empty bytes where there
    is nothing new, None where there never will be.
    """

    def __init__(
        self,
        host: str,
        port: int,
        answer: Callable[[str, int, float, PacketSizes], bytes | None],
        record: Callable[[], None] | None,
    ) -> None:
        """Listen at once. Raises `CannotWrite` for an address that is not ours."""

        class Handler(_Handler):
            packet = staticmethod(answer)
            toggle = None if record is None else staticmethod(record)

        self._server = _listening(host, port, Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.2}, name="live-server", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # one connection for all packets
    disable_nagle_algorithm = True
    packet: Callable[[str, int, float, PacketSizes], bytes | None]
    toggle: Callable[[], None] | None

    def do_GET(self) -> None:
        address = urlsplit(self.path)
        try:
            if address.path == "/":
                self._reply(live_page(self.toggle is not None).encode(), "text/html; charset=utf-8")
            elif address.path == "/packet":
                asked = {name: values[0] for name, values in parse_qs(address.query).items()}
                sizes = PacketSizes(**{name: int(asked[name]) for name in ("grid", "normals", "camera")})
                serial, ago_s = int(asked["serial"]), int(asked["ago_ms"]) / 1000
                answer = self.packet(asked["id"], serial, ago_s, sizes)
                if answer is None:
                    self.close_connection = True
                    self._reply(b"", status=HTTPStatus.SERVICE_UNAVAILABLE)
                else:
                    self._reply(answer, "application/octet-stream")
            else:
                self._reply(b"", status=HTTPStatus.NOT_FOUND)
        except (KeyError, ValueError, BadInput):
            self._reply(b"", status=HTTPStatus.BAD_REQUEST)

    def do_POST(self) -> None:
        # the header keeps other sites' pages out: no browser lets them send it
        if self.path == "/record" and self.toggle is not None and self.headers.get("X-Live"):
            self.toggle()
            self._reply(b"")
        else:
            self._reply(b"", status=HTTPStatus.NOT_FOUND)

    def _reply(self, content: bytes, kind: str = "text/plain", *, status: HTTPStatus = HTTPStatus.OK) -> None:
        head = (
            f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: {kind}\r\n"
            f"Content-Length: {len(content)}\r\nCache-Control: no-store\r\n\r\n"
        )
        with contextlib.suppress(ConnectionError):  # the page was closed
            self.wfile.write(head.encode() + content)

    def log_message(self, *_: Any) -> None:
        """Say nothing: each packet would be a line."""


class _Listener(socketserver.ThreadingTCPServer):
    daemon_threads = True
    allow_reuse_address = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that went away is no error."""


@cache
def live_page(records: bool) -> str:
    """Return the page as HTML, its script inside; records: whether it has a button for recording."""
    import jinja2

    folder = files("vntoolkit.live") / "templates"
    template = jinja2.Environment(autoescape=True).from_string((folder / "live.html.j2").read_text("utf-8"))
    return template.render(records=records, script=(folder / "live.js").read_text("utf-8"))


def _listening(host: str, port: int, handler: type[_Handler]) -> _Listener:
    """Listen on the port or the next free one."""
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        _Listener.address_family = family
        for tried in range(port, min(port + _PORTS_TRIED, 65536)):
            try:
                return _Listener((str(address[0]), tried), handler)
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
    except (OSError, UnicodeError) as error:
        raise cannot_serve(host, port, error) from error
    raise CannotWrite(f"cannot serve on {host}:{port}: this port and the {_PORTS_TRIED} above are in use")
