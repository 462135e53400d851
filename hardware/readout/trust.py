"""Whether a program in a cache can have been put there by somebody else."""

import os
import stat
from pathlib import Path

from geometry.errors import TriPillarError


class UntrustedError(TriPillarError, PermissionError):
    """Others can write what is about to be run; one line."""


def require_own(place: Path, root: Path) -> None:
    """Refuse files that another user owns or can change: `place`, all that lies in it, and each folder up to `root`.

    Files of the superuser count as one's own. A group whose only member is the owner, as many systems give everybody,
    is nobody else. Places that do not exist are passed over.

    Raises
    ------
    UntrustedError
        Naming the first such file, and how to mend it.
    """
    place, root = place.absolute(), root.absolute()
    above = [place, *(folder for folder in place.parents if folder.is_relative_to(root))]
    within = sorted(place.rglob("*")) if place.is_dir() and not place.is_symlink() else []
    for path in [*reversed(above), *within]:
        try:
            status = path.lstat() if path.is_relative_to(place) else path.stat()
        except FileNotFoundError:
            continue
        if status.st_uid not in (os.geteuid(), 0):
            raise UntrustedError(f"{path} belongs to another user, so it is not run: {_MEND}")
        if stat.S_ISLNK(status.st_mode):
            raise UntrustedError(f"{path} is a link to another place, so it is not run: {_MEND}")
        is_sticky = path in place.parents and status.st_mode & stat.S_ISVTX  # others can add to it, not replace
        if not is_sticky and _is_open(status):
            raise UntrustedError(f"{path} can be written by others, so what is in it is not run: {_MEND}")


_MEND = "remove it, or set TRIPILLAR_CACHE to a folder that only you can write to."


def _is_open(status: os.stat_result) -> bool:
    """Whether others than the owner can write to a file."""
    return bool(status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and not _is_private_group(status)))


def _is_private_group(status: os.stat_result) -> bool:
    """Whether the group of a file is its owner's own, without other members."""
    import grp
    import pwd

    try:
        owner, group = pwd.getpwuid(status.st_uid), grp.getgrgid(status.st_gid)
    except KeyError:
        return False
    return owner.pw_gid == group.gr_gid and set(group.gr_mem) <= {owner.pw_name} and owner.pw_name == group.gr_name
