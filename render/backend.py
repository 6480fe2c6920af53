"""The device that renders: sets the Mitsuba variant, and checks LLVM before it can abort the process."""

from __future__ import annotations

import logging
import os
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from disk import NightError
from disk.extras import MissingPackageError, need
from processes import silenced

Device = Literal["auto", "cpu", "cuda"]

# DrJit 1.5 aborts with LLVM 14 to 16 ("Cannot select: fminimum"); 19 works (docs/science/design.md, LLVM).
MINIMUM_LLVM = 19
INSTALL_LLVM = f"install LLVM {MINIMUM_LLVM} (Debian: apt install libllvm{MINIMUM_LLVM})"

STDERR = 2

log = logging.getLogger(__name__)


class BackendError(NightError):
    """The requested device cannot render on this machine."""


def select_variant(device: Device = "auto") -> str:
    """Set the Mitsuba variant for `device` and return its name.

    ``auto`` takes CUDA if there is a GPU, and LLVM on the CPU otherwise. An old LLVM aborts the process, and
    this abort cannot be caught, so the version is checked before the first kernel is compiled.

    Raises
    ------
    BackendError : there is no such device, or the engine or LLVM is missing or too old; the message says what
        to install.
    """
    try:
        need("render", ("drjit", "mitransient", "mitsuba"), "computing the light of scenes")
    except MissingPackageError as error:
        raise BackendError(str(error)) from None
    with silenced(STDERR):  # DrJit prints lines here that our messages below replace
        import drjit as dr

        has_cuda = device != "cpu" and bool(dr.has_backend(dr.JitBackend.CUDA))
        has_llvm = bool(dr.has_backend(dr.JitBackend.LLVM))
    if device == "cuda" and not has_cuda:
        raise BackendError("--device cuda: DrJit finds no CUDA GPU here; use --device cpu")
    if not has_cuda:
        _check_llvm(dr.detail.llvm_version() if has_llvm else None)

    import mitsuba as mi

    variant = "cuda_ad_mono" if has_cuda else "llvm_ad_mono"
    if mi.variant() != variant:
        mi.set_variant(variant)
        log.info("rendering with Mitsuba %s, variant %s", mi.__version__, variant)
    return variant


def drjit_threads() -> int:
    """Threads that DrJit computes with on the CPU."""
    import drjit as dr

    return int(dr.thread_count())


def gpu_ids() -> list[str]:
    """Names of the CUDA devices that this process may use, as in CUDA_VISIBLE_DEVICES; at least one."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is not None:
        return [entry.strip() for entry in chosen.split(",") if entry.strip()] or ["0"]
    count = len(list(Path("/proc/driver/nvidia/gpus").glob("*")))
    return [str(number) for number in range(max(1, count))]


def _check_llvm(version: tuple[int, ...] | None) -> None:
    forced = os.environ.get("DRJIT_LIBLLVM_PATH")
    where = f" at DRJIT_LIBLLVM_PATH={forced}" if forced else ""
    if version is None:
        raise BackendError(
            f"rendering on the CPU needs the LLVM library, and none was found{where}: {INSTALL_LLVM}"
        )
    if version[0] < MINIMUM_LLVM:
        found = ".".join(str(part) for part in version)
        raise BackendError(
            f"LLVM {found}{where} is too old for DrJit and would abort the process: {INSTALL_LLVM}"
        )


@cache
def versions() -> dict[str, str]:
    """Versions of NIGHT and of its renderers, for the files."""
    return {
        "generator": f"night-render {version('night-nlos')}",
        "mitsuba_version": version("mitsuba"),
        "mitransient_version": version("mitransient"),
    }
