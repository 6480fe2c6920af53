"""The address of a running Dask scheduler. It is tried before Dask uses it, which may wait for ever."""

from __future__ import annotations

import re
import socket
import ssl
import time

from render.farm.dask_settings import ClusterError

CONNECT_S = 10
_ADDRESS = re.compile(r"(?:(tcp|tls)://)?([\w.-]+|\[[\w:.%]+\]):([0-9]{1,5})")  # [IPv6]:port
_LAST_PORT = 65535
_PAUSE_S = 0.2
_GREETING = 8  # bytes: a scheduler says first how long its first message is
_LONGEST_GREETING = 2**16


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
    """Connect to an address, with Dask's own certificates where it begins with ``tls://``, and listen.

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
    try:
        context: ssl.SSLContext | None = Security().get_connection_args("client")["ssl_context"]
    except OSError as error:  # a file is missing or damaged
        raise ClusterError(
            f"the certificates of Dask's setting distributed.comm.tls cannot be used: {error}"
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
