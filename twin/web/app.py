"""The server of the page: routes, what they refuse, and how it is run.

It listens on 127.0.0.1 alone. Another page in the same browser must not reach it. So the Host header has to name this
machine: a name that is rebound to 127.0.0.1 does not. A request that changes anything has to come from its own page.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from twin.errors import BadInput
from twin.io.files import json_text
from twin.report import panels, style
from twin.web.session import Session
from twin.web.worker import EXPORTS

#: The largest log, and the largest other request, bytes.
MAX_LOG, MAX_REQUEST = 256 * 2**20, 2**16
#: Endings of logs; they say what format a file is.
ENDINGS = (
    ".csv", ".txt", ".tsv", ".parquet", ".pq", ".mat", ".h5", ".hdf5", ".mf4", ".mdf", ".mcap", ".db3", ".json",
    ".wpilog",
)  # fmt: skip
HOSTS = ["127.0.0.1", "localhost"]
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
#: Files of the page, by their address.
PAGES = {"/": "page.html", "/page.js": "page.js", "/page.css": "page.css", "/result.js": "result.js"}


@cache
def _page(name: str) -> str:
    return files("twin.web").joinpath(name).read_text(encoding="utf-8")


@cache
def _policy() -> str:
    """What a page of this server may load: its own files, and the report's script by its digest."""
    digest = base64.b64encode(hashlib.sha256(panels.script().encode()).digest()).decode("ascii")
    return (
        f"default-src 'none'; script-src 'self' 'sha256-{digest}'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    )


class Guard:
    """Refuses what changes something and comes from another page; forbids other pages to show or read anything."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        own = f"http://{request.headers.get('host')}"
        if request.method not in ("GET", "HEAD") and request.headers.get("origin") != own:
            refused = _refused("this request comes from another page: open the page of twin serve itself", 403)
            await refused(scope, receive, send)
            return

        async def send_guarded(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] += [
                    (b"content-security-policy", _policy().encode()), (b"x-content-type-options", b"nosniff"),
                    (b"cross-origin-resource-policy", b"same-origin"), (b"referrer-policy", b"no-referrer"),
                    (b"cache-control", b"no-store"),
                ]  # fmt: skip
            await send(message)

        await self.app(scope, receive, send_guarded)


def _answer(told: Any, status: int = 200) -> Response:
    return Response(json_text(told), status, media_type="application/json")


def _refused(sentence: str, status: int) -> Response:
    return JSONResponse({"problem": sentence}, status)


async def _body(request: Request, most: int) -> bytes:
    """The whole of a small request. Raises BadInput where it is larger."""
    got = bytearray()
    async for chunk in request.stream():
        got += chunk
        if len(got) > most:
            raise BadInput(f"the request is larger than {most} bytes")
    return bytes(got)


async def _told(request: Request) -> dict[str, Any]:
    """What a request says, as JSON. Raises BadInput."""
    try:
        told = json.loads(await _body(request, MAX_REQUEST))
    except ValueError:
        told = None
    if not isinstance(told, dict):
        raise BadInput("the request is no JSON object: reload the page")
    return told


async def _received(request: Request, out: Path) -> bool:
    """Write what comes into a file; whether all of it was within the limit."""
    size = 0
    with out.open("wb") as file:
        async for chunk in request.stream():
            size += len(chunk)
            if size > MAX_LOG:
                return False
            file.write(chunk)
    return True


class Site:
    """What the routes share: the one log that is worked on."""

    def __init__(self) -> None:
        self._session: Session | None = None

    def session(self) -> Session:
        if self._session is None:
            raise BadInput("there is no recording: drop one")
        return self._session

    def close(self) -> None:
        if self._session is not None:
            self._drop(self._session)

    async def page(self, request: Request) -> Response:
        name = PAGES[request.url.path]
        return Response(_page(name), media_type=_TYPES[name[name.rindex(".") :]])

    async def icon(self, _: Request) -> Response:
        return Response(status_code=204)

    async def style(self, request: Request) -> Response:
        """The report's style sheet, or its script."""
        if request.url.path == "/report.css":
            return Response(style.CSS, media_type="text/css")
        return Response(panels.script(), media_type="text/javascript")

    async def upload(self, request: Request) -> Response:
        """Keep a log, and say what its columns are. Of its name only the ending is used, and shown what it says."""
        name = re.split(r"[/\\]", request.query_params.get("name", ""))[-1][:120] or "recording"
        plain = name.lower().removesuffix(".gz")
        ending = next((e for e in ENDINGS if plain.endswith(e)), None)
        if ending is None:
            raise BadInput(f"{name} is no recording by its ending: drop one of {', '.join(ENDINGS)}")
        if int(request.headers.get("content-length", "0")) > MAX_LOG:
            return _refused(_TOO_LARGE.format(name), 413)
        self.close()
        session = self._session = Session(name, ending + (".gz" if name.lower().endswith(".gz") else ""))
        try:
            if not await _received(request, session.log):
                self._drop(session)
                return _refused(_TOO_LARGE.format(name), 413)
            return _answer(await run_in_threadpool(session.look))
        except BaseException:
            self._drop(session)
            raise

    def _drop(self, session: Session) -> None:
        """End a session; a newer one stays."""
        session.close()
        if self._session is session:
            self._session = None

    async def state(self, request: Request) -> Response:
        """Where the work stands: enough to build the page anew."""
        session = self._session
        return _answer({"state": "empty"} if session is None else {"state": session.state, "looked": session.looked})

    async def choose(self, request: Request) -> Response:
        return _answer(await run_in_threadpool(self.session().choose, await _told(request)))

    async def search(self, request: Request) -> Response:
        await run_in_threadpool(self.session().search)
        return _answer({})

    async def stop(self, request: Request) -> Response:
        await run_in_threadpool(self.session().stop)
        return _answer({})

    async def watch(self, request: Request) -> Response:
        """The events of the search from a number on."""
        session, since = self.session(), request.query_params.get("since", "0")
        begin = int(since) if since.isdecimal() and len(since) < 10 else 0
        return _answer({"state": session.state, "problem": session.problem, "events": session.events[begin:]})

    async def sliders(self, request: Request) -> Response:
        session = self.session()
        return _answer({"name": session.name, "files": list(session.files()), **session.result})

    async def simulate(self, request: Request) -> Response:
        return _answer(await run_in_threadpool(self.session().simulate, await _told(request)))

    async def result(self, request: Request) -> Response:
        """The report with what only a server can do beside it."""
        report = self.session().files().get("report.html")
        if report is None:
            raise BadInput("there is no result yet: begin the search, or wait for its end")
        page = report.read_text(encoding="utf-8")
        more = '<link rel="stylesheet" href="/page.css"><script src="/result.js"></script></body>'
        return Response(page.replace("</body>", more), media_type="text/html")

    async def download(self, request: Request) -> Response:
        """A file of the result by its name, which is looked up and never opened."""
        name, session = request.path_params["name"], self.session()
        known = session.files()
        path = await run_in_threadpool(session.export, name) if name in EXPORTS else known.get(name)
        if path is None:
            return _refused("there is no such file", 404)
        return FileResponse(path, filename=name, media_type="application/octet-stream")


_TOO_LARGE = "{} is larger than 256 MiB: give it to twin run, or drop a part of it"


def make_app() -> Starlette:
    """The page as an application; its end removes what was kept."""
    site = Site()

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        site.close()

    async def bad_input(_: Request, error: Exception) -> Response:
        return _refused(str(error), 400)

    get: dict[str, Callable[[Request], Awaitable[Response]]] = {
        **dict.fromkeys(PAGES, site.page), "/report.css": site.style, "/explorer.js": site.style,
        "/state": site.state, "/watch": site.watch, "/sliders": site.sliders, "/result": site.result,
        "/files/{name}": site.download, "/favicon.ico": site.icon,
    }  # fmt: skip
    post = {
        "/log": site.upload, "/rig": site.choose, "/search": site.search, "/stop": site.stop,
        "/simulate": site.simulate,
    }  # fmt: skip
    routes = [Route(path, endpoint) for path, endpoint in get.items()]
    routes += [Route(path, endpoint, methods=["POST"]) for path, endpoint in post.items()]
    guards = [Middleware(TrustedHostMiddleware, allowed_hosts=HOSTS, www_redirect=False), Middleware(Guard)]
    return Starlette(routes=routes, middleware=guards, lifespan=lifespan, exception_handlers={BadInput: bad_input})


def listen(port: int) -> socket.socket:
    """A socket that listens on 127.0.0.1; port 0 is any that is free. Raises BadInput."""
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind(("127.0.0.1", port))
        made.listen()  # who reads the address may ask at once
    except (OSError, OverflowError) as error:
        made.close()
        said = getattr(error, "strerror", None) or "it is no port"
        raise BadInput(f"port {port} cannot be used ({said}): give another as `port`, or 0 for any free one") from None
    return made


def serve(listening: socket.socket) -> None:
    """Answer on a socket until the process is told to end."""
    settings = uvicorn.Config(
        make_app(), log_level="warning", access_log=False, server_header=False, timeout_graceful_shutdown=3
    )
    uvicorn.Server(settings).run(sockets=[listening])
