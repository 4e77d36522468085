"""The server behind the page: static files, and questions and answers as JSON, for one file and one machine.

Whoever may ask is on this machine and knows the address, which holds a random token; requests that name another host
(DNS rebinding) or come from another page (CSRF) are refused. The server keeps nothing but the worlds that it has read
last: the text and its history are the page's.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import math
import os
import secrets
import sys
import threading
import webbrowser
from collections import OrderedDict
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from navsim.editor.file import LARGEST_TEXT, ChangedOnDiskError, EditedFile
from navsim.editor.patch import EditError, patched
from navsim.editor.reading import Reading, oddities_of, read_world
from navsim.editor.scene import LARGEST_IMAGE, Paths, depth_millimetres, describe, equipment, problem
from navsim.errors import WorldError

LARGEST_REQUEST = 2 * LARGEST_TEXT
"""Bytes."""
MOST_EDITS = 1000
"""Edits of one request."""
_REMEMBERED = 16
_STATIC = Path(__file__).resolve().parent / "static"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class RequestError(Exception):
    """A request that is refused; the message is the sentence that the page gets."""

    def __init__(self, status: HTTPStatus, message: str, **more: Any) -> None:
        super().__init__(message)
        self.status = status
        self.answer = {"error": message, **more}


def edit(file: EditedFile, port: int = 0, open_browser: bool = True) -> None:
    """Serves the page until Ctrl-C.

    Args:
        file: what is edited.
        port: of localhost; 0 takes a free one.
        open_browser: show the page in the user's browser, where there is a screen.

    Raises:
        WorldError: if the port is taken.
    """
    try:
        server = EditorServer(file, port)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or "it must lie between 0 and 65535"
        raise WorldError(
            [f"port {port} of localhost cannot be used ({reason}); leave --port out to take a free one"]
        ) from None
    with server:
        new = "" if file.path.exists() else " (new: it is written when you save)"
        print(f"editing {file.path}{new} at\n  {server.url}\nCtrl-C ends", flush=True)
        if open_browser and _has_screen():
            threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()


def _has_screen() -> bool:
    """Whether a browser would have a window; one in the terminal would take the terminal over."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class EditorServer(ThreadingHTTPServer):
    """Serves the page of one file on localhost.

    Args:
        file: what is edited.
        port: 0 takes a free one.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(self, file: EditedFile, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.file = file
        self.token = secrets.token_urlsafe(24)
        self.paths = Paths()
        self.saving = threading.Lock()
        self.pages = {path.name: path.read_bytes() for path in _STATIC.iterdir() if path.suffix in _TYPES}
        self._readings: OrderedDict[str, Reading] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def hosts(self) -> tuple[str, str]:
        """What a request may call this server."""
        port = self.server_address[1]
        return f"127.0.0.1:{port}", f"localhost:{port}"

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self.hosts[0]}/{self.token}/"

    def reading(self, text: str) -> tuple[str, Reading]:
        """A name for ``text``, by which :meth:`remembered` finds it for a while, and what it says."""
        name = hashlib.sha256(text.encode()).hexdigest()[:24]
        with self._lock:
            known = self._readings.get(name)
        if known is None:
            known = read_world(text, self.file.path.stem)
        with self._lock:
            self._readings[name] = known
            self._readings.move_to_end(name)
            while len(self._readings) > _REMEMBERED:
                self._readings.popitem(last=False)
        return name, known

    def remembered(self, name: str) -> Reading | None:
        """A reading by the name of its text."""
        with self._lock:
            return self._readings.get(name)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that closes a connection half-way is no news."""


class _Handler(BaseHTTPRequestHandler):
    server: EditorServer
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "navsim", ""
    timeout = 60.0

    def do_GET(self) -> None:
        """Static files, and what the file on disk holds."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Questions, each a JSON object."""
        self._answer(self._post)

    def log_message(self, format: str, *args: Any) -> None:
        """The terminal belongs to the user."""

    def _answer(self, respond: Callable[[str], tuple[str, bytes]]) -> None:
        try:
            kind, body = respond(self._path())
            status = HTTPStatus.OK
        except RequestError as error:
            status, kind, body = error.status, _JSON, _json(error.answer)
        except WorldError as error:
            status, kind, body = HTTPStatus.CONFLICT, _JSON, _json({"error": str(error)})
        except EditError as error:
            status, kind, body = HTTPStatus.UNPROCESSABLE_ENTITY, _JSON, _json({"error": str(error)})
        except Exception as error:
            message = f"the editor made a mistake ({type(error).__name__}: {error}); please report it"
            status, kind, body = HTTPStatus.INTERNAL_SERVER_ERROR, _JSON, _json({"error": message})
        if status != HTTPStatus.OK:
            self.close_connection = True  # the request's body may not have been read
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _path(self) -> str:
        """What is asked for, of those who may ask."""
        if self.headers.get("Host") not in self.server.hosts:
            raise RequestError(HTTPStatus.FORBIDDEN, "this server answers to 127.0.0.1 and localhost only")
        origin = self.headers.get("Origin")
        if origin is not None and origin not in [f"http://{host}" for host in self.server.hosts]:
            raise RequestError(HTTPStatus.FORBIDDEN, "this server answers to its own page only")
        _, token, *rest = [*self.path.partition("?")[0].split("/", 2), ""]
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            raise RequestError(HTTPStatus.NOT_FOUND, "open the address that 'navsim world edit' has printed")
        return rest[0]

    def _get(self, path: str) -> tuple[str, bytes]:
        if path == "api/file":
            state = self.server.file.state()
            about = {"name": self.server.file.path.name, "path": str(self.server.file.path.absolute())}
            return _JSON, _json({**about, **state._asdict(), **equipment()})
        page = self.server.pages.get(path or "index.html")
        if page is None:
            raise RequestError(HTTPStatus.NOT_FOUND, f"there is no {path!r} here")
        return _TYPES[Path(path or "index.html").suffix], page

    def _post(self, path: str) -> tuple[str, bytes]:
        ask = self._question()
        if path == "api/read":
            return _JSON, _json(self._read(_text_of(ask)))
        if path == "api/edit":
            text = self._edited(_text_of(ask), ask.get("edits"))
            return _JSON, _json({"text": text, **self._read(text)})
        if path == "api/depth":
            world = self._reading(ask).world
            pose, (width, height) = _pose_of(ask), _size_of(ask)
            return "application/octet-stream", depth_millimetres(world, pose, width, height)
        if path == "api/paths":
            found = self.server.paths.of(self._reading(ask).world)
            return _JSON, _json({"stale": True} if found is None else found)
        if path == "api/oddities":
            return _JSON, _json({"problems": [problem(finding) for finding in oddities_of(self._reading(ask))]})
        if path == "api/save":
            return _JSON, _json(self._save(_text_of(ask), ask.get("stamp")))
        raise RequestError(HTTPStatus.NOT_FOUND, f"there is no {path!r} here")

    def _question(self) -> dict[str, Any]:
        if self.headers.get_content_type() != "application/json":
            raise RequestError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a question must be application/json")
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            raise RequestError(HTTPStatus.LENGTH_REQUIRED, "a question must say its length")
        if len(length) > 9 or int(length) > LARGEST_REQUEST:
            limit = LARGEST_REQUEST // 2**20
            raise RequestError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a question must not be longer than {limit} MiB")
        try:
            question = json.loads(self.rfile.read(int(length)), parse_constant=_refuse_constant)
        except (ValueError, RecursionError):
            raise RequestError(HTTPStatus.BAD_REQUEST, "the question is not JSON") from None
        if not isinstance(question, dict):
            raise RequestError(HTTPStatus.BAD_REQUEST, "a question must be a JSON object")
        return question

    def _read(self, text: str) -> dict[str, Any]:
        name, reading = self.server.reading(text)
        return {"world": name, **describe(reading)}

    def _edited(self, text: str, edits: Any) -> str:
        if not isinstance(edits, list) or len(edits) > MOST_EDITS:
            raise RequestError(HTTPStatus.BAD_REQUEST, f"'edits' must be a list of at most {MOST_EDITS} edits")
        if self.server.reading(text)[1].world is None:
            raise EditError("the text cannot be read; mend it, or undo, before you change the plan")
        return patched(text, edits)

    def _reading(self, ask: dict[str, Any]) -> Any:
        reading = self.server.remembered(str(ask.get("world")))
        if reading is None or reading.world is None:
            raise RequestError(HTTPStatus.GONE, "this world is no longer known; read its text again")
        return reading

    def _save(self, text: str, stamp: Any) -> dict[str, Any]:
        if not isinstance(stamp, str):
            raise RequestError(HTTPStatus.BAD_REQUEST, "'stamp' must name the state of the file that was edited")
        try:
            with self.server.saving:
                return {"stamp": self.server.file.save(text, stamp).stamp}
        except ChangedOnDiskError as error:
            raise RequestError(HTTPStatus.CONFLICT, str(error), disk=error.state._asdict()) from None
        except OSError as error:
            reason = error.strerror or type(error).__name__
            message = f"{self.server.file.path} cannot be written ({reason}); nothing has been changed"
            raise RequestError(HTTPStatus.FORBIDDEN, message) from None


_JSON = "application/json"


def _json(answer: Any) -> bytes:
    return json.dumps(answer, allow_nan=False).encode()


def _refuse_constant(name: str) -> None:
    raise ValueError(name)


def _text_of(ask: dict[str, Any]) -> str:
    text = ask.get("text")
    if not isinstance(text, str):
        raise RequestError(HTTPStatus.BAD_REQUEST, "'text' must be the text of a world file")
    try:
        length = len(text.encode())
    except UnicodeEncodeError:
        raise RequestError(HTTPStatus.BAD_REQUEST, "'text' holds half a character (a lone surrogate)") from None
    if length > LARGEST_TEXT:
        raise RequestError(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the text is longer than {LARGEST_TEXT // 2**20} MiB; split the world"
        )
    return text


def _pose_of(ask: dict[str, Any]) -> tuple[float, float, float]:
    pose = ask.get("pose")
    if not isinstance(pose, list) or len(pose) != 3 or not all(_is_finite(value) for value in pose):
        raise RequestError(HTTPStatus.BAD_REQUEST, "'pose' must be x, y (metres) and yaw (radians)")
    return float(pose[0]), float(pose[1]), float(pose[2])


def _is_finite(value: Any) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and abs(value) < 1e6 and math.isfinite(value)


def _size_of(ask: dict[str, Any]) -> tuple[int, int]:
    width, height = ask.get("width"), ask.get("height")
    if type(width) is not int or type(height) is not int or not (0 < width <= 4096 and 0 < height <= 4096):
        raise RequestError(HTTPStatus.BAD_REQUEST, "'width' and 'height' must be numbers of pixels")
    if width * height > LARGEST_IMAGE:
        raise RequestError(HTTPStatus.BAD_REQUEST, f"a depth image must not have more than {LARGEST_IMAGE} pixels")
    return width, height
