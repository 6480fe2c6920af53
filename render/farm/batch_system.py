"""Workers that are jobs of a batch system, described by a configuration file of dask-jobqueue."""

from __future__ import annotations

import inspect
import os
import shlex
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from disk import PathLike
from disk.plain_file import read_text
from disk.quantities import JOB_COUNT, JOB_MEMORY
from render.farm.dask_settings import NO_DASHBOARD, ClusterError, own_certificates
from render.farm.submissions import Submissions, watched_cluster, watched_job

if TYPE_CHECKING:
    from dask_jobqueue.core import JobQueueCluster
    from distributed import Security

# Classes of dask-jobqueue by the name of the section in its configuration file.
_SYSTEMS = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "sge": "SGECluster",
    "lsf": "LSFCluster",
    "moab": "MoabCluster",
    "oar": "OARCluster",
    "htcondor": "HTCondorCluster",
}
_START_S = 600  # after which a job ends whose workers have not started; dask-jobqueue: 60 s
_ENCRYPTED = (None, "tls", "tls://")


@contextmanager
def batch_cluster(
    file: PathLike, keys_folder: PathLike, submissions: Submissions | None = None
) -> Iterator[JobQueueCluster]:
    """The cluster that a configuration file of dask-jobqueue describes; no job is submitted yet.

    Connections are encrypted with certificates of this run, unless the file says ``protocol: tcp://``. Jobs
    do not import modules from the folder that they are started in.

    Parameters
    ----------
    keys_folder : folder for the certificates, which all machines see. No other user can read them, and they
        are deleted at the end.
    submissions : notes which jobs the batch system takes. A refused one is submitted again every minute if it
        has taken another one.

    Raises
    ------
    ClusterError : the file is missing or not YAML, does not have exactly one system, or has unknown keys or
        values that do not make a job.
    """
    cls, given = _checked_cluster_file(file)
    folder = given.pop("shared_temp_directory", None) or keys_folder
    job_cls = watched_job(cls.job_cls, submissions or Submissions())  # type: ignore[attr-defined]
    defaults = {"python": f"{shlex.quote(sys.executable)} -P", "death_timeout": _START_S}
    options: dict[str, Any] = {**defaults, **given}
    if not _shows_pages(options):
        options["scheduler_options"] = NO_DASHBOARD | (options.get("scheduler_options") or {})
    with ExitStack() as stack:
        if options.get("protocol") in _ENCRYPTED and "security" not in options:
            place = Path(os.path.expandvars(folder)).expanduser().absolute()
            keys = stack.enter_context(_keys(file, place))
            options |= {"protocol": "tls://", "security": keys}
        try:
            cluster: JobQueueCluster = watched_cluster(cls)(**options, job_cls=job_cls)
            stack.enter_context(cluster)
            cluster.job_script()
        except (OSError, RuntimeError) as error:  # of the scheduler
            raise ClusterError(f"{file}: {' '.join(str(error).split())}") from None
        except Exception as error:  # of any class: dask-jobqueue uses the values of the file unchecked
            what = " ".join(str(error).split()) or type(error).__name__
            raise ClusterError(f"{file} does not describe a job ({what}): correct its values") from None
        yield cluster


def check_cluster_file(file: PathLike) -> bool:
    """Check a file without starting anything.

    Returns
    -------
    Whether it asks for Dask's web pages, by a ``dashboard_address`` of the scheduler.

    Raises
    ------
    ClusterError : as in `batch_cluster`.
    """
    return _shows_pages(_checked_cluster_file(file)[1])


def _shows_pages(options: dict[str, Any]) -> bool:
    return "dashboard_address" in (options.get("scheduler_options") or {})


@contextmanager
def _keys(file: PathLike, folder: Path) -> Iterator[Security]:
    """Certificates of this run as files, which job scripts can name."""
    from distributed import Security

    if shlex.quote(str(folder)) != str(folder):
        raise ClusterError(
            f"job scripts cannot name the folder {folder}, in which the keys of this run would lie: give a "
            f"folder without spaces in its name, which all machines see, as shared-temp-directory in {file}"
        )
    made = own_certificates()
    with TemporaryDirectory(prefix=".keys-", dir=folder) as private:  # of mode 0700
        certificate, key = Path(private, "certificate.pem"), Path(private, "key.pem")
        certificate.write_text(made.tls_ca_file)
        key.touch(mode=0o600)
        key.write_text(made.tls_worker_key)
        roles = ("client", "scheduler", "worker")
        yield Security(
            require_encryption=True,
            tls_ca_file=str(certificate),
            **{f"tls_{role}_cert": str(certificate) for role in roles},
            **{f"tls_{role}_key": str(key) for role in roles},
        )


def _checked_cluster_file(file: PathLike) -> tuple[type, dict[str, Any]]:
    """Cluster class and options from a configuration file of dask-jobqueue."""
    system, options = _read_cluster_file(file)
    cls: type = getattr(import_module("dask_jobqueue"), _SYSTEMS[system])
    known = _known_options(cls)
    unknown = sorted(set(options) - known)
    if unknown:
        raise ClusterError(
            f"{file}: unknown key {unknown[0]} of jobqueue.{system}; known keys are "
            + ", ".join(sorted(known))
        )
    return cls, options


def _read_cluster_file(file: PathLike) -> tuple[str, dict[str, Any]]:
    import yaml

    try:
        content = yaml.safe_load(read_text(Path(file)))
    except OSError as error:
        raise ClusterError(f"{file} cannot be read: {error.strerror}") from None
    except UnicodeError as error:
        raise ClusterError(f"{file} cannot be read: {error}") from None
    except Exception as error:  # of any class: PyYAML reads dates, numbers and truth values without care
        raise ClusterError(f"{file} is not YAML: {' '.join(str(error).split())}") from None
    sections = content.get("jobqueue") if isinstance(content, dict) else None
    if not isinstance(sections, dict) or len(sections) != 1 or not set(sections) <= set(_SYSTEMS):
        raise ClusterError(
            f"{file} must have one section jobqueue.<system>, with <system> one of {', '.join(_SYSTEMS)}"
        )
    ((system, options),) = sections.items()
    if not isinstance(options, dict):
        raise ClusterError(f"{file}: jobqueue.{system} must hold keys like cores, memory and walltime")
    for key in ("shared-temp-directory", "shared_temp_directory"):
        if not isinstance(options.get(key), str | None):
            raise ClusterError(f"{file}: jobqueue.{system}.{key} must be the name of a folder")
    if not isinstance(options.get("scheduler-options", options.get("scheduler_options")), dict | None):
        raise ClusterError(f"{file}: jobqueue.{system}.scheduler-options must hold keys, like host")
    if not isinstance(options.get("security"), bool | None):
        raise ClusterError(f"{file}: jobqueue.{system}.security must be true, or left out")
    missing = [key for key in ("cores", "memory") if options.get(key) is None]
    if missing:
        raise ClusterError(f"{file}: jobqueue.{system} needs {' and '.join(missing)} (of one job)")
    for key, problem in _impossible_numbers(options):
        raise ClusterError(f"{file}: jobqueue.{system}.{key} {problem}")
    named = {str(key).replace("-", "_"): value for key, value in options.items()}
    if "name" in named:  # the classes of dask-jobqueue call this key job_name
        named["job_name"] = named.pop("name")
    return system, named


def _impossible_numbers(options: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Keys whose numbers are out of bounds, and why; what is no number is for dask-jobqueue to say."""
    from dask.utils import parse_bytes

    for key in ("cores", "processes"):
        value = options.get(key)
        if isinstance(value, int | float) and (problem := JOB_COUNT.problem(value)):
            yield key, problem
    with suppress(ValueError, ArithmeticError, AttributeError, TypeError):
        if problem := JOB_MEMORY.problem(parse_bytes(options["memory"])):
            yield "memory", problem


def _known_options(cls: type) -> set[str]:
    """Names of the parameters of a cluster class, of its job class, and of the base classes of both."""
    classes = [*cls.__mro__, *cls.job_cls.__mro__]  # type: ignore[attr-defined]
    return {
        name
        for each in classes
        if each is not object and "__init__" in vars(each)
        for name, parameter in inspect.signature(each.__init__).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY) and name != "self"
    }
