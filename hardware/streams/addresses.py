"""Opening streams: addresses, who can reach them, and what is in the way."""

from ipaddress import ip_address
from pathlib import Path
from typing import Protocol

from geometry.errors import DesignError, TriPillarError
from geometry.storage.files import require_file
from hardware.readout.forces import Forces

LOOPBACK = "127.0.0.1"


class Stream(Protocol):
    """A viewer or a file that takes the forces of one scan after another, as long as its with block lasts."""

    def add(self, scan: Forces) -> None:
        """Take those of one scan."""


class StreamError(TriPillarError, RuntimeError):
    """A stream that cannot be opened."""


def host_and_port(text: str, port: int) -> tuple[str, int]:
    """Host and port of HOST:PORT, or of HOST with the usual port.

    Raises
    ------
    DesignError
        If the port is no number from 0 to 65535, or there is no host.

    Examples
    --------
    >>> host_and_port("0.0.0.0:9000", 8765), host_and_port("[::1]", 8765)
    (('0.0.0.0', 9000), ('::1', 8765))
    """
    host, colon, number = text.rpartition(":") if text[-1:] != "]" else (text, "", "")
    if not colon:
        host, number = text, str(port)
    if not host or not number.isdecimal() or not int(number) < 2**16:
        raise DesignError(f"{text!r} is no address: give HOST:PORT, such as {LOOPBACK}:{port}.")
    return host.strip("[]"), int(number)


def reachable(host: str) -> str:
    """Say in a few words who can reach a stream on an address.

    >>> reachable("127.0.0.1")
    'this machine alone'
    """
    try:
        is_loopback = ip_address(host).is_loopback
    except ValueError:
        is_loopback = host == "localhost"
    return "this machine alone" if is_loopback else "everybody who can reach this address can read it, unencrypted"


def require_new(path: Path | None) -> None:
    """Refuse to write a stream over a file that exists, or where none can be written."""
    if path is not None:
        require_file(path)
        if path.exists():
            raise StreamError(f"{path}: the file exists: give another name.")
