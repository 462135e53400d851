"""A job of tasks that take 5 ms, to be killed and taken up again: `python -m tests.common.fake_job FOLDER`."""

import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from time import sleep
from types import MappingProxyType

from common.pool import open_pool
from common.storage.journal import Journal
from tripillar.terminal import interrupts

TASKS = 200


def sleep_with(memory: bytearray) -> None:
    """Hold memory for a minute."""
    sleep(60)
    assert memory


def square(number: int, bad: Mapping[int, str] = MappingProxyType({})) -> int:
    """The square of a number; those in `bad` do what it says."""
    sleep(0.005)
    if number in bad:
        deeds = {
            "exits": lambda: os._exit(3),
            "killed": lambda: os.kill(os.getpid(), signal.SIGKILL),
            "hangs": lambda: sleep(60),
            "grows": lambda: sleep_with(bytearray(2**30 // 2)),
            "disk": lambda: (_ for _ in ()).throw(OSError(28, "No space left on device", "cell.npz")),
            "raises": lambda: {}["no such key"],
        }
        deeds[bad[number]]()
    return number**2


def threads(_: int) -> set[int]:
    """Threads of each library of linear algebra in a worker."""
    import numpy  # noqa: F401
    from threadpoolctl import threadpool_info

    return {library["num_threads"] for library in threadpool_info()}


def register() -> str:
    """Leave what Intel's OpenMP leaves in shared memory; its place."""
    place = Path(f"/dev/shm/__KMP_REGISTERED_LIB_{os.getpid()}_{os.getuid()}")
    place.touch()
    return str(place)


def go_on(folder: Path) -> tuple[dict[int, int], int]:
    """The squares of all numbers, and how many of them were made now."""
    journal = Journal(folder)
    kept = {number: journal.read(str(number), lambda plain: plain["square"]) for number in range(TASKS)}
    missing = [number for number, found in kept.items() if found is None]
    with open_pool(2, tasks=len(missing)) as pool:
        for number, made in pool.done(square, missing, ahead=2):
            journal.keep(str(number), {"square": made})
            kept[number] = made
    return kept, len(missing)


if __name__ == "__main__":
    interrupts.install()
    go_on(Path(sys.argv[1]))
