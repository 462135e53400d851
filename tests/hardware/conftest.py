"""Boards that tests start; those that simulate the firmware skip where its tools are missing."""

import pytest

from hardware.boards.simavr_board import MCUS, SimavrBoard, find_tools, write_table
from tests.hardware.boards import DISTINCT, build


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """The folder of the firmware for both MCUs, and of the program that runs it."""
    missing = find_tools()
    if missing:
        pytest.skip(missing)
    folder = tmp_path_factory.mktemp("built")
    build(folder, "all", "simulator")
    return folder


@pytest.fixture
def board(built, tmp_path):
    """Starts boards that read a table of counts; DISTINCT unless told."""

    def start(mcu=MCUS[0], counts=DISTINCT, step_us=1000, elf=None, table=None, **options):
        if table is None:
            table = tmp_path / "readings.table"
            write_table(table, counts, step_us)
        elf = elf or built / f"tripillar-{mcu}.elf"
        return SimavrBoard(elf, mcu, table, program=built / "simavr-board", **options)

    return start
