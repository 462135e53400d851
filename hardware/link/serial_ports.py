"""Ports are found, opened, read and written; every fault is told in one line.

A port is whatever pyserial opens: a device, a pseudo-terminal or a link to one, ``socket://host:port``,
``loop://``. Exceptions of pyserial and the system become `PortError` here and nowhere else.
"""

import contextlib
import errno
import socket
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import psutil
import serial
from serial.tools.list_ports import comports
from serial.urlhandler import protocol_socket

from geometry.errors import TriPillarError

if sys.platform == "win32":
    _TerminalError = OSError
    EXAMPLE = "COM3"
else:
    from termios import error as _TerminalError  # no subclass of OSError

    EXAMPLE = "/dev/ttyUSB0"

BAUD = 1_000_000  #: what the firmware sends at
PORT_FAULTS = (
    OSError,  # serial.SerialException among them
    _TerminalError,
    TypeError,  # of a port whose file descriptor has become None
    ValueError,  # of one whose file descriptor has become -1; of a setting that the port does not know
)  #: everything a port is known to raise, wherever it fails
_WRITE_TIMEOUT_S = 0.05  # a board that does not listen must not hold up the reading


class PortError(TriPillarError, OSError):
    """A port that cannot be opened, or has gone."""


class Port(Protocol):
    """Bytes to and from a board: pyserial's port, or a board that is not there.

    Its `read` should wait for bytes, but 0.1 s at most. Where it has an attribute ``finished``, nothing will come once
    that is true.
    """

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes; fewer, or none, if no more come in time."""

    def write(self, data: bytes) -> Any:
        """Send bytes to the board."""

    def close(self) -> None:
        """Give the port back."""


@dataclass(frozen=True, kw_only=True)
class ListedPort:
    """A serial port of this computer."""

    device: str  #: what to open, as /dev/ttyUSB0 or COM3
    description: str  #: by its maker
    hardware_id: str  #: USB vendor, product and serial number


def list_ports() -> list[ListedPort]:
    """The serial ports there are, sorted by name."""
    return [
        ListedPort(device=port.device, description=port.description, hardware_id=port.hwid)
        for port in sorted(comports())
    ]


def open_port(url: str, *, baud: int = BAUD, timeout_s: float = 0.1) -> Port:
    """Open a port for this program alone.

    Parameters
    ----------
    url : str
        A device, a pseudo-terminal or a link to one, or a URL that pyserial knows.
    baud : int
        Bits a second; a start and a stop bit go with each byte. Means nothing to a pseudo-terminal or a socket.
    timeout_s : float
        How long a read waits for its bytes [s].

    Returns
    -------
    Port
        pyserial's, for `read_available` and `write`; close it after use.

    Raises
    ------
    PortError
        If there is no such port, it is in use, it may not be opened, is none, or there is no such kind.
    """
    options = {"baudrate": baud, "timeout": timeout_s, "write_timeout": _WRITE_TIMEOUT_S, "exclusive": True}
    try:
        if url.lower().startswith("socket://"):
            return _SocketPort(url, **options)
        return serial.serial_for_url(url, **options)
    except PORT_FAULTS as fault:
        raise PortError(f"{url}: {_cause(fault, url)}") from fault


def read_available(port: Port) -> bytes:
    """Read what has arrived, or else the first bytes to arrive; empty if none does until the port's timeout.

    Raises
    ------
    PortError
        If the port has gone.
    """
    try:
        return port.read(max(1, port.in_waiting))
    except PORT_FAULTS as fault:
        raise PortError(f"the port is gone ({fault}): plug it in again.") from fault


def write(port: Port, data: bytes) -> bool:
    """Write a few bytes; False if the port does not take them now.

    Raises
    ------
    PortError
        If the port has gone.
    """
    try:
        port.write(data)
    except serial.SerialTimeoutException:
        return False
    except PORT_FAULTS as fault:
        raise PortError(f"the port is gone ({fault}): plug it in again.") from fault
    return True


def close(port: Port) -> None:
    """Close a port, also one that has gone and objects."""
    with contextlib.suppress(*PORT_FAULTS):
        port.close()


def _cause(fault: Exception, url: str) -> str:
    """Say why a port does not open, and how to mend it."""
    code = getattr(fault, "errno", None)
    if not url:
        return f"no port was named: give a device as {EXAMPLE}."
    if url.lower().startswith("socket://") and not _names_server(url):
        return "no host and port number: give socket://HOST:PORT of a running server."
    if code == errno.ENOENT:
        there = ", ".join(port.device for port in list_ports()) or "none"
        return f"no such port; there are: {there}. Plug the board in, or name another."
    if code == errno.EISDIR:
        return f"a folder, not a port: name a device as {EXAMPLE}."
    if code in (errno.EAGAIN, errno.EBUSY):
        return "in use by another program: close that one first."
    if code in (errno.EACCES, errno.EPERM):
        return "no permission: join the group that owns it, as with 'sudo usermod -aG dialout $USER', and log in anew."
    if "not known" in str(fault) and "://" in url:
        return f"there are no ports of the kind {url.partition('://')[0]}://; name a device as {EXAMPLE}, or socket://HOST:PORT."
    if url.lower().startswith("socket://"):
        return f"no connection ({fault}): give socket://HOST:PORT of a running server."
    return f"no serial port ({fault}): name a device as {EXAMPLE}."


def _names_server(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return bool(parts.hostname and parts.port)
    except ValueError:  # a port that is no number
        return False


class _SocketPort(protocol_socket.Serial):
    """pyserial's socket, but one that tells how much has arrived and closes at once, whatever its state."""

    is_open: bool
    _socket: Any

    @property
    def in_waiting(self) -> int:
        """Bytes that have arrived, 4096 at most; pyserial's own says 1, which makes each byte a read of its own."""
        try:
            return len(self._socket.recv(4096, socket.MSG_PEEK))
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """Close without pyserial's pause of 0.3 s, and also after the other side has gone."""
        if self.is_open:
            self._socket.close()
            self._socket = None
            self.is_open = False


def link_to(link: Path, target: str) -> None:
    """Let a link point to a port, whatever it pointed to before.

    Raises
    ------
    PortError
        If there is something else of that name.
    """
    if link.exists() and not link.is_symlink():
        raise PortError(f"{link} exists and is no link: give another name for the link to the port.")
    beside = link.with_name(link.name + ".new")
    beside.unlink(missing_ok=True)
    beside.symlink_to(target)
    beside.replace(link)


def is_beginning(port: str) -> bool:
    """True while a process runs that was started as a simulated board with a link of this name."""
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            words = " ".join(process.cmdline()).replace("=", " ").split(" ")
            if "board" in words and "--link" in words[:-1]:
                link = Path(process.cwd(), words[words.index("--link") + 1])
                if link == Path(port).absolute():
                    return True
    return False
