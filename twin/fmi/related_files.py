"""Files that an FMU carries beside what runs, by the layered standard FMI-LS-REF 1.0.

They lie in `extra/org.fmi-standard.fmi-ls-ref`, and a manifest there says what each is for: a role such as `result` or
`report`, a MIME type, a sentence. Importers that do not know the standard pass over that folder.
"""

from __future__ import annotations

import posixpath
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from twin.fmi.fmu_archive import Fmu, parse_xml
from twin.fmi.model_description import built_at, text
from twin.fmi.ssp import parameter_set
from twin.model.fitted_model import Model, dumps

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
_MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
_PAGE = "documentation/fmi-ls-ref.txt"
_SPACE = "http://fmi-standard.org/fmi-ls-manifest"
_NAME = "org.fmi-standard.fmi-ls-ref"
#: What the text of 1.0.0-beta.1 asks for.
_VERSION = "1.0.0-alpha.1"
_SAYS = "Layered Standard providing information on related files included in an FMU."
_HISTORY = "history"


@dataclass(frozen=True)
class Related:
    """A file that the manifest lists: where it lies from the manifest's folder, its MIME type, its role, a sentence."""

    source: str
    kind: str
    role: str
    says: str


def related(fmu: Fmu) -> list[Related]:
    """What the manifest lists; empty where there is none. Raises BadInput."""
    if _MANIFEST not in fmu.members:
        return []
    root = parse_xml(f"{fmu.path}: {_MANIFEST}", fmu.read(_MANIFEST))
    names = ("source", "type", "role", "description")
    return [Related(*(node.get(name, "") for name in names)) for node in root.findall("Related")]


def member(source: str) -> str:
    """The name in the archive of what a manifest calls `source`."""
    return posixpath.normpath(posixpath.join(FOLDER, source))


def _manifest(listed: Sequence[Related]) -> bytes:
    ET.register_namespace("fmi-ls", _SPACE)
    said = {"fmi-ls-name": _NAME, "fmi-ls-version": _VERSION, "fmi-ls-description": _SAYS}
    root = ET.Element("fmiReferences", {f"{{{_SPACE}}}{name}": value for name, value in said.items()})
    for r in listed:
        ET.SubElement(root, "Related", type=r.kind, source=r.source, role=r.role, description=r.says)
    return text(root)


def files(fmu: Fmu, added: Mapping[Related, bytes], gone: Collection[str] = ()) -> dict[str, bytes]:
    """The members of the archive that are to be written so that it carries these, too.

    What has the same source is replaced; the manifest lists no sources that are `gone`. Raises BadInput where the
    manifest that is there cannot be read.
    """
    sources = {*gone, *(r.source for r in added)}
    listed = [*(r for r in related(fmu) if r.source not in sources), *added]
    page = ["What this FMU carries besides what runs (FMI-LS-REF 1.0):", "", *(f"{r.source}: {r.says}" for r in listed)]
    written = {member(r.source): content for r, content in added.items()}
    return written | {_MANIFEST: _manifest(listed), _PAGE: ("\n".join(page) + "\n").encode()}


def past(fmu: Fmu, old: Model) -> dict[Related, bytes]:
    """The parameters that an update replaces, as a model with its standard errors and as an SSP parameter set."""
    number = 1 + sum(r.source.startswith(f"{_HISTORY}/") and r.kind == "application/toml" for r in related(fmu))
    name, when = f"{_HISTORY}/{number:04d}", f", {at}" if (at := built_at()) else ""
    says = f"before update {number}{when}"
    return {
        Related(f"{name}.toml", "application/toml", "model", f"Model with its standard errors {says}"): dumps(
            old
        ).encode(),
        Related(f"{name}.ssv", "application/x-ssp-parameter-set", "parameter", f"Parameters {says}"): parameter_set(
            old
        ),
    }
