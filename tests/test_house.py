"""The house: every module has a room, every room its guide, and nobody walks in circles."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {name: ROOT / 'src' / name / name for name in ('dc_motor_sim', 'gray_box_observer')}
OBSERVER = PACKAGES['gray_box_observer']


def modules(package: str) -> dict[str, Path]:
    """Return the modules of a package by their dotted names."""
    root = PACKAGES[package]
    names = {}
    for path in sorted(root.rglob('*.py')):
        parts = [package, *path.relative_to(root).with_suffix('').parts]
        names['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = path
    return names


def imports(path: Path, names: dict[str, Path]) -> Iterator[str]:
    """Yield the modules of the package that a module imports, at whatever time it does."""
    tree = ast.parse(path.read_text(encoding='utf-8'))
    for_types = {
        id(child)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.unparse(node.test)
        for child in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and id(node) not in for_types:
            for alias in node.names:
                target = f'{node.module}.{alias.name}'
                if target in names:
                    yield target
                elif node.module in names:
                    yield node.module


def circles(graph: dict[str, set[str]]) -> list[str]:
    """Return the nodes that can be reached from themselves."""
    found = []
    for start in graph:
        seen, ahead = set(), list(graph[start])
        while ahead:
            node = ahead.pop()
            if node not in seen:
                seen.add(node)
                ahead += graph.get(node, ())
        if start in seen:
            found.append(start)
    return found


def test_few_modules_stand_at_the_root() -> None:
    loose = [path.name for path in OBSERVER.glob('*.py') if path.name != '__init__.py']
    assert len(loose) <= 4, loose


def test_no_name_of_a_module_stands_twice() -> None:
    counts = Counter(path.stem for path in OBSERVER.rglob('*.py') if not path.stem.startswith('__'))
    assert [name for name, count in counts.items() if count > 1] == []


def test_every_room_says_what_it_is_for_and_where_to_begin() -> None:
    rooms = [path for path in OBSERVER.rglob('__init__.py') if path.parent != OBSERVER]
    assert len(rooms) > 15
    for path in rooms:
        text = ast.get_docstring(ast.parse(path.read_text(encoding='utf-8'))) or ''
        assert 'ead `' in text, f'{path.parent.name} names no file to read first'
        for name in [part for part in text.split('`') if part.endswith('.py')]:
            assert (path.parent / name).is_file(), f'{path.parent.name}: {name}'


@pytest.mark.slow
@pytest.mark.parametrize('package', PACKAGES)
def test_modules_and_rooms_import_in_no_circle(package: str) -> None:
    names = modules(package)
    by_module = {name: set(imports(path, names)) - {name} for name, path in names.items()}
    leaves = {name for name, path in names.items() if path.name == '__init__.py'}
    by_module = {name: targets - leaves for name, targets in by_module.items()}
    assert circles(by_module) == []
    rooms: dict[str, set[str]] = {}
    for name, targets in by_module.items():
        here = name.split('.')[1:2]
        there = {target.split('.')[1] for target in targets if target.count('.') > 1}
        if here and name.count('.') > 1:
            rooms.setdefault(here[0], set()).update(there - set(here))
    assert circles(rooms) == []


@pytest.mark.slow
@pytest.mark.parametrize('package', PACKAGES)
def test_no_method_is_called_of_or_take(package: str) -> None:
    for path in modules(package).values():
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                assert node.name not in {'of', 'take'}, f'{path.name}: {node.lineno}'
