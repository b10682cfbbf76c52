"""`twin serve`: the page in the browser."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress

from twin.cli.command import Command
from twin.cli.output import answer_user
from twin.errors import BadInput, install

PORT = 8000


def _serve(args: argparse.Namespace) -> int:
    try:
        from twin.web import app
    except ModuleNotFoundError as missing:
        raise BadInput(f"twin serve needs {missing.name}: {install('web', 'starlette', 'uvicorn')}") from None
    listening = app.listen(args.port)
    address = f"http://127.0.0.1:{listening.getsockname()[1]}/"
    said = [f"Open {address} in a browser of this machine. Ctrl+C ends it, and removes what was uploaded."]
    answer_user(args, said, {"format": "twin-serve/1", "address": address})
    sys.stdout.flush()  # who started it through a pipe waits for the address
    with suppress(KeyboardInterrupt):  # the usual end
        app.serve(listening)
    return 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    said = f"where the page is, on 127.0.0.1; default: {PORT}; 0: any free one"
    parser.add_argument("--port", type=int, default=PORT, metavar="N", help=said)


COMMAND = Command(
    "serve", "the page in a browser: drop a log, set up the rig file, watch the search, explore", _add_arguments, _serve
)
