"""Builds an FMU with pythonfmu, in a process of its own: the builder imports the slave that it packs."""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

SLAVE = Path(__file__).with_name("axis_fmu.py")


_DESCRIPTION = "modelDescription.xml"


def tidy(archive: bytes, description: bytes) -> bytes:
    """The same archive under this description, with sorted members and one date: same content, same bytes."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as old, zipfile.ZipFile(out, "w") as new:
        for name in sorted(old.namelist()):
            info = zipfile.ZipInfo(name)
            info.create_system = 3
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = (0o100755 if name.endswith((".so", ".dll", ".dylib")) else 0o100644) << 16
            # pythonfmu's own description has neither units nor bounds, and another GUID each time.
            new.writestr(info, description if name == _DESCRIPTION else old.read(name))
    return out.getvalue()


def pack(slave: str, identifier: str, resources: Mapping[str, str | bytes], description: bytes) -> bytes:
    """The FMU, as bytes, of a slave's text, its resource files and modelDescription.xml.

    `identifier` names module and binaries. Raises RuntimeError with what the builder said.
    """
    with tempfile.TemporaryDirectory(prefix="twin-pack-") as folder:
        sources = Path(folder) / "sources"
        sources.mkdir()
        for name, content in {f"{identifier}.py": slave, **resources}.items():
            (sources / name).write_bytes(content.encode() if isinstance(content, str) else content)
        target = Path(folder) / f"{identifier}.fmu"
        command = [sys.executable, "-P", __file__, str(sources / f"{identifier}.py"), str(target)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        if done.returncode or not target.exists():
            raise RuntimeError(f"pythonfmu could not build the FMU: {done.stderr.strip()[-500:]}")
        return tidy(target.read_bytes(), description)


def main(script: str, target: str) -> None:
    from pythonfmu import FmuBuilder

    source = Path(script)
    others = [path for path in source.parent.iterdir() if path.is_file() and path != source]
    FmuBuilder.build_FMU(source, dest=target, project_files=others)


if __name__ == "__main__":
    main(*sys.argv[1:])
