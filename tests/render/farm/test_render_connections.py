"""Schedulers and workers that a run starts take nobody else's connection; a scheduler with TLS is joined."""

import asyncio
import os
import re
import socket
import stat
import sys
import tempfile
import urllib.error
import urllib.request
from contextlib import suppress

import pytest
from dask_processes import dask_processes
from night_commands import night_here
from render_runs import results

from render.farm.batch_system import batch_cluster
from render.farm.clusters import connected
from render.farm.dask_settings import ClusterError, own_certificates

WAIT_S = 2  # for an answer that must not come
ANSWER_S = 60  # for one that must


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """Connected to a scheduler and one worker of this machine, as of a run without --cluster."""
    tmp_path_factory.getbasetemp()  # a run changes the place of temporary files
    with connected(workers=1, scheduler=None, cluster_file=None, device="cpu") as made:
        yield made


def servers(client):
    """Addresses (host, port) of the scheduler, its workers and their nannies."""
    info = client.scheduler_info()
    addresses = [info["address"], *info["workers"], *(each["nanny"] for each in info["workers"].values())]
    assert len(addresses) == 3
    return [re.fullmatch(r"tls://(127\.0\.0\.1):(\d+)", address).groups() for address in addresses]


async def submitted(address, security, timeout_s):
    """Send a Dask server an order, as its clients do; returns the answer."""
    from distributed.comm import connect

    connection = await connect(address, timeout=timeout_s, **security.get_connection_args("client"))
    try:
        await connection.write({"op": "identity", "reply": True})
        return await connection.read()
    finally:
        await connection.close()


def test_whoever_has_no_certificate_of_the_run_cannot_give_orders(client):
    from distributed import Client, Security

    for host, port in servers(client):
        with pytest.raises(OSError):
            asyncio.run(submitted(f"tcp://{host}:{port}", Security(), WAIT_S))
        with pytest.raises(OSError, match="certificate"):
            asyncio.run(submitted(f"tls://{host}:{port}", own_certificates(), ANSWER_S))
    with pytest.raises(OSError):
        Client(f"tcp://{host}:{port}", timeout=WAIT_S, set_as_default=False)
    assert client.submit(os.getpid).result() != os.getpid()


def test_bytes_that_are_no_handshake_are_not_answered_and_disturb_nobody(client):
    for host, port in servers(client):
        with socket.create_connection((host, int(port)), ANSWER_S) as connection:
            connection.sendall(b"x" * 1000)
            with suppress(ConnectionResetError):
                assert b"identity" not in connection.recv(1000)
    silent = [socket.create_connection((host, int(port)), WAIT_S) for host, port in servers(client)]
    assert client.submit(sum, (1, 2)).result() == 3
    for connection in silent:
        connection.close()


def test_a_run_shows_no_web_pages(client):
    info = client.scheduler_info()
    for each in (info, *info["workers"].values()):
        for page in ("", "status", "info/main/workers.html", "json/counts.json", "metrics", "health"):
            with pytest.raises(urllib.error.HTTPError, match="404") as missing:
                urllib.request.urlopen(
                    f"http://127.0.0.1:{each['services']['dashboard']}/{page}", timeout=ANSWER_S
                )
            missing.value.close()


def test_no_other_user_can_put_modules_into_folders_that_dask_imports_from(client):
    assert stat.S_IMODE(os.stat(tempfile.gettempdir()).st_mode) == 0o700  # noqa: PTH116
    for path in (*sys.path, *client.submit(lambda: __import__("sys").path).result()):
        if "dask" in path:
            assert path.startswith(tempfile.gettempdir())


def test_the_keys_of_batch_jobs_are_files_of_this_user_that_go_with_the_cluster(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file, keys = tmp_path / "cluster.yaml", tmp_path / "keys"
    keys.mkdir()
    file.write_text("jobqueue:\n  slurm:\n    cores: 1\n    memory: 4GB\n    interface: lo\n")
    with batch_cluster(file, keys) as cluster:
        script = cluster.job_script()
        assert cluster.scheduler_address.startswith("tls://127.0.0.1:")
        (folder,) = keys.iterdir()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert stat.S_IMODE((folder / "key.pem").stat().st_mode) == 0o600
        assert f"--tls-key {folder / 'key.pem'}" in script
        assert "PRIVATE" not in script
    assert list(keys.iterdir()) == []
    spaced = tmp_path / "my keys"
    with pytest.raises(ClusterError, match="shared-temp-directory"), batch_cluster(file, spaced):
        pass
    file.write_text(file.read_text() + "    protocol: tcp://\n")
    with batch_cluster(file, keys) as cluster:
        assert cluster.scheduler_address.startswith("tcp://")
        assert "--tls" not in cluster.job_script()


@pytest.mark.long
def test_a_scheduler_with_tls_is_joined_with_the_certificates_of_dask_s_settings(
    tmp_path, three_missing, seven_renders
):
    import dask

    made = own_certificates()
    (tmp_path / "certificate.pem").write_text(made.tls_ca_file)
    (tmp_path / "key.pem").write_text(made.tls_worker_key)
    files = ["--tls-ca-file", "--tls-cert", tmp_path / "certificate.pem", "--tls-key", tmp_path / "key.pem"]
    files.insert(1, tmp_path / "certificate.pem")
    with dask_processes(tmp_path, ["--no-nanny", "--nthreads", "1", *files], scheduler=files) as (address, _):
        assert address.startswith("tls://")
        done = night_here("night-render", three_missing, "--cluster", address)
        assert done.returncode == 2
        assert f"{address} wants a certificate" in done.stderr
        done = night_here("night-render", three_missing, "--cluster", address.replace("tls", "tcp"))
        assert done.returncode == 2
        assert "no Dask scheduler answers" in done.stderr
        files = {"ca-file": "certificate.pem", "client.cert": "certificate.pem", "client.key": "key.pem"}
        given = {f"distributed.comm.tls.{name}": str(tmp_path / file) for name, file in files.items()}
        with dask.config.set(given):
            done = night_here("night-render", three_missing, "--cluster", address)
    assert done.returncode == 0, done.stderr
    assert results(three_missing) == results(seven_renders)
