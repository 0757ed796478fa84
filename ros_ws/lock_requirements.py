"""Write ``requirements/locked/``: every installed package with its version and file hashes.

    ros_ws/run.sh python ros_ws/lock_requirements.py [--upgrade]

``uv`` (see CONTRIBUTING) resolves the pinned lists for every Python and platform that a set-up
knows. Versions that are locked already stay, unless ``--upgrade`` asks for the newest. What no such
machine could install is left out.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomllib
from packaging.markers import Marker
from packaging.utils import parse_wheel_filename

REQUIREMENTS = Path(__file__).resolve().parent / 'requirements'
LOCKED = REQUIREMENTS / 'locked'
PYTHONS = ('3.11', '3.12', '3.13')
MACHINES = ('x86_64', 'aarch64')
"""Of Linux. The wheels of ROS are for the first alone; a distribution of ROS may be on the second.
"""
ONLY_FOR_CUDA = re.compile(r'(nvidia|cuda|triton)\b.*')
"""What torch brings along where it is built for CUDA."""


@dataclass(frozen=True, slots=True)
class Package:
    """One package as it is locked.

    Attributes:
        name: In its normal form.
        version: The only one that is installed.
        marker: Where it is needed; empty for everywhere.
        hashes: SHA-256 of every file that may be installed, sorted.
    """

    name: str
    version: str
    marker: str
    hashes: tuple[str, ...]

    def text(self) -> str:
        """Return the requirement as pip reads it."""
        return ' \\\n    '.join([self.pin, *(f'--hash=sha256:{value}' for value in self.hashes)])

    @property
    def pin(self) -> str:
        """The same without hashes."""
        return f'{self.name}=={self.version}' + (f' ; {self.marker}' if self.marker else '')


def main() -> int:
    """Write every list; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--upgrade', action='store_true', help='the newest version of what the pinned packages need'
    )
    options = parser.parse_args()
    if shutil.which('uv') is None:
        print('lock_requirements: error: uv is missing; CONTRIBUTING says which', file=sys.stderr)
        return 2
    pins = [] if options.upgrade else sorted(LOCKED.glob('*.txt'))
    with tempfile.TemporaryDirectory() as name:
        versions = Path(name) / 'versions.txt'
        versions.write_text('\n'.join(_pinned(pins)), encoding='utf-8')
        names = [f'{stem}.txt' for stem in ('ros', 'build', 'runtime', 'archive', 'dev', 'bench')]
        packages = [
            p for p in map(_package, _resolve(names, versions, Path(name))) if p is not None
        ]
        versions.write_text('\n'.join(p.pin for p in packages), encoding='utf-8')
        needed = {
            stem: {p['name'] for p in _resolve(files, versions, Path(name))}
            for stem, files in {
                'python': ['runtime.txt', 'archive.txt', 'dev.txt'],
                'build': ['build.txt'],
                'ros': ['ros.txt'],
                'bench': ['bench.txt'],
            }.items()
        }
    _write(_groups(packages, needed))
    return 0


def _pinned(files: Iterable[Path]) -> list[str]:
    """Everything that is locked, without hashes."""
    lines = (line for file in files for line in file.read_text(encoding='utf-8').splitlines())
    return [line.removesuffix('\\') for line in lines if re.match(r'[a-z0-9]', line)]


def _resolve(names: Sequence[str], versions: Path, folder: Path) -> list[Mapping[str, Any]]:
    """Return what these lists need, with every file of it, on whatever platform."""
    out = folder / 'pylock.toml'
    out.unlink(missing_ok=True)
    command = [
        'uv',
        'pip',
        'compile',
        '--no-config',
        '--quiet',
        '--universal',
        '--python-version',
        PYTHONS[0],
    ]
    command += [
        '--format',
        'pylock.toml',
        '--constraints',
        str(versions),
        '--output-file',
        str(out),
    ]
    subprocess.run([*command, *(str(REQUIREMENTS / name) for name in names)], check=True)
    packages: list[Mapping[str, Any]] = tomllib.loads(out.read_text(encoding='utf-8'))['packages']
    return packages


def _package(entry: Mapping[str, Any]) -> Package | None:
    """Lock one package, or leave it out where no such machine needs it."""
    places = [(python, machine) for machine in MACHINES for python in PYTHONS]
    marker = Marker(entry.get('marker', 'python_version > "3"'))
    needed = [place for place in places if marker.evaluate(_environment(*place))]
    if not needed:
        return None
    wheels = {
        wheel['url'].rpartition('/')[2]: wheel['hashes']['sha256']
        for wheel in entry.get('wheels', ())
    }
    covered = {place: [name for name in wheels if _fits(name, *place)] for place in needed}
    hashes = {wheels[name] for names in covered.values() for name in names}
    if not all(covered.values()) and 'sdist' in entry:
        hashes.add(entry['sdist']['hashes']['sha256'])
    if not hashes:
        raise SystemExit(
            f'lock_requirements: error: {entry["name"]} {entry["version"]} has no file for Linux'
        )
    condition = '' if needed == places else str(marker)
    return Package(entry['name'], entry['version'], condition, tuple(sorted(hashes)))


def _environment(python: str, machine: str) -> dict[str, str]:
    """Return what markers ask of a machine."""
    return {
        'implementation_name': 'cpython',
        'os_name': 'posix',
        'platform_machine': machine,
        'platform_python_implementation': 'CPython',
        'platform_system': 'Linux',
        'python_full_version': f'{python}.9',
        'python_version': python,
        'sys_platform': 'linux',
    }


def _fits(wheel: str, python: str, machine: str) -> bool:
    """Whether a wheel can be installed there."""
    number = int(python.partition('.')[2])
    for tag in parse_wheel_filename(wheel)[3]:
        of_platform = tag.platform == 'any' or (
            'linux' in tag.platform and tag.platform.endswith(machine)
        )
        if not of_platform or tag.platform.startswith('musl'):
            continue
        if tag.interpreter in ('py3', f'py3{number}', f'cp3{number}') and tag.abi in (
            'none',
            'abi3',
            f'cp3{number}',
        ):
            return True
        oldest = re.fullmatch(r'cp3(\d+)', tag.interpreter)
        if oldest and tag.abi == 'abi3' and int(oldest[1]) <= number:
            return True
    return False


def _groups(
    packages: Iterable[Package], needed: Mapping[str, set[str]]
) -> dict[str, list[Package]]:
    """Sort the packages by what they are installed for; each is in one group."""
    groups: dict[str, list[Package]] = {stem: [] for stem in ('torch', 'cuda', *needed)}
    for package in packages:
        if package.name == 'torch':
            stem = 'torch'
        elif ONLY_FOR_CUDA.fullmatch(package.name):
            stem = 'cuda'
        else:
            stem = next(stem for stem, names in needed.items() if package.name in names)
        groups[stem].append(package)
    return groups


def _write(groups: Mapping[str, Iterable[Package]]) -> None:
    LOCKED.mkdir(exist_ok=True)
    for stem, packages in groups.items():
        origin = f'# Written by {Path(__file__).name} from the lists of pinned packages.'
        lines = [origin, *(package.text() for package in packages)]
        (LOCKED / f'{stem}.txt').write_text('\n'.join(lines) + '\n', encoding='utf-8')


if __name__ == '__main__':
    raise SystemExit(main())
