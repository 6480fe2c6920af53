"""Writers of whole files and folders that are killed at a chosen point, and what they leave."""

import itertools
import os
import signal
import sys

from disk import remove_leftovers, whole_folder, whole_writing, write_text

# The calls that may change the disk or a lock, of which Python tells its audit hooks.
CHANGES = frozenset({"os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.chmod"})
EVENTS = CHANGES | {"open", "os.scandir", "os.listdir", "ctypes.dlsym", "fcntl.flock"}


def write_folder(path, texts):
    """Write a whole folder of files; the names may have a folder in them."""
    with whole_folder(path) as partial:
        for name, text in texts.items():
            (partial / name).parent.mkdir(exist_ok=True)
            (partial / name).write_text(text)


FOLDERS = ({"a": "old", "figures/b": "old"}, {"a": "new", "clouds/c": "new"})
# By kind: how to write it, an old and a new one. In two steps: as on file systems that cannot exchange names.
KINDS = {
    "file": (write_text, "old", "new"),
    "folder": (write_folder, *FOLDERS),
    "folder in two steps": (write_folder, *FOLDERS),
}


def contents(path):
    """What is at a path: text of a file, texts by name of a folder's files, None where there is nothing."""
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.is_file())
        return {file.relative_to(path).as_posix(): file.read_text() for file in files}
    return path.read_text() if path.exists() else None


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


def after_each_kill(kind, path):
    """What is at `path` after a kill before each of `EVENTS`, and after the recovery that follows."""
    write, old, new = KINDS[kind]
    if kind == "folder in two steps":
        whole_writing.exchange = lambda *_: False
    for number in itertools.count():
        write(path, old)
        if not killed_before(number, EVENTS, lambda: write(path, new)):
            return
        left = contents(path)
        remove_leftovers(path.parent, path.name)  # what every command does at its start
        yield left, contents(path), names(path.parent)


def killed_before(number, events, action, below=""):
    """Whether `action`, in a copy of this process, was killed before its event `number` of `events`.

    Only events at paths in the folder `below` count. A copy of a small process takes milliseconds.
    """
    child = os.fork()
    if child == 0:
        calls = itertools.count()

        def kill(event, arguments):
            if event in events and str(arguments[0]).startswith(str(below)) and next(calls) == number:
                os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(kill)
        try:
            action()
        except BaseException:
            os._exit(1)
        os._exit(0)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in (0, -signal.SIGKILL)
    return status != 0
