"""The packages match their descriptions: manifests, entry points, files, dependencies."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from catkin_pkg.package import parse_package

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ('dc_motor_sim', 'gray_box_observer')

ROSDEP_KEYS = {'numpy': 'python3-numpy', 'tqdm': 'python3-tqdm', 'yaml': 'python3-yaml'}
WITHOUT_ROSDEP_KEY = {
    name: name
    for name in (
        'torch',
        'safetensors',
        'mcap',
        'lz4',
        'zstandard',
        'plotly',
        'dask',
        'distributed',
        'pyarrow',
        'rich',
        'scipy',
        'tornado',
    )
} | {'mcap_ros2': 'mcap-ros2-support'}

BLOCKED_IMPORT = """
import importlib, re, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition('.')[0]
        ros = r'rclpy|launch(_ros)?|(ament|ros|rosidl|rcl)_.*|.*_(msgs|srvs|interfaces)'
        if re.fullmatch(ros, top):
            raise ImportError(f'a core imported {name}')

sys.meta_path.insert(0, NoRos())
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def sources(package: str) -> list[Path]:
    return sorted((ROOT / 'src' / package / package).rglob('*.py'))


def core_modules(package: str) -> list[str]:
    files = [path.relative_to(ROOT / 'src' / package).with_suffix('') for path in sources(package)]
    return ['.'.join(p.parts).removesuffix('.__init__') for p in files if 'ros' not in p.parts]


def imported(paths: list[Path]) -> set[str]:
    """Top-level names of all imports in the files, less the standard library."""
    names: set[str] = set()
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                names.update(alias.name.partition('.')[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module.partition('.')[0])
    return names - set(sys.stdlib_module_names)


def setup_arguments(package: str) -> dict[str, object]:
    """The literal keyword arguments of ``setup(...)``."""
    tree = ast.parse((ROOT / 'src' / package / 'setup.py').read_text(encoding='utf-8'))
    call = next(
        n
        for n in ast.walk(tree)
        if isinstance(n, ast.Call) and getattr(n.func, 'id', '') == 'setup'
    )
    arguments = {}
    for keyword in call.keywords:
        try:
            arguments[keyword.arg] = ast.literal_eval(keyword.value)
        except ValueError:
            continue
    return arguments


def entry_points(package: str) -> dict[str, tuple[str, str]]:
    """Module and function of each executable."""
    points = {}
    for line in setup_arguments(package)['entry_points']['console_scripts']:
        name, target = (part.strip() for part in line.split('='))
        points[name] = tuple(target.split(':'))
    return points


def install_prefix(package: str) -> Path:
    try:
        return Path(get_package_prefix(package))
    except (PackageNotFoundError, OSError):  # OSError: nothing at all is sourced
        pytest.skip('the workspace is not sourced: run make test')


def requirements() -> list[str]:
    files = (ROOT / 'ros_ws' / 'requirements').glob('*.txt')
    lines = [line for file in files for line in file.read_text(encoding='utf-8').splitlines()]
    return [line for line in lines if line and not line.startswith('#')]


@pytest.mark.parametrize('package', PACKAGES)
def test_a_manifest_is_valid_and_agrees_with_the_setup_file(package: str):
    warnings: list[str] = []
    manifest = parse_package(ROOT / 'src' / package, warnings=warnings)
    assert warnings == []
    assert manifest.get_build_type() == 'ament_python'
    described = setup_arguments(package)
    assert manifest.version == described['version']
    assert manifest.licenses == [described['license']]
    assert [m.email for m in manifest.maintainers] == [described['maintainer_email']]
    assert re.fullmatch(r'[^@\s]+@[^@\s]+\.[a-z]+', described['maintainer_email'])


@pytest.mark.parametrize('package', PACKAGES)
def test_every_entry_point_names_a_function_that_exists(package: str):
    points = entry_points(package)
    assert points
    for module, function in points.values():
        path = ROOT / 'src' / package / Path(*module.split('.')).with_suffix('.py')
        defined = {
            n.name
            for n in ast.parse(path.read_text(encoding='utf-8')).body
            if isinstance(n, ast.FunctionDef)
        }
        assert function in defined, f'{module}:{function}'


@pytest.mark.parametrize('package', PACKAGES)
def test_every_executable_stands_where_ros_looks_for_it_and_starts_with_this_python(package: str):
    prefix = install_prefix(package)
    for name in entry_points(package):
        script = prefix / 'lib' / package / name
        interpreter = script.read_text(encoding='utf-8').splitlines()[0].removeprefix('#!').strip()
        assert Path(interpreter).samefile(sys.executable)
        assert script.stat().st_mode & 0o111


@pytest.mark.parametrize('package', PACKAGES)
def test_what_goes_into_the_share_folder_is_installed(package: str):
    share = install_prefix(package) / 'share' / package
    folders = ('launch', 'config', 'security', 'layouts')
    wanted = [path for folder in folders for path in (ROOT / 'src' / package / folder).glob('*.*')]
    assert {'launch', 'config', 'security'} <= {path.parent.name for path in wanted}
    for path in wanted:
        installed = share / path.parent.name / path.name
        assert installed.read_bytes() == path.read_bytes(), installed
    assert (share / 'package.xml').is_file()


@pytest.mark.parametrize('package', PACKAGES)
def test_the_manifest_declares_every_import_and_nothing_else(package: str):
    launch_files = list((ROOT / 'src' / package / 'launch').glob('*.py'))
    names = imported(sources(package) + launch_files)
    for path in launch_files:
        names.update(re.findall(r"package='(\w+)'", path.read_text(encoding='utf-8')))
    names.discard(package)
    used = {ROSDEP_KEYS.get(name, name) for name in names - set(WITHOUT_ROSDEP_KEY)}
    declared = {
        dependency.name for dependency in parse_package(ROOT / 'src' / package).exec_depends
    }
    assert used == declared
    pinned = {line.partition('==')[0] for line in requirements()}
    assert {WITHOUT_ROSDEP_KEY[name] for name in names & set(WITHOUT_ROSDEP_KEY)} <= pinned


@pytest.mark.parametrize('package', PACKAGES)
def test_every_core_module_imports_with_ros_blocked(package: str):
    names = core_modules(package)
    assert len(names) > 5
    done = subprocess.run(
        [sys.executable, '-c', BLOCKED_IMPORT, *names], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr


def test_the_block_really_blocks_ros():
    done = subprocess.run(
        [sys.executable, '-c', BLOCKED_IMPORT, 'gray_box_observer.ros.topics'],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert 'a core imported' in done.stderr


def test_observer_and_simulator_do_not_import_each_other():
    assert 'dc_motor_sim' not in imported(sources('gray_box_observer'))
    assert 'gray_box_observer' not in imported(sources('dc_motor_sim'))


def test_a_section_of_the_method_that_the_code_cites_is_there():
    headings = re.findall(
        r'^## (.+)$', (ROOT / 'docs' / 'METHOD.md').read_text(encoding='utf-8'), re.MULTILINE
    )
    cited = {}
    for path in [
        p for folder in ('src', 'benchmarks', 'tests') for p in (ROOT / folder).rglob('*.py')
    ]:
        for title in re.findall(
            r'docs/METHOD\.md, ([A-Z]\w[\w ]*|`[^`]+`)', path.read_text(encoding='utf-8')
        ):
            cited[title] = path
    assert len(cited) >= 3
    assert {title: path for title, path in cited.items() if title not in headings} == {}


def test_every_requirement_is_pinned_and_has_its_reason_in_contributing():
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    explained = {
        name
        for line in text.splitlines()
        if line.startswith('|')
        for name in re.findall(r'`([^` ]+)`', line)
    }
    assert requirements()
    for line in requirements():
        name, pin, version = line.partition('==')
        assert pin and version, f'{line} is not pinned'
        assert name in explained, f'{name} has no line in CONTRIBUTING.md'


def test_a_library_that_cannot_be_built_anew_does_not_stay(tmp_path: Path) -> None:
    source = ROOT / 'src' / 'gray_box_observer'
    copy = tmp_path / 'gray_box_observer'
    shutil.copytree(
        source, copy, ignore=shutil.ignore_patterns('*.so', '__pycache__', '*.egg-info', 'build')
    )
    library = (
        f'gray_box_observer/context_nodes/native/_compiled{sysconfig.get_config_var("EXT_SUFFIX")}'
    )
    (copy / library).write_text('of an earlier version')
    command = [sys.executable, 'setup.py', '--quiet', 'build_ext', '--inplace']
    environment = os.environ | {'CC': '/bin/false', 'LDSHARED': '/bin/false'}
    done = subprocess.run(
        command, cwd=copy, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr  # the package is built without it
    assert not (copy / library).exists()


def test_everything_that_is_pinned_is_locked_in_that_version_with_hashes_and_without_any_address():
    """`ros_ws/lock_requirements.py` writes the locked lists; run it when a pin changes."""
    locked: dict[str, set[str]] = {}
    for path in (ROOT / 'ros_ws' / 'requirements' / 'locked').glob('*.txt'):
        text = path.read_text(encoding='utf-8')
        assert '://' not in text
        for entry in re.split(r'\n(?=[a-z0-9])', text)[1:]:
            name, version = re.match(r'([\w.-]+)==([^\s;]+)', entry).groups()
            locked.setdefault(name, set()).add(version)
            assert re.search(r'--hash=sha256:[0-9a-f]{64}\b', entry), f'{name} has no hash'
    for line in requirements():
        name, _, version = line.partition('==')
        assert version in locked.get(re.sub(r'[-_.]+', '-', name).lower(), ()), (
            f'{line} is not locked in this version'
        )
