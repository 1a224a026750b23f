"""The one publish path: an output appears whole under its name, or not at all.

Work goes into a private folder beside the target (`.<name>.hrt-XXXXXXXX/`, same file system). When it is done the
file is re-opened and checked, synced, stale side-cars of the old file are deleted, and `os.replace` puts the new one
in its place. The folder holds a locked file as long as its process lives, so that the next run can tell a folder left
by a killed process (the lock is free) from one in use, and sweep it. Where the file system has no locks nothing is
swept.

A target that is a symbolic link is replaced by the new file; what the link points to is left alone.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hrt_cli.errors import OutputError

_LOCK = ".lock"
_RANDOM_CHARS = 8
"""At the end of the names of work folders."""
_MAX_NAME_BYTES = 255
_STALE_SIDECARS = (".msk", ".aux.xml", ".ovr", ".ovr.msk", ".msk.ovr")


@contextmanager
def publishing(target: Path, check: Callable[[Path], object]) -> Iterator[Path]:
    """Yield a path to write; on a clean exit publish it as `target`.

    Other files written beside the yielded path (a `.qml` style) are published with it, before it.

    Parameters
    ----------
    target : Path
        Where the finished file goes. Its folder must exist.
    check : callable
        Called with the written path; raises if the file is not what was meant to be written. Not optional:
        GDAL can lose data on `close()` without raising when the disk is full.

    Raises
    ------
    OutputError
        The folder cannot be written, the disk is full, or `check` found the file damaged.
    """
    try:
        with _work_folder(target) as work:
            draft = work / target.name
            yield draft
            check(draft)
            _replace(draft, target, work)
    except OSError as error:
        raise output_error(target, error) from error


@contextmanager
def publishing_folder(target: Path, check: Callable[[Path], object]) -> Iterator[Path]:
    """Yield an empty folder to fill; on a clean exit publish it as `target`, in place of the folder that stands there.

    Parameters
    ----------
    target : Path
        Where the finished folder goes. The folder that it lies in must exist.
    check : callable
        As in `publishing`.

    Raises
    ------
    OutputError
        As `publishing`.
    """
    try:
        with _work_folder(target) as work:
            draft = work / target.name
            draft.mkdir()
            yield draft
            check(draft)
            for path in sorted(draft.iterdir()):
                with open(path, "rb+") as file:
                    os.fsync(file.fileno())
            if target.exists():
                os.replace(target, work / f"{target.name}.old")
            os.replace(draft, target)
            _sync_folder(target.parent)
    except OSError as error:
        raise output_error(target, error) from error


def output_error(target: Path, error: OSError) -> OutputError:
    """Say in one line why `target` could not be written."""
    if error.errno == errno.ENOSPC:
        return OutputError(f"{target}: No space left on device; nothing was changed")
    return OutputError(f"{target}: cannot be written: {error.strerror or error}")


def sweep(target: Path) -> None:
    """Delete work folders for `target` that a killed process left behind; leave those in use alone."""
    for work in target.parent.glob(f"{_glob_escaped(_work_prefix(target))}{'?' * _RANDOM_CHARS}"):
        # A process killed at its first or last step leaves a folder without a lock: then it is made here, and is free.
        with suppress(OSError), open(work / _LOCK, "ab") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(work, ignore_errors=True)


def check_target(target: Path, inputs: list[Path]) -> None:
    """Refuse an output that cannot be published: found out before the long work, not after it.

    Raises
    ------
    OutputError
        The target is an input (also by link), is a folder or a device, has too long a name, or lies in a folder
        that is absent or read-only.
    """
    for path in inputs:
        if target.exists() and path.exists() and os.path.samefile(target, path):
            raise OutputError(f"{target}: the output is also an input ({path}); choose another name")
    if target.is_dir():
        raise OutputError(f"{target}: is a folder; give the name of a file")
    if (target.exists() and not target.is_file()) or target.parent.resolve() == Path("/dev"):
        raise OutputError(f"{target}: is a device or a pipe; give the name of a file")
    if len(os.fsencode(_work_prefix(target))) + _RANDOM_CHARS > _MAX_NAME_BYTES:
        raise OutputError(f"{target}: the name is too long; choose a shorter one")
    if not target.parent.is_dir():
        raise OutputError(f"{target}: the folder {target.parent} does not exist; make it first")
    if not os.access(target.parent, os.R_OK | os.W_OK | os.X_OK):
        raise OutputError(f"{target}: the folder {target.parent} cannot be written")


@contextmanager
def _work_folder(target: Path) -> Iterator[Path]:
    """Make a locked work folder for `target`, after sweeping dead ones; delete it in the end, whatever happens."""
    with ExitStack() as stack:
        with _alone_in(target.parent):
            sweep(target)
            work = _unused(target)
            # Before the folder is there: a signal may come at any moment.
            stack.callback(shutil.rmtree, work, ignore_errors=True)
            # The files inside are created with the user's umask.
            work.mkdir(0o700)
            lock = stack.enter_context(open(work / _LOCK, "ab"))
            with suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield work


def _unused(target: Path) -> Path:
    """Name a work folder that does not exist, in a folder in which no other process makes one now."""
    while True:
        work = target.parent / f"{_work_prefix(target)}{os.urandom(_RANDOM_CHARS // 2).hex()}"
        if not os.path.lexists(work):
            return work


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Let one process at a time sweep and make work folders in `folder`: none is swept before it is locked."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _work_prefix(target: Path) -> str:
    return f".{target.name}.hrt-"


def _replace(draft: Path, target: Path, work: Path) -> None:
    companions = sorted(p for p in work.iterdir() if p.name not in (_LOCK, draft.name))
    for path in (*companions, draft):
        with open(path, "rb+") as file:
            os.fsync(file.fileno())
    for suffix in _STALE_SIDECARS:
        target.with_name(target.name + suffix).unlink(missing_ok=True)
    for path in companions:
        os.replace(path, target.parent / path.name)
    os.replace(draft, target)
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _glob_escaped(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)
