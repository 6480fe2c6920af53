"""The address of a running Dask scheduler. It is tried before Dask uses it, which may wait for ever."""

from __future__ import annotations

import asyncio
import re
import socket
import ssl
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from render.farm.dask_settings import ClusterError

CONNECT_S = 10
_ADDRESS = re.compile(r"(?:(tcp|tls)://)?([\w.-]+|\[[\w:.%]+\]):([0-9]{1,5})")  # [IPv6]:port
_LAST_PORT = 65535
_PAUSE_S = 0.2
_GREETING = 8  # bytes: a scheduler says first how long its first message is
_LONGEST_GREETING = 2**16
_OTHERS = ("Worker", "Nanny")  # that answer like a scheduler, but have another address


def check_address(scheduler: str) -> None:
    """Check the form of an address.

    Raises
    ------
    ClusterError : it is not like ``tcp://host:8786``.
    """
    match = _ADDRESS.fullmatch(scheduler)
    if match is None or int(match[3]) > _LAST_PORT:
        raise ClusterError(f"{scheduler!r} is no address of a scheduler: give one like tcp://host:8786")


def check_answer(scheduler: str) -> None:
    """Connect to an address, with Dask's own certificates where it begins with ``tls://``, and ask who it is.

    Raises
    ------
    ClusterError : no Dask scheduler answers, or the certificates are missing.
    """
    context = _certificates(scheduler)
    end = time.monotonic() + CONNECT_S
    while True:
        try:
            greeting = _greeting(scheduler, context)
            break
        except (OSError, ValueError) as error:  # ValueError: a name that no host can have
            if not isinstance(error, ConnectionRefusedError) or time.monotonic() > end:
                raise _no_scheduler(scheduler, " ".join(str(error).split())) from None
            time.sleep(_PAUSE_S)  # the scheduler may be starting
    if not 0 < int.from_bytes(greeting, "little") < _LONGEST_GREETING:
        raise _no_scheduler(scheduler, "another program answers")
    try:
        with ThreadPoolExecutor(1) as pool:  # a notebook has a loop of its own in this thread
            kind = pool.submit(asyncio.run, _kind(scheduler)).result()
    except TimeoutError:
        raise _no_scheduler(scheduler, f"no answer within {CONNECT_S} s") from None
    except Exception as error:  # of any kind: Dask reads what another program says
        what = " ".join(str(error).split()) or type(error).__name__
        raise _no_scheduler(scheduler, f"another program answers: {what}") from None
    if kind in _OTHERS:
        raise _no_scheduler(scheduler, f"this is the address of a Dask {kind.lower()}")


async def _kind(scheduler: str) -> str:
    """What of Dask answers: ``Scheduler``, ``Worker``, ``Nanny``."""
    from distributed import Security
    from distributed.comm import connect

    async def asked() -> str:
        comm = await connect(scheduler, CONNECT_S, **Security().get_connection_args("client"))
        try:
            await comm.write({"op": "identity", "reply": True})
            return str((await comm.read())["type"])
        finally:
            comm.abort()

    return await asyncio.wait_for(asked(), CONNECT_S)


def _greeting(scheduler: str, context: ssl.SSLContext | None) -> bytes:
    _, host, port = _ADDRESS.fullmatch(scheduler).groups()  # type: ignore[union-attr]
    plain = socket.create_connection((host.strip("[]"), int(port)), CONNECT_S)
    with plain, context.wrap_socket(plain) if context is not None else plain as connection:
        return connection.recv(_GREETING)


def _certificates(scheduler: str) -> ssl.SSLContext | None:
    """TLS certificates of Dask's settings; None for a connection without TLS."""
    from distributed import Security

    if not scheduler.startswith("tls:"):
        return None
    security = Security()
    files = (security.tls_ca_file, security.tls_client_cert, security.tls_client_key)
    try:
        for file in files:  # OpenSSL does not say which one it cannot read
            if file is not None and "\n" not in file:  # otherwise it is the certificate itself
                Path(file).open("rb").close()
        context: ssl.SSLContext | None = security.get_connection_args("client")["ssl_context"]
    except OSError as error:  # a file is missing or damaged
        why = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        raise ClusterError(
            f"the certificates of Dask's setting distributed.comm.tls cannot be used: {why}"
        ) from None
    if context is None:
        raise ClusterError(
            f"{scheduler} wants a certificate: name ca-file, client.cert and client.key in Dask's setting "
            "distributed.comm.tls"
        )
    return context


def _no_scheduler(scheduler: str, why: str) -> ClusterError:
    return ClusterError(
        f"no Dask scheduler answers at {scheduler} ({why}): start one with dask scheduler, and workers with "
        "dask worker; where it wants TLS, its address begins with tls://"
    )
