"""Where the page listens."""

import socket

from geometry.errors import TriPillarError


class AddressError(TriPillarError, OSError):
    """An address that cannot be listened on."""


def require_free(host: str, port: int) -> None:
    """Refuse an address that cannot be listened on, before anything takes time.

    Raises
    ------
    AddressError
        If the host is none of this machine, or another program listens on that port.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
            trial.bind(address)
            trial.listen()
    except OSError as error:
        raise AddressError(
            f"cannot listen on {host}, port {port}: {error.strerror}; give another --host or --http-port."
        ) from None


def page_url(host: str, port: int) -> str:
    """The page's address as browsers take it.

    Every interface has the loopback's name, too; IPv6 stands in brackets.

    >>> page_url("0.0.0.0", 8080), page_url("::1", 80)
    ('http://127.0.0.1:8080/', 'http://[::1]:80/')
    """
    plain = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"http://[{plain}]:{port}/" if ":" in plain else f"http://{plain}:{port}/"
