"""Ports: what opens, what opening says where it fails, and the names of ports that are on their way.

A port is whatever pyserial opens: a device, a pseudo-terminal or a link to one, ``socket://host:port``,
``loop://``. What pyserial and the system raise becomes `PortError` here and in `scanner.Link`, nowhere else.
"""

import contextlib
import errno
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import psutil
import serial
from serial.tools.list_ports import comports
from serial.urlhandler import protocol_socket

from common.errors import DesignError, TriPillarError

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
_TIMEOUT_S = 0.1  # of a read, which bounds how long closing takes
_WRITE_TIMEOUT_S = 0.05  # a board that does not listen must not hold up the reading
_SOCKET = "socket://"
_ADVICE = dict.fromkeys((errno.EAGAIN, errno.EBUSY), "in use by another program: close that one first.")
_ADVICE[errno.EISDIR] = f"a folder, not a port: name a device as {EXAMPLE}."
_ADVICE |= dict.fromkeys(
    (errno.EACCES, errno.EPERM),
    "no permission: join the group that owns it, as with 'sudo usermod -aG dialout $USER', and log in anew.",
)


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


def open_port(url: str, baud: int = BAUD) -> Port:
    """Open a port for this program alone: a device, a pseudo-terminal or a link to one, or a URL that pyserial knows.

    Raises
    ------
    PortError
        If there is no such port, it is in use, it may not be opened, is none, or there is no such kind.
    """
    options = {"baudrate": baud, "timeout": _TIMEOUT_S, "write_timeout": _WRITE_TIMEOUT_S, "exclusive": True}
    try:
        return _SocketPort(url, **options) if url.startswith(_SOCKET) else serial.serial_for_url(url, **options)
    except PORT_FAULTS as fault:
        code = getattr(fault, "errno", None) or 0
        if not url:
            cause = f"no port was named: give a device as {EXAMPLE}."
        elif url.startswith(_SOCKET):
            cause = f"no connection ({fault}): give socket://HOST:PORT of a running server."
        elif code == errno.ENOENT:
            cause = f"{no_such_port()}. Plug the board in, or name another."
        else:
            cause = _ADVICE.get(code, f"no serial port ({fault}): name a device as {EXAMPLE}, or socket://HOST:PORT.")
        raise PortError(f"{url}: {cause}") from fault


def no_such_port() -> str:
    """In words that there is no such port, and which there are."""
    return f"no such port; there are: {', '.join(sorted(port.device for port in comports())) or 'none'}"


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


def require_symlink(link: Path | None) -> None:
    """Refuse to put a link in the place of something else: `DesignError`."""
    if link is not None and link.exists() and not link.is_symlink():
        raise DesignError(f"link={link} exists and is no link: give another name for the link to the port.")


@contextlib.contextmanager
def symlinked(link: Path | None, port: str) -> Iterator[str]:
    """Keep a link on a port, whatever it pointed to before, until the block ends or another takes it over.

    Gives the name to open: the link's, or the port's own without one. Errors as of `require_symlink`.
    """
    require_symlink(link)
    if link is None:
        yield port
        return
    beside = link.with_name(link.name + ".new")
    beside.unlink(missing_ok=True)
    beside.symlink_to(port)
    beside.replace(link)
    try:
        yield str(link)
    finally:
        if link.is_symlink() and os.readlink(link) == port:
            link.unlink()


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
