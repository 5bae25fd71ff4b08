"""A web server on this machine for one page and what it asks for; nobody else gets an answer.

A page of another site, open in the same browser, can send requests to this machine too. It learns nothing by
them: every request must carry the token of the printed address, must name this server as its host, which a
name that was pointed here afterwards does not, and must not come from another origin.
"""

import contextlib
import errno
import hmac
import io
import ipaddress
import secrets
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any
from urllib.parse import parse_qs, urlsplit

from vntoolkit.errors import BadInput, CannotWrite, VntError
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.report.rendering import scene_policy

_PORTS_TRIED = 100
_REQUEST_S = 10.0  # for a whole request to come; a page that asks for nothing is let go after it too
_ANSWER_S = 60.0  # for an answer to be taken off
_TOKEN_BYTES = 16

Answer = Callable[[Mapping[str, str]], bytes | None]


class LocalServer:
    """Serves a page at `/` and the answers at their paths, each in the thread of its connection."""

    def __init__(
        self,
        options: ViewerOptions,
        page: str,
        answers: Mapping[str, Answer],
        posts: Mapping[str, Answer] | None = None,
    ) -> None:
        """Listen at once. Raises `CannotWrite` for an address that is not ours.

        answers: by path, such as `/frame`; called with the query, they return what is sent, or None where
        there never will be anything. posts: the same on a POST to these paths.
        """
        self.token = secrets.token_urlsafe(_TOKEN_BYTES)
        self._host = options.host
        site = _Site(
            page=page.encode(),
            answers=answers,
            posts=posts or {},
            token=self.token,
            names=_own_names(options.host),
        )
        self._server = _listening(options.host, options.port, partial(_Handler, site))
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.2}, name="local-server", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """The address to open in a browser, with the token."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self.port}/?token={self.token}"

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@dataclass(frozen=True, kw_only=True)
class _Site:
    """names: hosts that a request may be addressed to; None for any that is written as an IP address."""

    page: bytes
    answers: Mapping[str, Answer]
    posts: Mapping[str, Answer]
    token: str
    names: frozenset[str | None]


def _own_names(host: str) -> frozenset[str | None]:
    """Return the names of the address that is bound.

    Ports do not count: one may be forwarded to another. A server on all addresses may be reached by any of
    them; what is refused there are names, since only a name can be pointed here by somebody else.
    """
    names: set[str | None] = {host.lower()}
    with contextlib.suppress(OSError, UnicodeError):
        found = {str(info[4][0]) for info in socket.getaddrinfo(host, None, flags=socket.AI_PASSIVE)}
        bound = {ipaddress.ip_address(address.partition("%")[0]) for address in found}
        names |= {str(address) for address in bound}
        if any(address.is_loopback for address in bound):
            names |= {"localhost"}
        if any(address.is_unspecified for address in bound):
            names |= {"localhost", socket.gethostname().lower(), None}
    return frozenset(names)


class _Deadlined(io.RawIOBase):
    """Reads from a connection until a deadline, however slowly the bytes come."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self.until = 0.0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left = self.until - time.monotonic()
        if left <= 0:
            raise TimeoutError("the request took too long")
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # one connection for all packets
    disable_nagle_algorithm = True
    server_version, sys_version = "vntoolkit", ""

    def __init__(self, site: _Site, *connection: Any) -> None:
        self.site = site
        super().__init__(*connection)

    def setup(self) -> None:
        super().setup()
        self.rfile.close()
        self._incoming = _Deadlined(self.connection)
        self.rfile = io.BufferedReader(self._incoming)

    def handle_one_request(self) -> None:
        self._incoming.until = time.monotonic() + _REQUEST_S
        with contextlib.suppress(ConnectionError):  # the page was closed
            super().handle_one_request()

    def do_GET(self) -> None:
        if urlsplit(self.path).path != "/":
            self._answer(self.site.answers)
        elif self._accepted() is not None:
            self._reply(self.site.page, "text/html; charset=utf-8")

    def do_POST(self) -> None:
        self.close_connection = True  # what a body may hold is not read
        self._answer(self.site.posts)

    def _answer(self, answers: Mapping[str, Answer]) -> None:
        query, answer = self._accepted(), answers.get(urlsplit(self.path).path)
        if query is None:
            return
        if answer is None:
            self._refuse(HTTPStatus.NOT_FOUND, "there is nothing here")
            return
        try:
            content = answer(query)
        except (KeyError, ValueError, IndexError, BadInput) as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
        except VntError as error:
            self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, str(error))
        else:
            if content is None:
                self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, "vntoolkit has ended")
            else:
                self._reply(content, "application/octet-stream")

    def _accepted(self) -> dict[str, str] | None:
        """Return the query, or refuse and return None."""
        host = self.headers.get("Host", "")
        name = urlsplit(f"//{host}").hostname if host.isprintable() else None
        if name is None or not (name in self.site.names or (None in self.site.names and _is_address(name))):
            self._refuse(HTTPStatus.FORBIDDEN, "this is not the host that is served here")
            return None
        origin = self.headers.get("Origin")
        if origin is not None and origin.lower() != f"http://{host.lower()}":
            self._refuse(HTTPStatus.FORBIDDEN, "another site asks")
            return None
        query = {key: values[0] for key, values in parse_qs(urlsplit(self.path).query).items()}
        if not hmac.compare_digest(query.pop("token", "").encode(), self.site.token.encode()):
            self._refuse(
                HTTPStatus.FORBIDDEN, "open the whole address that vntoolkit printed, with its token"
            )
            return None
        return query

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        self.close_connection = True
        self._reply(reason.encode(), status=status)

    def _reply(
        self, content: bytes, kind: str = "text/plain; charset=utf-8", *, status: HTTPStatus = HTTPStatus.OK
    ) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def end_headers(self) -> None:
        """Say how the page may be used: by itself, in no frame, kept by nobody."""
        self.send_header(
            "Content-Security-Policy",
            f"{scene_policy()}; connect-src 'self'; frame-ancestors 'none'",
        )
        self.send_header("X-Frame-Options", "DENY")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("Cache-Control", "no-store")
        self.connection.settimeout(_ANSWER_S)
        super().end_headers()

    def log_message(self, *_: Any) -> None:
        """Say nothing: each packet would be a line."""


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class _Listener(socketserver.ThreadingTCPServer):
    daemon_threads = True
    allow_reuse_address = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A page that went away is no error."""


def _listening(host: str, port: int, handler: Callable[..., _Handler]) -> _Listener:
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
        reason = getattr(error, "strerror", None) or str(error)
        raise CannotWrite(
            f"cannot serve on {host}:{port}: {reason}; is --host an address of this machine, as 127.0.0.1?"
        ) from error
    raise CannotWrite(f"cannot serve on {host}:{port}: this port and the {_PORTS_TRIED} above are in use")
