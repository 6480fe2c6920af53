"""The start of workers: addresses that are no scheduler's, too few open files, workers that are killed."""

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress

import dask
import psutil
import pytest
from dask_processes import dask_processes
from distributed import Client
from night_commands import night_here
from render_runs import SETTINGS, is_worker

from render.farm.clusters import check_cluster, connected
from render.farm.dask_settings import ClusterError, dask_settings
from render.farm.scheduler_address import check_address, check_answer


@pytest.mark.parametrize(
    "address",
    [
        "",
        "nowhere",
        "tcp://",
        "tcp://host",
        "host:99999",
        "http://host:80",
        "tcp://[::1",
        ":::",
        "tcp://a b:1",
    ],
)
def test_what_is_no_address_of_a_scheduler_is_refused_before_anything_starts(address):
    with pytest.raises(ClusterError, match="is no address of a scheduler: give one like tcp://host:8786"):
        check_address(address)


@contextmanager
def answering(words):
    """Port of a program that is no scheduler and says `words` to whoever connects."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    connection.sendall(words)
                    open_connections.append(connection)

        open_connections = []
        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
        for connection in open_connections:
            connection.close()


@pytest.mark.parametrize(
    "words",
    [
        b"",
        b"HTTP/1.0 400 Bad Request\r\n\r\n",
        b"\xff" * 64,
        b"\x05",
        b"\x10" + bytes(7),
        b"\x01" + bytes(7) + b"xy",
    ],
    ids=repr,
)
def test_a_program_that_is_no_scheduler_is_not_waited_for(monkeypatch, words):
    monkeypatch.setattr("render.farm.scheduler_address.CONNECT_S", 0.3)
    with (
        answering(words) as port,
        pytest.raises(ClusterError, match=f"no Dask scheduler answers at .*{port}"),
    ):
        check_answer(f"tcp://127.0.0.1:{port}")


def test_the_address_of_a_worker_or_of_its_nanny_is_refused_by_name(render_cluster):
    with Client(render_cluster, set_as_default=False) as client:
        client.wait_for_workers(1)
        (address, worker), *_ = client.scheduler_info()["workers"].items()
    check_answer(render_cluster)
    for other, kind in ((address, "worker"), (worker["nanny"], "nanny")):
        with pytest.raises(ClusterError, match=f"this is the address of a Dask {kind}"):
            check_answer(other)


def test_an_empty_address_does_not_mean_this_machine(unrendered):
    with pytest.raises(ClusterError, match="'' is no address of a scheduler"):
        check_cluster("", None)
    done = night_here("night-render", unrendered, "--cluster", "")
    assert done.returncode == 2
    assert "'' is no address of a scheduler" in done.stderr


def test_a_missing_file_of_the_certificates_is_named(tmp_path):
    tls = {
        "ca-file": str(tmp_path / "ca.pem"),
        "client.cert": str(tmp_path / "ca.pem"),
        "client.key": "gone.pem",
    }
    (tmp_path / "ca.pem").touch()
    with (
        dask.config.set({f"distributed.comm.tls.{name}": file for name, file in tls.items()}),
        pytest.raises(ClusterError, match=r"gone\.pem: No such file"),
    ):
        check_answer("tls://127.0.0.1:1")


# Workers that do not start


NO_NIGHT = """
import sys

class NoNight:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in ("render", "scenegen", "itof", "disk", "processes"):
            raise ModuleNotFoundError(f"No module named {name!r}")

sys.meta_path.insert(0, NoNight())
"""


@pytest.mark.long
def test_workers_without_night_end_the_run_in_one_sentence(unrendered, tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(NO_NIGHT)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with dask_processes(tmp_path, ["--nthreads", "1"]) as (address, _):
        done = night_here("night-render", unrendered, *SETTINGS, "--cluster", address)
    assert done.returncode == 2
    sentence = (
        "the workers cannot take jobs (No module named 'render'): install the same NIGHT where they run"
    )
    assert sentence in done.stderr


def test_local_workers_have_dasks_own_settings_whatever_the_user_has_configured():
    terminate = "distributed.worker.memory.terminate"
    with dask.config.set({terminate: 0, "distributed.worker.preload": ["nowhere"]}):
        with dask_settings(is_local=True, shows_pages=False):
            assert dask.config.get(terminate) == 0.95
            assert dask.config.get("distributed.worker.preload") == []
            assert dask.config.get("distributed.scheduler.allowed-failures") == 0
        with dask_settings(is_local=False, shows_pages=False):
            assert dask.config.get(terminate) == 0
        assert dask.config.get(terminate) == 0


def test_a_file_of_dasks_configuration_that_is_not_yaml_is_named(tmp_path):
    (file := tmp_path / "dask.yaml").write_text("distributed: [")
    code = "from render.farm.clusters import check_cluster; check_cluster(None, None)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "DASK_CONFIG": str(file)},
        capture_output=True,
        text=True,
        check=False,
    )
    *_, last = done.stderr.splitlines()
    assert last.startswith(
        f"render.farm.dask_settings.ClusterError: A dask config file at '{file}' is malformed"
    )


def test_without_a_loopback_device_local_workers_are_refused():
    code = "from render.farm.local_workers import local_cluster; local_cluster(1, 'cpu')"
    alone = ["unshare", "--map-root-user", "--net"]
    if subprocess.run([*alone, "true"], check=False, capture_output=True).returncode:
        pytest.skip("needs the right to a network of its own (unshare)")
    done = subprocess.run(
        [*alone, sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert "turn its loopback device on" in done.stderr


def test_more_workers_than_files_may_be_open_are_refused(monkeypatch):
    monkeypatch.setattr("render.farm.local_workers.getrlimit", lambda _: (64, 64))
    with (
        pytest.raises(
            ClusterError, match=r"9 workers need 148 open files, .* 64 \(ulimit -n\): give --workers 2"
        ),
        connected(workers=9, scheduler=None, cluster_file=None, device="cpu"),
    ):
        pass


@contextmanager
def killing_first_workers(count, kill_one=psutil.Process.kill):
    """Kill the first `count` worker processes of this process as soon as they are there."""
    killed, stop = [], threading.Event()

    def kill():
        while not stop.is_set() and len(killed) < count:
            for child in psutil.Process().children():  # not the workers of a cluster of other tests
                if is_worker(child) and child.pid not in killed and len(killed) < count:
                    kill_one(child)
                    killed.append(child.pid)
            time.sleep(0.01)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        stop.set()
        thread.join()


@pytest.mark.long
@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.thorough), 2])
def test_a_worker_that_is_killed_while_it_starts_costs_one_retry(workers):
    with (
        killing_first_workers(1) as killed,
        connected(workers=workers, scheduler=None, cluster_file=None, device="cpu") as client,
    ):
        assert len(killed) == 1
        assert len(client.nthreads()) == workers
        assert client.submit(sum, (1, 2)).result() == 3


@pytest.mark.long
def test_workers_that_are_always_killed_while_they_start_end_the_run_in_one_sentence(unrendered):
    with killing_first_workers(100) as killed:
        done = night_here("night-render", unrendered, *SETTINGS, "--workers", 2)
    assert killed
    assert done.returncode == 2
    assert "Error: the worker processes did not start, at two attempts" in done.stderr.splitlines()[-1]
    assert not [child for child in psutil.Process().children() if is_worker(child)]


@pytest.mark.long
def test_workers_that_do_not_start_in_time_end_the_run_in_one_sentence(unrendered, monkeypatch):
    monkeypatch.setattr("render.farm.local_workers._START_S", 1)
    with killing_first_workers(100, psutil.Process.suspend) as suspended:
        done = night_here("night-render", unrendered, *SETTINGS, "--workers", 1)
    assert len(suspended) == 1
    assert done.returncode == 2
    assert "Error: the worker processes did not start, within 3 s: try fewer" in done.stderr.splitlines()[-1]
    assert not [child for child in psutil.Process().children() if is_worker(child)]
