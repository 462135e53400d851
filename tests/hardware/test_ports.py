"""Ports: what opens, and what each way to fail is told as."""

import errno
import os
import socket
import termios
import tty
from contextlib import contextmanager

import pytest
import serial

from geometry.errors import TriPillarError
from hardware.link.serial_ports import ListedPort, PortError, close, list_ports, open_port, read_available, write


@contextmanager
def a_pty():
    """The board's end, and the name of the host's."""
    board_end, host_end = os.openpty()
    tty.setraw(host_end)
    try:
        yield board_end, os.ttyname(host_end)
    finally:
        os.close(host_end)
        os.close(board_end)


@contextmanager
def opened(url, **options):
    port = open_port(url, **options)
    try:
        yield port
    finally:
        close(port)


def read_all(port, n):
    received = b""
    while len(received) < n:
        piece = read_available(port)
        assert piece, f"{len(received)} of {n} bytes, then nothing"
        received += piece
    return received


def test_bytes_pass_both_ways_through_a_link_to_a_pty(tmp_path):
    link = tmp_path / "board"
    with a_pty() as (board_end, name):
        link.symlink_to(name)
        with opened(str(link)) as port:
            os.write(board_end, bytes(range(256)))
            assert read_all(port, 256) == bytes(range(256))
            assert write(port, b"?")
            assert os.read(board_end, 10) == b"?"


def test_nothing_arrives_in_time():
    with a_pty() as (_, name), opened(name, timeout_s=0.01) as port:
        assert read_available(port) == b""


def refusal(url):
    with pytest.raises(PortError) as caught:
        open_port(url)
    assert isinstance(caught.value, TriPillarError)
    assert isinstance(caught.value, OSError)
    message = str(caught.value)
    assert message.startswith(f"{url}: ")
    assert "\n" not in message
    return message


def test_no_such_port_names_those_there_are(monkeypatch, tmp_path):
    monkeypatch.setattr("hardware.link.serial_ports.comports", lambda: [])
    assert "no such port; there are: none." in refusal(str(tmp_path / "ttyUSB7"))
    there = [ListedPort(device=f"/dev/ttyUSB{k}", description="", hardware_id="") for k in range(2)]
    monkeypatch.setattr("hardware.link.serial_ports.list_ports", lambda: there)
    assert "there are: /dev/ttyUSB0, /dev/ttyUSB1." in refusal(str(tmp_path / "ttyUSB7"))


def test_a_port_opens_once():
    with a_pty() as (_, name):
        with opened(name):
            assert "in use by another program" in refusal(name)
        with opened(name):
            pass


def test_no_permission_names_the_group(monkeypatch):
    """Simulated, for root may open anything."""

    def refuse(url, **options):
        raise serial.SerialException(errno.EACCES, f"could not open port {url}: Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    assert "no permission: join the group" in refusal("/dev/ttyUSB0")
    assert "dialout" in refusal("/dev/ttyUSB0")


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("/dev/null", "no serial port"),
        (os.sep, "a folder, not a port"),
        ("carrier://pigeon", "there are no ports of the kind carrier://"),
        ("socket://nowhere", "no host and port number"),
    ],
)
def test_what_is_no_port_is_told_in_one_line(url, message):
    assert message in refusal(url)


def test_a_socket_nobody_listens_at():
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        assert "no connection" in refusal(f"socket://127.0.0.1:{unused.getsockname()[1]}")


def test_a_pty_that_vanishes_is_one_error_whatever_is_done():
    with a_pty() as (board_end, name), opened(name) as port:
        os.close(board_end)
        try:
            with pytest.raises(PortError, match="the port is gone"):
                read_available(port)
            with pytest.raises(PortError, match="the port is gone"):
                write(port, b"?")
            close(port)
        finally:
            os.dup2(os.open(os.devnull, os.O_RDONLY), board_end)


@pytest.mark.parametrize(
    "fault",
    [
        TypeError("fd is None"),
        termios.error(5, "I/O error"),
        ValueError("fd is -1"),
        serial.SerialException("read failed"),
    ],
)
def test_whatever_a_broken_port_raises_is_one_error(fault):
    class Broken:
        in_waiting = 1

        def read(self, size):
            raise fault

        def close(self):
            raise fault

    with pytest.raises(PortError, match="the port is gone"):
        read_available(Broken())
    close(Broken())


def test_a_port_that_takes_nothing_does_not_hold_up():
    """4 kB fill a pty that nobody reads; then a write gives up after its timeout."""
    with a_pty() as (_, name), opened(name) as port:
        while write(port, bytes(1000)):
            pass


def test_a_socket_gives_what_has_arrived_in_few_reads():
    """pyserial's own tells 1 byte waiting at a time, which costs a read a byte."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        opened(f"socket://127.0.0.1:{server.getsockname()[1]}") as port,
    ):
        board, _ = server.accept()
        board.sendall(bytes(2000))
        n_reads = n_bytes = 0
        while n_bytes < 2000:
            n_bytes += len(read_available(port))
            n_reads += 1
        assert n_reads < 50
        board.close()
        with pytest.raises(PortError, match="the port is gone"):
            read_all(port, 1)


def test_ports_of_the_computer(monkeypatch):
    class Found:
        device, description, hwid = "/dev/ttyUSB0", "CP2102 USB to UART", "USB VID:PID=10C4:EA60"

    monkeypatch.setattr("hardware.link.serial_ports.comports", lambda: [Found()])
    assert list_ports() == [
        ListedPort(device="/dev/ttyUSB0", description="CP2102 USB to UART", hardware_id="USB VID:PID=10C4:EA60")
    ]
