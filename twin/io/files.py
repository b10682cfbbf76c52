"""Files that appear whole or not at all."""

from __future__ import annotations

import io
import json
import math
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.errors import BadInput


def check_free(out: Path, force: bool) -> None:
    """Raises BadInput where a file may not or cannot be written."""
    if out.is_dir():
        raise BadInput(f"{out} is a folder: give the name of a file")
    if out.exists() and not force:
        raise BadInput(f"{out} is there already: choose another name, or overwrite it with `force=True`")
    check_place(out.parent)


def check_place(folder: Path) -> None:
    """Raises BadInput where nothing can be written into a folder."""
    if not folder.is_dir():
        raise BadInput(f"{folder} is not a folder: make it first, or choose another place")
    if not os.access(folder, os.W_OK):
        raise BadInput(f"{folder} may not be written to: choose another place")


def put(out: Path, content: str | bytes) -> None:
    """The file appears whole or not at all; text is UTF-8. Raises BadInput."""
    data = content.encode() if isinstance(content, str) else content
    try:
        handle, name = tempfile.mkstemp(dir=out.parent, prefix=f".{out.name[:50]}-")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            umask = os.umask(0)
            os.umask(umask)
            Path(name).chmod(0o666 & ~umask)
            Path(name).replace(out)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise BadInput(f"{out} cannot be written ({error.strerror}): choose another place") from None


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip archive in that order; the same files give the same bytes. What lies in `binaries` may be executed."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name)
            entry.create_system = 3
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o100755 if name.startswith("binaries/") else 0o100644) << 16
            archive.writestr(entry, content)
    return out.getvalue()


def _plain(value: Any) -> Any:
    """A value as JSON can hold it: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):  # a number of numpy's, which would be long to import here
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def json_text(value: Any) -> str:
    return json.dumps(_plain(value), indent=1, ensure_ascii=False) + "\n"
