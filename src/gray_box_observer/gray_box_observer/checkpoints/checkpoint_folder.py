"""The one folder of checkpoints, whatever path a parameter or a service asks for."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from gray_box_observer.errors import ConfigurationError

MOST_PARTS = 64
"""Folders in a path; nobody means more, and the file system would not bear many more."""

LONGEST_NAME = 200
"""Bytes of a name: a file that is not whole yet has a longer one, and 255 is the limit of most file
systems."""


SUFFIX = '.safetensors'
"""What the name of a checkpoint ends with: no name that anything else on the machine obeys does."""


class CheckpointFolder:
    """Turns the parameter ``checkpoint.path`` into a file in the declared folder, or refuses.

    What is given when the node starts (launch file, YAML, command line) is the word of whoever may
    start processes, and is trusted: an absolute path then declares its own folder. What comes
    later, over the network, has to stay there, in a folder that exists and below none whose name
    begins with a dot. Only the folders given at the start are made where they are missing.
    Whoever names it, a checkpoint ends in ``.safetensors`` and is no dot file.

    Args:
        folder: the parameter ``checkpoint.folder``; empty: the folder of an absolute path, else the
            default.
        path: the parameter ``checkpoint.path`` as given at the start.
        default: folder where neither says one.

    Raises:
        ConfigurationError: the path does not lie in the folder.
    """

    def __init__(self, folder: str, path: str, default: Path) -> None:
        own = Path(path).parent if not folder and Path(path).is_absolute() else default
        folder_path = Path(folder).expanduser() if folder else own
        self.folder = Path(
            os.path.normpath(folder_path.absolute())
        )  # as it was given: no link is followed
        self._configured_path = None if folder else path
        self._start_folder = self._file_within(path).parent

    def file(self, path: str) -> Path:
        """Return the file that a path means: relative to the folder, or absolute and inside it.

        Raises:
            ConfigurationError: it is no file name, or leads out of the folder, be it by ``..`` or
                by a symbolic link; or it names a folder that is not there and was not given at
                the start.
        """
        file = self._file_within(path)
        self._check_parent(path, file.parent)
        return file

    def _file_within(self, path: str) -> Path:
        """Return the file that a path means, be its folder there or still to be made."""
        requested_file = Path(path)
        if not requested_file.name or not path.isprintable():
            raise ConfigurationError(f'checkpoint.path must be the name of a file, got {path!r}')
        if requested_file.is_absolute() and path == self._configured_path:
            _check_name(path, (requested_file.name,))
            return requested_file
        if len(requested_file.parts) > MOST_PARTS or any(
            len(part.encode()) > LONGEST_NAME for part in requested_file.parts
        ):
            raise ConfigurationError(
                f'checkpoint.path must not be deeper than {MOST_PARTS} folders or hold names of '
                'more than '
                f'{LONGEST_NAME} bytes, got {path[:40]!r}...'
            )
        if '..' in requested_file.parts:
            raise ConfigurationError(
                f"checkpoint.path must not hold '..', got {path!r}: give a path in {self.folder}"
            )
        file = self.folder / requested_file  # an absolute one stays what it is
        try:
            real_file, real_folder = file.resolve(), self.folder.resolve()
            with suppress(FileNotFoundError):
                file.parent.stat()  # from Python 3.13 on, `resolve` passes over a loop of links
        except (OSError, RuntimeError) as error:  # a loop of links; a name that is too long
            raise ConfigurationError(
                f'checkpoint.path {path!r} cannot be followed: {error}'
            ) from error
        if not real_file.is_relative_to(real_folder):
            raise ConfigurationError(
                f'checkpoint.path {path!r} leads out of {self.folder}: '
                'give a path in there, or another checkpoint.folder when the node starts'
            )
        _check_name(path, (*real_file.relative_to(real_folder).parts, requested_file.name))
        return file

    def _check_parent(self, path: str, parent: Path) -> None:
        """Refuse a folder that would have to be made, unless it was given at the start."""
        if parent in (self._start_folder, self.folder) or parent.is_dir():
            return
        raise ConfigurationError(
            f'checkpoint.path {path!r} names a folder that is not there: make {parent} first; only '
            'folders given when the node starts are made'
        )


def _check_name(path: str, parts: tuple[str, ...]) -> None:
    """Refuse a name that another program may obey: a start-up file, a key, a settings folder."""
    hidden_part = next((part for part in parts if part.startswith('.')), None)
    if hidden_part is not None:
        raise ConfigurationError(
            f"checkpoint.path must hold no name that begins with '.', got {path!r}"
        )
    if not parts[-1].endswith(SUFFIX):
        raise ConfigurationError(
            f'checkpoint.path must end in {SUFFIX}, got {path!r}: no other file is written'
        )


def default_folder(node: str) -> Path:
    """Return a node's default checkpoint file: in ROS_HOME (``~/.ros``), by its full name.

    Args:
        node: its fully qualified name, so that two nodes in two namespaces do not overwrite each
            other's.
    """
    try:
        home = Path(os.environ.get('ROS_HOME') or '~/.ros').expanduser()
    except RuntimeError:  # a user without a home
        home = Path.cwd()
    return home / node.strip('/')
