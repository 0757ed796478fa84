"""The server of the page: what it sends, to whom, and what it refuses."""

from __future__ import annotations

import http.client
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.watching.dashboard import page_server
from gray_box_observer.watching.dashboard.page_feed import PageSource
from gray_box_observer.watching.dashboard.page_server import MOST_PAGES, PageServer, is_own_host
from gray_box_observer.watching.dashboard.signal_courses import SignalCourses
from gray_box_observer.watching.observer_state import WatchedState

FOLDER = Path(page_server.__file__).parent
TIMEOUT_S = 120.0


@pytest.fixture
def source() -> PageSource:
    return PageSource(WatchedState(), SignalCourses(), lambda: 0.0)


@pytest.fixture
def server(source: PageSource) -> Iterator[PageServer]:
    made = PageServer(source)
    made.start()
    yield made
    made.stop()


def ask(
    server: PageServer, path: str, method: str = 'GET', **headers: str
) -> http.client.HTTPResponse:
    address = urlsplit(server.url)
    connection = http.client.HTTPConnection(address.hostname, address.port, timeout=TIMEOUT_S)
    named = {name.replace('_', '-'): value for name, value in headers.items()}
    connection.request(method, path, headers=named)
    return connection.getresponse()


def next_event(answer: http.client.HTTPResponse) -> dict:
    line = answer.readline()
    assert answer.readline() == b'\n'
    return json.loads(line.removeprefix(b'data: '))


@pytest.mark.parametrize('path', ['/', '/dashboard.js', '/dashboard.css', '/plotly.js'])
def test_every_file_is_sent_with_a_policy_that_allows_nothing_from_elsewhere(
    server: PageServer, path: str
) -> None:
    answer = ask(server, path)
    assert answer.status == 200
    policy = answer.headers['Content-Security-Policy']
    assert policy.startswith("default-src 'none'; script-src 'self'; ")
    assert 'unsafe' not in policy and '*' not in policy and 'http' not in policy
    assert answer.headers['X-Content-Type-Options'] == 'nosniff'
    assert answer.headers['Server'] is None
    assert not [name for name in answer.headers if name.lower().startswith('access-control')]
    body = answer.read()
    if path == '/plotly.js':
        plotly = resources.files('plotly') / 'package_data' / 'plotly.min.js'
        assert body == plotly.read_bytes()


def test_the_page_asks_for_nothing_that_the_server_does_not_have() -> None:
    page = (FOLDER / 'dashboard.html').read_text(encoding='utf-8')
    asked = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert sorted(asked) == ['/dashboard.css', '/dashboard.js', '/plotly.js']
    script = (FOLDER / 'dashboard.js').read_text(encoding='utf-8')
    assert not re.search(r'innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(', script)
    assert re.findall(r'byId\(\'(\w+)\'\)', script)
    for name in set(re.findall(r"byId\('(\w+)'\)", script)):
        assert f'id="{name}"' in page, name


def test_updates_come_one_after_another_and_carry_names_as_they_are(
    server: PageServer, source: PageSource
) -> None:
    evil = '</script><script>alert(1)</script>\n\ndata: 1'
    with source.lock:
        source.state.add_status('/o', evil, 1, evil, {}, 0.0)
    answer = ask(server, '/events?observer=/o')
    assert answer.headers['Content-Type'] == 'text/event-stream'
    first = next_event(answer)
    second = next_event(answer)
    assert first['begins'] is True and 'begins' not in second
    assert first['motor']['name'] == first['motor']['advice'] == evil


@pytest.mark.parametrize(
    ('host', 'status'),
    [
        ('localhost:8000', 200),
        ('127.0.0.1', 200),
        ('[::1]:80', 200),
        ('evil.example', 421),
        ('evil.example:8080', 421),
        ('localhost.evil.example', 421),
        ('', 421),
        ('[', 421),
    ],
)
def test_a_name_that_leads_here_from_elsewhere_is_refused(
    server: PageServer, host: str, status: int
) -> None:
    for path in ('/', '/plotly.js', '/events', '/nothing'):
        answer = ask(server, path, Host=host)
        assert answer.status == (404 if path == '/nothing' and status == 200 else status)
        answer.close()


def test_this_machine_may_be_called_by_its_name() -> None:
    names = frozenset({'localhost', 'robot'})
    assert is_own_host('robot:8080', names) and is_own_host('ROBOT', names)
    assert not is_own_host('robot.example', names)


@pytest.mark.parametrize('path', ['/events', '/plotly.js'])
def test_a_page_elsewhere_takes_no_place(server: PageServer, path: str) -> None:
    assert ask(server, path, Sec_Fetch_Site='cross-site').status == 403
    assert ask(server, path, Sec_Fetch_Site='same-origin').status == 200


def test_a_link_from_elsewhere_opens_the_page(server: PageServer) -> None:
    words = {'Sec_Fetch_Site': 'cross-site', 'Sec_Fetch_Dest': 'document'}
    assert ask(server, '/', **words).status == 200
    assert ask(server, '/events', **words).status == 403


@pytest.mark.parametrize('method', ['POST', 'PUT', 'DELETE', 'OPTIONS', 'PATCH'])
def test_nothing_can_be_written(server: PageServer, method: str) -> None:
    for path in ('/', '/events'):
        assert ask(server, path, method).status == 405


@pytest.mark.parametrize('path', ['/nothing', '/../setup.py', '/dashboard.html', '//evil'])
def test_nothing_else_is_there(server: PageServer, path: str) -> None:
    answer = ask(server, path)
    assert answer.status == 404
    assert answer.read() == b'404\n'


def test_only_so_many_pages_are_served_and_a_closed_one_makes_room(server: PageServer) -> None:
    answers = [ask(server, '/events') for _ in range(MOST_PAGES)]
    for answer in answers:
        assert next_event(answer) == {'observers': []}
    refused = ask(server, '/events')
    assert (refused.status, refused.headers['Retry-After']) == (503, '10')
    answers.pop().close()
    for _ in range(100):  # until the server has seen it
        again = ask(server, '/events')
        if again.status == 200:
            break
        again.read()
        next_event(answers[0])
    assert again.status == 200


def test_plotly_is_read_once_and_sent_once_to_who_keeps_it(
    server: PageServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: list[Path] = []
    read_bytes = Path.read_bytes
    monkeypatch.setattr(Path, 'read_bytes', lambda path: reads.append(path) or read_bytes(path))
    first = ask(server, '/plotly.js')
    second = ask(server, '/plotly.js', 'HEAD')
    assert [path.name for path in reads] == ['plotly.min.js']
    assert first.headers['Etag'] == second.headers['Etag']
    assert len(first.read()) == int(second.headers['Content-Length'])
    again = ask(server, '/plotly.js', If_None_Match=first.headers['Etag'])
    assert (again.status, again.read()) == (304, b'')
    other = ask(server, '/plotly.js', If_None_Match='"other"')
    assert other.status == 200
    assert ask(server, '/').headers['Cache-Control'] == 'no-store'


def test_connections_of_all_kinds_are_bounded(
    source: PageSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_server, 'MOST_CONNECTIONS', 3)
    server = PageServer(source)
    server.start()
    address = urlsplit(server.url)
    where = (address.hostname, address.port)
    silent = [socket.create_connection(where, timeout=TIMEOUT_S) for _ in range(2)]
    kept = http.client.HTTPConnection(*where, timeout=TIMEOUT_S)
    for _ in range(2):
        kept.request('GET', '/')
        assert kept.getresponse().read().startswith(b'<!DOCTYPE html>')
    with pytest.raises((http.client.HTTPException, ConnectionError)):
        ask(server, '/')
    silent.pop().close()
    wait_for_room(server)
    server.stop()


def test_who_does_not_read_makes_room_after_a_while(
    server: PageServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_server, 'STALLED_S', 0.2)
    monkeypatch.setattr(page_server, 'MOST_CONNECTIONS', 1)
    monkeypatch.setattr(page_server._Plotly, 'content', bytes(16_000_000))  # no kernel holds them
    address = urlsplit(server.url)
    with socket.create_connection((address.hostname, address.port), timeout=TIMEOUT_S) as slow:
        slow.sendall(b'GET /plotly.js HTTP/1.1\r\nHost: localhost\r\n\r\n')
        assert slow.recv(8) == b'HTTP/1.1'
        wait_for_room(server)


def wait_for_room(server: PageServer) -> None:
    """Ask until the server answers."""
    end_s = time.monotonic() + TIMEOUT_S
    while True:
        try:
            assert ask(server, '/').status == 200
            return
        except (http.client.HTTPException, ConnectionError):
            assert time.monotonic() < end_s, 'no room was made'
            time.sleep(0.01)


def test_a_thread_that_fails_is_an_error_and_no_wait_for_ever(
    source: PageSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_source: PageSource) -> None:
        raise OSError('too many open files')

    monkeypatch.setattr(page_server, 'make_application', fail)
    server = PageServer(source)
    with pytest.raises(
        ConfigurationError, match=r'cannot serve http://127\.0\.0\.1:\d+/: too many'
    ):
        server.start()
    with pytest.raises(ConfigurationError, match='too many open files'):
        server.check()
    server.stop()


def test_a_thread_that_does_not_begin_is_an_error_in_time(
    source: PageSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    monkeypatch.setattr(page_server, 'START_S', 0.05)
    monkeypatch.setattr(PageServer, '_run', lambda _: released.wait(TIMEOUT_S))
    with pytest.raises(ConfigurationError, match='has not begun to serve'):
        PageServer(source).start()
    released.set()


def test_a_port_that_is_taken_is_refused_in_a_sentence(source: PageSource) -> None:
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(
            ConfigurationError, match=rf'cannot listen on 127\.0\.0\.1, port {port}: '
        ):
            PageServer(source, port=port)
    with pytest.raises(ConfigurationError, match=r'cannot listen on no\.such\.host'):
        PageServer(source, 'no.such.host.invalid')


def test_it_ends_while_pages_are_open(source: PageSource) -> None:
    server = PageServer(source)
    server.start()
    answer = ask(server, '/events')
    next_event(answer)
    server.stop()
    assert not server._thread.is_alive()
