"""Threads on purpose: products of small matrices are slower on two than on one, far more so on a busy machine."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """One thread for linear algebra meanwhile; also a decorator of functions, ``@one_blas_thread()``."""
    with threadpool_limits(1, "blas"):
        yield
