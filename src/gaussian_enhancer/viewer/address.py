"""Address at which the viewer's page is served."""

import errno
import socket
from typing import Any

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.optional_library import optional_library


def refuse_taken(host: str, port: int) -> None:
    """Refuse an address at which no server can listen.

    Args:
        host: address or name of this machine.
        port: port number; 0 for a free port.

    Raises:
        InputError: the port is in use or not allowed, or this machine has no such address.
    """
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as error:
        raise InputError(f"host={host}", f"is no address ({error})", "give 127.0.0.1, or 0.0.0.0") from error
    family, kind, protocol, _, address = addresses[0]
    with socket.socket(family, kind, protocol) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
        try:
            probe.bind(address)
            probe.listen(1)
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL:
                received, remedy = "is no address of this machine", "give 127.0.0.1, or 0.0.0.0 for all networks"
                raise InputError(f"host={host}", received, remedy) from error
            received = f"cannot be listened at on {host} ({error.strerror})"
            raise InputError(f"port={port}", received, "give another port, or port=0 for a free one") from error


def load_viser() -> Any:
    """Import viser, an optional library.

    Raises:
        InputError: it is not installed.
    """
    return optional_library("viser", "view", "viewer")
