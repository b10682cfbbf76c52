"""Opening somebody's FMU: nothing is run, and nothing is written outside a folder of our own.

Every reader of FMUs goes through `open_fmu`, which refuses hostile archives and XML. These are names that lead out of
the folder, links, encrypted members, archives and descriptions that swell, and declarations of entities.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import stat
import struct
import tempfile
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.parsers import expat

from twin.errors import BadInput

MOST_BYTES = 512 * 2**20  # unpacked
MOST_DESCRIPTION = 64 * 2**20
MOST_MEMBERS = 20_000
MOST_VARIABLES = 1_000_000
MOST_SWELLING = 200  # unpacked over packed, once that is more than SMALL
SMALL = 16 * 2**20
MOST_DEPTH = 64
_PLAIN = re.compile(r"[A-Za-z0-9_./:\\~-]+")
_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    OSError,
    ValueError,
    OverflowError,
    NotImplementedError,
    RuntimeError,
    struct.error,
)


@dataclass(frozen=True)
class Fmu:
    """An FMU whose names, sizes and model description have been checked.

    `members` are its files (no folders), `description` the root of modelDescription.xml, `version` 2 or 3.
    """

    path: Path
    members: tuple[str, ...]
    description: ET.Element
    version: int

    @property
    def identifier(self) -> str:
        """Name of module and binaries."""
        found = self.description.find("CoSimulation")
        return "" if found is None else found.get("modelIdentifier", "")

    @property
    def token(self) -> str:
        """FMI 2's GUID, FMI 3's instantiation token."""
        return self.description.get("guid" if self.version == 2 else "instantiationToken", "")

    def unit(self, name: str) -> str:
        """The unit of a variable; empty where there is none, or no such variable."""
        for node in self.description.findall("ModelVariables/*"):
            if node.get("name") == name:
                typed = node.find("Real")
                return (node if typed is None else typed).get("unit", "")
        return ""

    def references(self) -> dict[str, int]:
        """Value references by name. Raises BadInput."""
        found = {}
        for node in self.description.findall("ModelVariables/*"):
            reference = node.get("valueReference", "")
            if not re.fullmatch(r"\d{1,10}", reference, re.ASCII):
                raise BadInput(
                    f"{self.path}: variable {node.get('name')!r} has the value reference {reference!r}, "
                    "which is not a number: export the FMU again"
                )
            found[node.get("name", "")] = int(reference)
        return found

    def read(self, name: str, most: int = MOST_DESCRIPTION) -> bytes:
        """One member. Raises BadInput where it is absent, damaged or larger than `most` bytes."""
        if name not in self.members:
            raise BadInput(f"{self.path} has no {name}: give an FMU that twin export wrote")
        try:
            with zipfile.ZipFile(self.path) as archive:
                return _read(self.path, archive, name, most)
        except _BROKEN as error:
            raise BadInput(f"{self.path}: {name} cannot be read ({error}): the archive is damaged") from None

    @contextmanager
    def unpacked(self) -> Iterator[Path]:
        """A folder of our own that holds the FMU's files, removed at the end. Raises BadInput."""
        folder = plain_folder()
        try:
            self._unpack(folder)
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _unpack(self, folder: Path) -> None:
        left = MOST_BYTES
        try:
            with zipfile.ZipFile(self.path) as archive:
                for name in self.members:
                    target = folder.joinpath(*name.split("/"))
                    target.parent.mkdir(parents=True, exist_ok=True)
                    content = _read(self.path, archive, name, left)
                    left -= len(content)
                    target.write_bytes(content)
        except _BROKEN as error:
            raise BadInput(f"{self.path} cannot be unpacked ({error}): the archive is damaged") from None


def rewritten(fmu: Fmu, fresh: Mapping[str, bytes], gone: Collection[str] = ()) -> bytes:
    """The archive with these members in the place of the old, and new ones behind; every other byte of content stays.

    What is in `gone` and not in `fresh` is left out. Raises BadInput where a member cannot be read.
    """
    target = io.BytesIO()
    with zipfile.ZipFile(fmu.path) as old, zipfile.ZipFile(target, "w") as new:
        new.comment = old.comment
        for info in old.infolist():
            if info.filename in gone and info.filename not in fresh:
                continue
            kept = b"" if info.is_dir() else fmu.read(info.filename, info.file_size)
            new.writestr(info, fresh.get(info.filename, kept))
        for name in [name for name in fresh if name not in fmu.members]:
            info = zipfile.ZipInfo(name)
            info.create_system = 3
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o100644 << 16
            new.writestr(info, fresh[name])
    return target.getvalue()


def plain_folder() -> Path:
    """A new temporary folder whose path needs no escaping, over which wrappers stumble. Raises BadInput."""
    for place in (tempfile.gettempdir(), "/tmp", "/var/tmp", os.environ.get("PUBLIC", ""), str(Path.cwd())):
        if _PLAIN.fullmatch(place) and os.access(place, os.W_OK):
            return Path(tempfile.mkdtemp(prefix="twin-", dir=place))
    raise BadInput(
        f"the folder for temporary files, {tempfile.gettempdir()}, has characters that FMUs cannot be loaded "
        "from: set TMPDIR to one of plain letters and digits"
    )


def _read(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """A member, however large its header says it is."""
    with archive.open(name) as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        raise BadInput(f"{path}: {name} unpacks to more than {most / 2**20:.0f} MB: this is no FMU to trust")
    return content


def _check_name(path: Path, info: zipfile.ZipInfo) -> None:
    name = info.orig_filename
    steps = name.removesuffix("/").split("/")
    if "\\" in name or ":" in name or "\0" in name or any(step in ("", ".", "..") for step in steps):
        raise BadInput(f"{path}: member {name[:200]!r} would be written outside its folder: this is no FMU to trust")
    if len(name) > 500 or any(len(step.encode()) > 200 for step in steps):
        raise BadInput(f"{path}: member {name[:60]!r}... has a name too long to unpack: this is no FMU to trust")
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise BadInput(f"{path}: member {name!r} is a link or a device, not a file: this is no FMU to trust")
    if info.flag_bits & 0x1:
        raise BadInput(f"{path}: member {name!r} is encrypted: save the FMU without a password")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise BadInput(f"{path}: member {name!r} is packed in a way that FMI does not allow: use deflate")


def _check_archive(path: Path, infos: list[zipfile.ZipInfo], size: int) -> tuple[str, ...]:
    if len(infos) > MOST_MEMBERS:
        raise BadInput(f"{path} has {len(infos)} members, more than {MOST_MEMBERS}: this is no FMU to trust")
    files: set[str] = set()
    for info in infos:
        _check_name(path, info)
        if info.filename.lower() in files:
            raise BadInput(f"{path}: member {info.filename!r} is there twice: pack the FMU again")
        files.add(info.filename.lower())
    for info in infos:
        parts = info.filename.removesuffix("/").lower().split("/")
        if any("/".join(parts[:i]) in files for i in range(1, len(parts))):
            raise BadInput(f"{path}: member {info.filename!r} lies below a file: pack the FMU again")
    total = sum(info.file_size for info in infos)
    if total > MOST_BYTES:
        raise BadInput(
            f"{path} unpacks to {total / 2**20:.0f} MB, above {MOST_BYTES // 2**20}: this is no FMU to trust"
        )
    if total > SMALL and total > MOST_SWELLING * max(size, 1):
        raise BadInput(f"{path} unpacks to {total / max(size, 1):.0f} times its size: this is no FMU to trust")
    return tuple(info.filename for info in infos if not info.is_dir())


class _Refused(Exception):
    """What is wrong with an XML text."""


def _check_xml(text: bytes) -> None:
    """Raise _Refused for declarations, depth and too many variables; expat.ExpatError where it is not XML."""
    depth = variables = 0

    def start(name: str, attributes: object) -> None:
        nonlocal depth, variables
        depth += 1
        if depth > MOST_DEPTH:
            raise _Refused(f"is nested more than {MOST_DEPTH} deep")
        if depth == 3:
            variables += 1
            if variables > MOST_VARIABLES:
                raise _Refused(f"lists more than {MOST_VARIABLES} variables")

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    def declaration(*_: object) -> None:
        raise _Refused("declares a document type, as entity bombs do")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = declaration
    parser.EntityDeclHandler = declaration
    parser.Parse(text, True)


def parse_xml(where: str, text: bytes) -> ET.Element:
    """An XML text as a tree, checked first. Raises BadInput."""
    try:
        _check_xml(text)
        return ET.fromstring(text)
    except _Refused as error:
        raise BadInput(f"{where} {error}: this is no FMU to trust") from None
    except (expat.ExpatError, ET.ParseError, ValueError, LookupError) as error:
        raise BadInput(f"{where} is not valid XML ({error}): export the FMU again") from None


def open_fmu(path: Path) -> Fmu:
    """Check an FMU and read its model description; nothing of it is run. Raises BadInput."""
    if path.is_dir():
        raise BadInput(f"{path} is a folder, not an FMU: name the .fmu file")
    try:
        size = path.stat().st_size
        with zipfile.ZipFile(path) as archive:
            members = _check_archive(path, archive.infolist(), size)
            if "modelDescription.xml" not in members:
                raise BadInput(f"{path} has no modelDescription.xml: it is a zip file, but not an FMU")
            text = _read(path, archive, "modelDescription.xml", MOST_DESCRIPTION)
            for name in members:
                # Importers read these too, and not every XML reader refuses declarations.
                if name.endswith(".xml") and name != "modelDescription.xml":
                    parse_xml(f"{path}: {name}", _read(path, archive, name, MOST_DESCRIPTION))
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such FMU: check the name, or make one with twin export") from None
    except PermissionError:
        raise BadInput(f"{path} cannot be read: check its permissions") from None
    except _BROKEN as error:
        raise BadInput(f"{path} is not an FMU, which is a zip file ({error}): give a .fmu file") from None
    root = parse_xml(f"{path}: modelDescription.xml", text)
    version = root.get("fmiVersion", "")
    if root.tag != "fmiModelDescription" or not re.fullmatch(r"2\.0|3\.\d.*", version):
        raise BadInput(f"{path}: FMI version is {version!r}: give an FMU of FMI 2 or 3")
    simulation = root.find("CoSimulation")
    if simulation is None or not re.fullmatch(r"[A-Za-z_]\w*", simulation.get("modelIdentifier", ""), re.ASCII):
        raise BadInput(
            f"{path} is not for co-simulation, or its name is not a C identifier: export it for co-simulation"
        )
    return Fmu(path, members, root, int(version.split(".")[0]))
