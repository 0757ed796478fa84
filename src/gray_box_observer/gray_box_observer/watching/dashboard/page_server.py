"""Serves the page and what it is told, by `tornado` in a thread of its own.

It only answers GET. Three files of ours and plotly.js are all it can send, and one stream of
events: nothing of it is written by whoever asks. See docs/SECURITY.md.
"""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
import json
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream, StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.watching.dashboard.page_feed import PageFeed, PageSource

UPDATE_S = 0.25
"""Between two updates of a page."""

MOST_PAGES = 8
"""Open pages; each takes about a hundredth of a core."""

MOST_CONNECTIONS = 64
"""Of all kinds; a browser takes six for a page. One more is closed before it has asked."""

STALLED_S = 30.0
"""Who does not read an answer or an update for so long is given up."""

START_S = 10.0
END_S = 5.0
"""How long the server's thread may take to begin and to end."""

MAX_HEADER_BYTES = 16_384
IDLE_S = 60.0
LONGEST_NAME = 256

FILES = {
    '/': ('dashboard.html', 'text/html; charset=utf-8'),
    '/dashboard.js': ('dashboard.js', 'text/javascript; charset=utf-8'),
    '/dashboard.css': ('dashboard.css', 'text/css; charset=utf-8'),
}
PLOTLY = '/plotly.js'
_SCRIPT = 'text/javascript; charset=utf-8'

HEADERS = {
    'Content-Security-Policy': "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    'X-Content-Type-Options': 'nosniff',
    'Referrer-Policy': 'no-referrer',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cache-Control': 'no-store',
}


class PageServer:
    """Serves pages until it is stopped.

    Args:
        source: what pages are told.
        address: to listen on; loopback unless somebody asks for more.
        port: 0: one that is free.

    Attributes:
        url: where the page is.

    Raises:
        ConfigurationError: address or port cannot be had.
    """

    def __init__(self, source: PageSource, address: str = '127.0.0.1', port: int = 0) -> None:
        if not address:
            raise ConfigurationError(
                'the address of the dashboard is empty, which would be every interface: give '
                '127.0.0.1, or 0.0.0.0 where that is meant'
            )
        try:
            self._sockets = bind_sockets(port, address, backlog=16)
        except (OSError, UnicodeError) as error:
            reason = getattr(error, 'strerror', None) or str(error)
            raise ConfigurationError(
                f'the dashboard cannot listen on {address}, port {port}: {reason}; choose another '
                'port, or 0 for a free one'
            ) from error
        own_port = self._sockets[0].getsockname()[1]
        host = f'[{address}]' if ':' in address else address
        self.url = f'http://{host}:{own_port}/'
        self._source = source
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None
        self._failure: BaseException | None = None
        self._is_ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name='dashboard', daemon=True)

    def start(self) -> None:
        """Begin to serve, in a thread of its own.

        Raises:
            ConfigurationError: it cannot, or does not within START_S.
        """
        self._thread.start()
        if not self._is_ready.wait(START_S):
            raise ConfigurationError(
                f'the dashboard has not begun to serve {self.url} within {START_S:g} s'
            )
        self.check()

    def check(self) -> None:
        """Make sure that the page is served; nothing is asked of it once it was stopped.

        Raises:
            ConfigurationError: serving has failed.
        """
        if self._failure is not None:
            reason = str(self._failure) or type(self._failure).__name__
            raise ConfigurationError(
                f'the dashboard cannot serve {self.url}: {reason}'
            ) from self._failure

    def stop(self) -> None:
        """End; open pages are told no more."""
        if self._loop is not None and self._end is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(timeout=END_S)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except Exception as error:
            self._failure = error
        finally:
            self._is_ready.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._end = asyncio.Event()
        server = _BoundedServer(
            make_application(self._source),
            max_header_size=MAX_HEADER_BYTES,
            max_body_size=0,
            max_buffer_size=4 * MAX_HEADER_BYTES,
            idle_connection_timeout=IDLE_S,
            body_timeout=IDLE_S,
        )
        server.add_sockets(self._sockets)
        self._is_ready.set()
        await self._end.wait()
        server.stop()
        await server.close_all_connections()


class _BoundedServer(HTTPServer):
    """Takes so many connections at a time, whatever they are for."""

    def initialize(self, *args: Any, **words: Any) -> None:
        super().initialize(*args, **words)
        self._open_count = 0

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        if self._open_count >= MOST_CONNECTIONS:
            stream.close()
            return
        self._open_count += 1
        super().handle_stream(stream, address)

    def on_close(self, server_conn: object) -> None:
        self._open_count -= 1
        super().on_close(server_conn)


@dataclass
class _OwnFile:
    """A file that lies beside this module; it is read at once."""

    name: str
    kind: str

    def __post_init__(self) -> None:
        self.content = (Path(__file__).parent / self.name).read_bytes()
        self.validator = ''
        self.cache_control = HEADERS['Cache-Control']


class _Plotly:
    """plotly.js: some megabytes, which are read once, when they are first asked for."""

    kind = _SCRIPT
    cache_control = 'private, no-cache'
    """A browser keeps it, and asks whether it is still the same."""

    @cached_property
    def content(self) -> bytes:
        path = resources.files('plotly') / 'package_data' / 'plotly.min.js'
        return path.read_bytes()

    @cached_property
    def validator(self) -> str:
        return f'"{hashlib.sha256(self.content).hexdigest()}"'


def make_application(
    source: PageSource, host_name: Callable[[], str] = socket.gethostname
) -> Application:
    """Make what answers requests.

    Args:
        source: what pages are told.
        host_name: says what this machine is called.
    """
    common: dict[str, Any] = {'own_names': frozenset({'localhost', host_name().lower()})}
    files = [
        (path, _FileHandler, {**common, 'file': _OwnFile(name, kind)})
        for path, (name, kind) in FILES.items()
    ]
    pages: set[object] = set()
    return Application(
        [
            *files,
            (PLOTLY, _FileHandler, {**common, 'file': _Plotly()}),
            ('/events', _EventHandler, {**common, 'source': source, 'pages': pages}),
        ],
        default_handler_class=_NothingHandler,
        default_handler_args=common,
        log_function=lambda _handler: None,
        compress_response=False,
    )


def is_own_host(host: str, own_names: frozenset[str]) -> bool:
    """Whether a Host header names this machine, and no name that somebody may have rebound.

    A page elsewhere can make its own name lead to this server (DNS rebinding), but not an address.

    Args:
        host: the header, with or without a port.
        own_names: names of this machine, in small letters.
    """
    try:
        name = urlsplit(f'//{host}').hostname or ''
    except ValueError:
        return False
    if name in own_names:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class _Handler(RequestHandler):
    """What all answers have in common: who may ask, and what a browser may do with them."""

    SUPPORTED_METHODS: tuple[str, ...] = ('GET', 'HEAD')

    def initialize(self, own_names: frozenset[str]) -> None:
        self._own_names = own_names

    def set_default_headers(self) -> None:
        self.clear_header('Server')
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        hosts = self.request.headers.get_list('Host')
        if len(hosts) != 1 or not is_own_host(hosts[0], self._own_names):
            raise HTTPError(421)
        # a page elsewhere could not read an answer, but take the places of those who may
        if self.request.headers.get('Sec-Fetch-Site', 'none') not in ('same-origin', 'none'):
            is_page = self.request.headers.get('Sec-Fetch-Dest') == 'document'
            if not is_page or self.request.path != '/':
                raise HTTPError(403)

    def write_error(self, status_code: int, **_kwargs: Any) -> None:
        self.set_header('Content-Type', 'text/plain; charset=utf-8')
        self.finish(f'{status_code}\n')


class _NothingHandler(_Handler):
    """Answers what is asked for and not there."""

    def prepare(self) -> None:
        super().prepare()
        raise HTTPError(404)


class _FileHandler(_Handler):
    """Sends one file, to whoever reads it."""

    def initialize(  # type: ignore[override]
        self, own_names: frozenset[str], file: _OwnFile | _Plotly
    ) -> None:
        super().initialize(own_names)
        self._file = file

    async def get(self) -> None:
        self.set_header('Content-Type', self._file.kind)
        self.set_header('Cache-Control', self._file.cache_control)
        try:
            await asyncio.wait_for(self.finish(self._file.content), STALLED_S)
        except (StreamClosedError, asyncio.TimeoutError):
            _close(self)

    def compute_etag(self) -> str | None:
        return self._file.validator or None  # tornado's own would hash the content every time

    head = get


class _EventHandler(_Handler):
    """Tells a page what is new, as server-sent events (HTML Standard, 9.2)."""

    SUPPORTED_METHODS = ('GET',)

    def initialize(  # type: ignore[override]
        self, own_names: frozenset[str], source: PageSource, pages: set[object]
    ) -> None:
        super().initialize(own_names)
        self._source = source
        self._pages = pages

    async def get(self) -> None:
        observer, motor = (
            self.get_query_argument(name, '')[:LONGEST_NAME] for name in ('observer', 'motor')
        )
        if len(self._pages) >= MOST_PAGES:
            self.set_status(503)
            self.set_header('Retry-After', '10')
            self.finish('503\n')
            return
        self._pages.add(self)
        try:
            self.set_header('Content-Type', 'text/event-stream')
            feed = PageFeed(self._source, observer, motor)
            while True:
                update = json.dumps(feed.update(), allow_nan=False, separators=(',', ':'))
                self.write(f'data: {update}\n\n')
                await asyncio.wait_for(self.flush(), STALLED_S)
                await asyncio.sleep(UPDATE_S)
        except (StreamClosedError, asyncio.TimeoutError, asyncio.CancelledError):
            # the page has gone, does not read, or the server ends
            _close(self)
        finally:
            self._pages.discard(self)

    def on_connection_close(self) -> None:
        self._pages.discard(self)


def _close(handler: RequestHandler) -> None:
    """Close the connection of a request at once."""
    stream = getattr(handler.request.connection, 'stream', None)
    if stream is not None:
        stream.close()
