"""The ``metadata.yaml`` of a rosbag2 folder: its files, and the text that Jazzy expects."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from gray_box_observer.bag import packed
from gray_box_observer.errors import BagError, InputError, brief
from gray_box_observer.safe_io.bounded_yaml import parse_yaml, read_yaml

METADATA_NAME = 'metadata.yaml'
METADATA_VERSION = 9
"""What rosbag2 of ROS 2 Jazzy writes."""

ENDINGS = ('.mcap', f'.mcap{packed.SUFFIX}')
"""Of the files of a bag."""

_PLAIN_NAME = re.compile(r'[A-Za-z_][\w.-]*\.mcap', re.ASCII)
_LARGEST_QOS_BYTES = 1 << 18
_NEVER_NS = (1 << 63) - 1
"""The starting time that rosbag2 gives to a bag without messages."""


@dataclass(frozen=True)
class TopicRecord:
    """One topic's part of the metadata."""

    name: str
    type_name: str
    qos_profiles: Sequence[Mapping[str, Any]]
    type_hash: str
    message_count: int


@dataclass(frozen=True)
class FileRecord:
    """One file's part of the metadata; times in nanoseconds since the epoch of the log times."""

    path: str
    start_ns: int
    end_ns: int
    message_count: int


@dataclass(frozen=True)
class ListedFile:
    """One file of a bag, with message count and first log time where ``metadata.yaml`` has them."""

    path: Path
    message_count: int | None = None
    start_ns: int | None = None


@dataclass(frozen=True)
class Listing:
    """The files of a bag in their order.

    Attributes:
        files: Those that are there.
        complaints: What is wrong with the folder; each is one line.
        custom_data: Free texts that travel with the bag.
    """

    files: tuple[ListedFile, ...]
    complaints: tuple[str, ...] = ()
    custom_data: Mapping[str, str] = field(default_factory=dict)


def list_files(path: Path) -> Listing:
    """The MCAP files of a bag, in their order.

    A folder whose ``metadata.yaml`` is lost or damaged is read file by file all the same, as
    ``ros2 bag reindex`` would do it.

    Args:
        path: A rosbag2 folder or a single MCAP file.

    Raises:
        BagError: There is no such path, or the folder is no rosbag2 bag in MCAP storage.
    """
    try:
        if path.is_file():
            return Listing((ListedFile(path),))
        if not path.exists():
            raise BagError(f'{path}: no such bag; expected a rosbag2 folder or an .mcap file')
        if not path.is_dir():
            raise BagError(f'{path} is neither a folder nor a regular file')
        try:
            information = _load(path / METADATA_NAME)
        except _MetadataError as error:
            return _found_files(path, str(error))
        return _listed_files(path, information)
    except (OSError, ValueError) as error:
        raise BagError(f'{path}: cannot be read: {_reason(error)}') from None


def conversion(path: Path) -> str:
    """The two lines that make a bag that is read of one that is not, on one."""
    output_options = '{output_bags: [{uri: NEW, storage_id: mcap, all: true}]}'
    return f"`echo '{output_options}' >to_mcap.yaml; ros2 bag convert -i {path} -o to_mcap.yaml`"


class _MetadataError(BagError):
    """There is no metadata, or nothing can be learnt from it."""


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _load(path: Path) -> Mapping[str, Any]:
    folder = path.parent
    if not path.is_file():
        raise _MetadataError(f'{folder} has no {METADATA_NAME}')
    if leads_out(path):
        raise _MetadataError(f'{path} is a link that leads out of the bag; it is not read')
    try:
        document = read_yaml(path)
    except InputError as error:
        raise _MetadataError(str(error)) from None
    information = (
        document.get('rosbag2_bagfile_information') if isinstance(document, dict) else None
    )
    if not isinstance(information, dict):
        raise _MetadataError(f"{path} has no 'rosbag2_bagfile_information'")
    if not _names(information):
        raise _MetadataError(f'{path} lists no files (relative_file_paths)')
    return information


def leads_out(path: Path) -> bool:
    """Whether a bag's file links outside its folder: a foreign bag could name any file."""
    return path.is_symlink() and not path.resolve().is_relative_to(path.parent.resolve())


def _names(information: Mapping[str, Any]) -> list[str]:
    """The file names that the metadata lists; empty if they are not listed as required."""
    names = information.get('relative_file_paths')
    return names if isinstance(names, list) and all(isinstance(name, str) for name in names) else []


def _found_files(folder: Path, complaint: str) -> Listing:
    """The MCAP files that lie in a folder, by the numbers in their names."""
    plain = {path.name for path in folder.glob('*.mcap')}
    candidates = [path for ending in ENDINGS for path in folder.glob(f'*{ending}')]
    # Whoever has unpacked a file may have kept the packed one.
    candidates = [
        p for p in candidates if p.name in plain or p.name.removesuffix(packed.SUFFIX) not in plain
    ]
    paths = sorted((p for p in candidates if p.is_file() and not leads_out(p)), key=_by_number)
    if not paths:
        raise BagError(
            f'{complaint}, so {folder} is no rosbag2 bag; expected one in MCAP storage, or an '
            '.mcap file'
        )
    return Listing(
        tuple(map(ListedFile, paths)),
        (
            f"{complaint}; its {len(paths)} .mcap files are read all the same ('ros2 bag reindex' "
            'makes a new one)',
        ),
    )


def _by_number(path: Path) -> tuple[str, int, str]:
    whole = path.name.removesuffix(packed.SUFFIX).removesuffix('.mcap')
    stem, _, number = whole.rpartition('_')
    is_number = number.isdecimal() and len(number) < 19
    return (stem, int(number), path.name) if is_number else (whole, -1, path.name)


def _listed_files(folder: Path, information: Mapping[str, Any]) -> Listing:
    storage = information.get('storage_identifier')
    if storage != 'mcap':
        raise BagError(
            f"{folder} is stored as {_word(storage)}, expected 'mcap'; {conversion(folder)} makes "
            'one'
        )
    mode = _word(information.get('compression_mode') or '').lower()
    form = _word(information.get('compression_format') or '').lower()
    if mode not in ("''", "'none'") and (mode not in ("'file'", "'message'") or form != "'zstd'"):
        raise BagError(
            f'{folder} is compressed by {mode}, {form}; expected none, or files or messages '
            'packed by zstd; '
            f'{conversion(folder)} makes one'
        )
    summaries = _told_of_files(information)
    # Old rosbag2 wrote the folder's own name in front; nothing outside the folder belongs to the
    # bag.
    paths = [
        _as_it_lies(folder / PurePosixPath(name).name)
        for name in dict.fromkeys(_names(information))
    ]
    missing_names = [path.name for path in paths if not path.is_file() or leads_out(path)]
    complaint = ''
    if missing_names:
        reason = (
            'leads out of it by a link and is not read'
            if leads_out(folder / missing_names[0])
            else 'is missing'
        )
        complaint = (
            f'{folder}: the file {brief(missing_names[0])}, listed in {METADATA_NAME}, {reason}'
        )
    if len(missing_names) > 1:
        complaint += f', and {len(missing_names) - 1} more'
    if len(missing_names) == len(paths):
        raise BagError(complaint)
    names = {
        path: path.name.removesuffix(packed.SUFFIX)
        for path in paths
        if path.name not in missing_names
    }
    files = tuple(
        ListedFile(path, *summaries.get(name, (None, None))) for path, name in names.items()
    )
    custom = information.get('custom_data')
    texts = custom.items() if isinstance(custom, dict) else ()
    custom_data = {
        key: text for key, text in texts if isinstance(key, str) and isinstance(text, str)
    }
    return Listing(files, (complaint,) if missing_names else (), custom_data)


def _as_it_lies(path: Path) -> Path:
    """The path of a listed file, or that of what it was unpacked to where only that is left."""
    unpacked_path = path.with_name(path.name.removesuffix(packed.SUFFIX))
    return path if path.is_file() or not unpacked_path.is_file() else unpacked_path


def _told_of_files(information: Mapping[str, Any]) -> dict[str, tuple[int | None, int | None]]:
    """Message count and starting time of each file by name, as far as the metadata is valid."""
    entries = information.get('files')
    summaries: dict[str, tuple[int | None, int | None]] = {}
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, dict) and isinstance(entry.get('path'), str):
            start = entry.get('starting_time')
            start_ns = start.get('nanoseconds_since_epoch') if isinstance(start, dict) else None
            name = PurePosixPath(entry['path']).name.removesuffix(packed.SUFFIX)
            summaries[name] = (_whole(entry.get('message_count')), _whole(start_ns))
    return summaries


def _whole(value: object) -> int | None:
    return value if type(value) is int else None


def _word(value: object) -> str:
    """A value of the metadata for a message to the user; what should be a word may be anything."""
    return repr(value[:40]) if isinstance(value, str) else f'a {type(value).__name__}'


def metadata_text(
    topics: Sequence[TopicRecord],
    files: Sequence[FileRecord],
    *,
    ros_distro: str,
    custom_data: Mapping[str, str] | None = None,
) -> str:
    """The text of a ``metadata.yaml`` of version 9.

    Args:
        topics: Every topic of the bag.
        files: Every file of the bag, in order.
        ros_distro: Such as ``jazzy``.
        custom_data: Free texts that travel with the bag.
    """
    information = _information(topics, files, ros_distro, custom_data)
    text = _dump({'rosbag2_bagfile_information': information})
    # A recording of days has thousands of files, which PyYAML would take seconds for, at every
    # split.
    names = [_scalar(file.path) for file in files]
    lists = {
        'relative_file_paths': ''.join(f'  - {name}\n' for name in names),
        'files': ''.join(map(_file_text, names, files)),
    }
    for key, items in lists.items():
        if items:
            text = text.replace(f'\n  {key}: []\n', f'\n  {key}:\n{items}', 1)
    return text


def storage_text(ros_distro: str, custom_data: Mapping[str, str] | None = None) -> str:
    """What rosbag2 keeps in each file: the bag's metadata without topics and files.

    ``ros2 bag info`` and ``ros2 bag reindex`` read it where there is no ``metadata.yaml``.

    Args:
        ros_distro: Such as ``jazzy``.
        custom_data: Free texts that travel with the bag.
    """
    return _dump(_information((), (), ros_distro, custom_data))


def _information(
    topics: Sequence[TopicRecord],
    files: Sequence[FileRecord],
    ros_distro: str,
    custom_data: Mapping[str, str] | None,
) -> dict[str, Any]:
    """What the metadata say, without the lists of files."""
    nonempty_files = [file for file in files if file.message_count]
    start_ns = min((file.start_ns for file in nonempty_files), default=_NEVER_NS)
    end_ns = max((file.end_ns for file in nonempty_files), default=_NEVER_NS)
    return {
        'version': METADATA_VERSION,
        'storage_identifier': 'mcap',
        **_span(start_ns, end_ns),
        'message_count': sum(topic.message_count for topic in topics),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type_name,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': [dict(profile) for profile in topic.qos_profiles],
                    'type_description_hash': topic.type_hash,
                },
                'message_count': topic.message_count,
            }
            for topic in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [],
        'files': [],
        'custom_data': dict(custom_data) if custom_data else None,
        'ros_distro': ros_distro,
    }


def _file_text(name: str, file: FileRecord) -> str:
    start_ns, end_ns = (
        (file.start_ns, file.end_ns) if file.message_count else (_NEVER_NS, _NEVER_NS)
    )
    return (
        f'  - path: {name}\n    duration:\n      nanoseconds: {end_ns - start_ns}\n'
        f'    starting_time:\n      nanoseconds_since_epoch: {start_ns}\n    message_count: '
        f'{file.message_count}\n'
    )


def _scalar(name: str) -> str:
    """The name of a file as it stands in YAML: quoted where it has to be."""
    return name if _PLAIN_NAME.fullmatch(name) else json.dumps(name)


def qos_text(qos_profiles: Sequence[Mapping[str, Any]]) -> str:
    """QoS profiles as the text that rosbag2 keeps with an MCAP channel; empty for none."""
    return _dump([dict(profile) for profile in qos_profiles]).rstrip() if qos_profiles else ''


def parse_qos_text(text: str) -> list[dict[str, Any]]:
    """The reverse of `qos_text`; a text that cannot be understood gives no profiles."""
    try:
        profiles = parse_yaml(text, _LARGEST_QOS_BYTES) if text else []
    except InputError:
        return []
    return (
        [item for item in profiles if isinstance(item, dict)] if isinstance(profiles, list) else []
    )


def _span(start_ns: int, end_ns: int) -> dict[str, dict[str, int]]:
    return {
        'duration': {'nanoseconds': end_ns - start_ns},
        'starting_time': {'nanoseconds_since_epoch': start_ns},
    }


class _PlainDumper(yaml.SafeDumper):
    """Writes repeated parts in full: the C++ tools need not follow YAML's references."""

    def ignore_aliases(self, _data: Any) -> bool:
        return True


def _dump(data: object) -> str:
    return str(yaml.dump(data, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True))
