"""One thread for many small matrices: to wake another takes longer than to work."""

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    """To look for them takes milliseconds: once a process."""
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[object]:
    """Within it, BLAS works with one thread, and so do all other threads of the process."""
    return _libraries().limit(limits=1, user_api="blas")


def blas_threads() -> int:
    """Most threads that a BLAS library of this process works with."""
    return max((pool["num_threads"] for pool in _libraries().info() if pool["user_api"] == "blas"), default=1)
