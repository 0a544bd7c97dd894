"""Dask: processes on this computer by default, an existing cluster if its scheduler's address is given; the same tasks either way."""

from __future__ import annotations

import logging
import os
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker
from distributed.security import Security

from sim.errors import ConfigError

# Each worker processes one arm at a time: more threads would only contend, and sums would depend on their number
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1")  # fmt: skip
ALLOWED_DEATHS = 3  # workers that may die over one arm before it is given up
CONNECT_SECONDS = 10.0


@contextmanager
def cluster(scheduler: str | None = None, workers: int | None = None) -> Iterator[Client | None]:
    """Yield a client of the scheduler at an address (tls://host:port), or of `workers` processes on this computer (one per processor if
    None); for 0 workers yield None, and `results` does the work itself.

    The processes on this computer use TLS with keys that are made for this call alone and never written to disk: without one, nobody can
    give them work. A scheduler at an address is contacted with the keys of Dask's own settings (distributed.comm.tls).
    ConfigError where there is no answer at the address. `client.dashboard_link` is the page that shows what the workers do.
    """
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=CONNECT_SECONDS)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(
                f"--scheduler {scheduler}: does not answer ({error}); start one with `dask scheduler`, set the keys of a tls:// scheduler in "
                "Dask's settings (distributed.comm.tls), or omit the option to use this computer"
            ) from error
        with client:
            yield client
        return
    if workers == 0:
        yield None
        return
    settings = {
        "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
        "distributed.nanny.pre-spawn-environ": ONE_THREAD,
    }
    with dask.config.set(settings):
        security = Security.temporary()
        local = LocalCluster(
            n_workers=workers or os.cpu_count() or 1, threads_per_worker=1, processes=True, host="127.0.0.1",
            dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL, protocol="tls://", security=security,
        )  # fmt: skip
        try:
            with Client(local, security=security) as client:
                yield client
        finally:
            # all answers have arrived by now: a process that is slow to exit on a busy computer must not undo them
            with suppress(TimeoutError):
                local.close()


def results(
    client: Client | None, task: Callable[[Any], Any], items: Iterable[tuple[str, Any]]
) -> Iterator[tuple[str, Any | None, str]]:
    """Yield key, task(item) or None, and the reason for None, of every (key, item) in the order in which they finish.

    If a worker dies, another one does its task. Results are passed on, and released by the cluster, as they arrive. Without a client the
    tasks are done here, one after the other.
    """
    if client is None:
        for key, item in items:
            try:
                result, why = task(item), ""
            except Exception as error:  # as on a cluster: the other arms go on
                result, why = None, f"{type(error).__name__}: {error}"
            yield key, result, why
        return
    run = uuid.uuid4().hex[:12]  # a cluster may still hold the results of an earlier run under the same names
    futures = {client.submit(task, item, key=f"{key}-{run}"): key for key, item in items}
    for future in as_completed(list(futures)):
        key = futures.pop(future)
        try:
            yield key, future.result(), ""
        except KilledWorker as error:
            yield (
                key,
                None,
                f"{ALLOWED_DEATHS + 1} workers died over it, the last at {getattr(error.last_worker, 'address', '?')}",
            )
        except Exception as error:  # whatever the cluster answers, the other arms go on
            yield key, None, f"{type(error).__name__}: {error}"
        finally:
            future.release()
