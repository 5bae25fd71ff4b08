"""A viser server on an address of this machine, or one line that says why there is none."""

from __future__ import annotations

import contextlib
import io
import socket
from typing import Any

from vntoolkit.errors import CannotWrite


def started_server(host: str, port: int) -> Any:
    """Start viser on the port or the next free one. Raises `CannotWrite` for an address that is not ours.

    The address is tried out first, since viser takes every refusal for a port in use and would wait for ever.
    """
    import viser

    try:
        for family, kind, protocol, _, address in socket.getaddrinfo(
            host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        ):
            with socket.socket(family, kind, protocol) as probe:
                probe.bind(address)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints a box, whatever it is told
            return viser.ViserServer(host=host, port=port, verbose=False)
    except (OSError, UnicodeError) as error:
        raise cannot_serve(host, port, error) from error


def cannot_serve(host: str, port: int, error: Exception) -> CannotWrite:
    """Return the error to raise where an address cannot be listened on."""
    reason = getattr(error, "strerror", None) or str(error)
    return CannotWrite(
        f"cannot serve on {host}:{port}: {reason}; is --host an address of this machine, as 127.0.0.1?"
    )


def stop_server(server: Any) -> None:
    """Stop viser, without the line that it prints."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()
