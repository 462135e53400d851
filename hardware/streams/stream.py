"""What a stream is; addresses to serve it on, who can reach them, and files with room for their own end."""

import shutil
import socket
import sys
from ipaddress import ip_address
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from common.errors import DesignError, TriPillarError
from common.storage.files import require_file
from hardware.readout.forces import Forces

LOOPBACK = "127.0.0.1"
ROOM_BYTES = 2**22  #: kept free of a stream's file, for its index and what still waits in memory


class Stream(Protocol):
    """A viewer or a file that takes the forces of one scan after another, as long as its with block lasts.

    Those here serve viewers on an address of this machine (`host` None: there is no server) and write a file, which
    must not exist. Raised are `MissingPackageError`; `DesignError` if nobody knows where the pads are; `StreamError` on
    entering, if the port cannot be had or the file be made, and later if the disk is full: the file is ended then and
    can be read.
    """

    def add(self, scan: Forces) -> None:
        """Take those of one scan."""


class StreamError(TriPillarError, RuntimeError):
    """A stream that cannot be opened."""


def host_and_port(text: str, port: int) -> tuple[str, int]:
    """Host and port of HOST:PORT, or of HOST with the usual port; `DesignError` for what is none.

    >>> host_and_port("0.0.0.0:9000", 8765), host_and_port("[::1]", 8765)
    (('0.0.0.0', 9000), ('::1', 8765))
    """
    try:
        address = urlsplit(f"//{text}")
        if not address.hostname or address.netloc != text or text.endswith(":"):
            raise ValueError(text)
        return address.hostname, port if address.port is None else address.port
    except ValueError:
        raise DesignError(f"{text!r} is no address: give HOST:PORT, such as {LOOPBACK}:{port}.") from None


def reachable(host: str) -> str:
    """Say in a few words who can reach a stream on an address.

    >>> reachable("127.0.0.1")
    'this machine alone'
    """
    try:
        is_here = ip_address(host).is_loopback
    except ValueError:
        is_here = host == "localhost"
    return "this machine alone" if is_here else "everybody who can reach this address can read it, unencrypted"


def listening_on(host: str, port: int, mend: str = "give another address") -> socket.socket:
    """A socket that listens on an address; a `StreamError` if another program does, or it is none of this machine."""
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        is_both = family == socket.AF_INET6 and host == "::" and socket.has_dualstack_ipv6()
        return socket.create_server(address[:2], family=family, dualstack_ipv6=is_both)
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "no name of a machine"
        raise StreamError(f"cannot listen on {host}, port {port}: {why}: {mend}, or end what listens there.") from None


def require_new(path: Path | None) -> None:
    """Refuse to write a stream over a file that exists, or where none can be written."""
    if path is not None:
        require_file(path)
        if path.exists():
            raise StreamError(f"{path}: the file exists: give another name.")


def make_file(path: Path) -> None:
    """Make a stream's empty file, with its folder; `StreamError` if it exists, or there is no room for it."""
    require_new(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        require_room(path)
        path.open("xb").close()
    except OSError as error:
        raise StreamError(f"{path}: {error.strerror}: give another file.") from None


def require_room(path: Path) -> None:
    """Refuse to write on where the disk is full but for what the end of the file needs: `StreamError`."""
    free = shutil.disk_usage(path.parent).free
    if sys.platform != "win32":
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
        if limit != resource.RLIM_INFINITY:
            free = min(free, limit - (path.stat().st_size if path.exists() else 0))
    if free < ROOM_BYTES:
        raise StreamError(
            f"{path}: the disk is full ({max(free, 0) // 1024} kB left): the file ends here and can be read: make room "
            "or take another disk."
        )
