"""Runs of ``night-render``: how to start, to watch and to disturb them, and what they leave."""

import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress

import psutil
import pytest
from night_commands import words

from disk import sha256_of
from scenegen import open_dataset

SETTINGS = ["--error", "0.05", "--device", "cpu"]  # of the shared renders (tests/conftest.py)


def render_scenes(root, *, only=None, **given):
    """Render scenes of a dataset in this process, which needs no workers.

    Parameters
    ----------
    given : as of `render.settings.settings_for`.
    """
    from render.rendering import Renderer
    from render.settings import settings_for

    dataset = open_dataset(root)
    renderer = Renderer(dataset, settings_for(dataset, {"device": "cpu"} | given))
    for scene_id in only or dataset.ids():
        renderer.render(scene_id)


def start_render(data, *arguments, **options):
    """The command with these settings as a process of its own, with local workers unless told otherwise."""
    return subprocess.Popen(
        words("night-render", data, *SETTINGS, *arguments),
        **options,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def results(data):
    """Hash of what a run leaves but its log, its locks, the hashes it remembers and temporary folders."""
    files = [data / "dataset.json", data / "renders/rendering.json", *sorted(data.glob("renders/[0-9]*/*"))]
    return {file.relative_to(data).as_posix(): sha256_of(file) for file in files if file.is_file()}


def run_log(data):
    return (data / "renders" / "night-render.log").read_text()


def workers_of(process):
    """The processes of a command that render (not those that only keep count of resources)."""
    try:
        children = psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
    return [child for child in children if is_worker(child)]


def is_worker(process):
    """Whether a process is alive, and one that renders."""
    try:
        return "spawn_main" in " ".join(process.cmdline())
    except psutil.NoSuchProcess:
        return False


def claim_of(data, scene_id):
    """The file that counts attempts at a scene while it is being rendered."""
    return data / "renders" / ".claims" / scene_id


def begun(claim, attempt=1):
    """Whether a worker is at its first, second, ... attempt at a scene."""
    try:
        return claim.read_text().endswith(f": {attempt}}}")
    except FileNotFoundError:
        return False


def worker_at(workers, claim):
    """The one of these processes that has a scene claimed; None if none has."""
    for worker in workers:
        with suppress(psutil.NoSuchProcess):
            if any(file.path == str(claim) for file in worker.open_files()):
                return worker
    return None


def killed_in(process, claim, attempt=1):
    """Whether a worker was at an attempt at a scene; if so, it is killed. To be called until it is true.

    The workers are listed first, which takes longest: a scene takes only tenths of a second.
    """
    workers = workers_of(process)
    worker = worker_at(workers, claim) if begun(claim, attempt) else None
    if worker is None:
        return False
    worker.kill()
    psutil.wait_procs([worker], timeout=300)  # so that it is not listed any more
    return True


def wait_for(condition, seconds=600):
    """Wait for something to happen; the limit only keeps a broken test from hanging."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return
        time.sleep(0.01)
    pytest.fail("it did not happen")


@contextmanager
def meanwhile(action):
    """Do something in another thread while the block runs; its error is raised after the block."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(action)
        yield
        future.result()
