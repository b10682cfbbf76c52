"""Somebody else's FMU or model file: refused with one sentence or read, never run, never written outside."""

from __future__ import annotations

import io
import stat
import struct
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from native_axis import model_of

from twin.effects.catalogue import BASE
from twin.errors import BadInput
from twin.fmi import fmu_archive, python_fmu
from twin.fmi.fmu_archive import open_fmu, parse_xml
from twin.model.fitted_model import dumps, loads
from twin.model.stepper import Structure

MODEL = model_of(Structure.of((*BASE, "gravity")))
XML = (
    '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="a" guid="g">'
    '<CoSimulation modelIdentifier="a"/><ModelVariables><ScalarVariable name="x" valueReference="0" '
    'causality="input"><Real start="0"/></ScalarVariable></ModelVariables><ModelStructure/></fmiModelDescription>'
)
SLOW = settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return python_fmu.export(MODEL, tmp_path_factory.mktemp("fmu") / "axis.fmu").read_bytes()


def packed(members: dict[str | zipfile.ZipInfo, bytes | str], xml: str | bytes | None = XML) -> bytes:
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        if xml is not None:
            new.writestr("modelDescription.xml", xml)
        for name, content in members.items():
            new.writestr(name, content)
    return target.getvalue()


def refusal(tmp_path: Path, content: bytes) -> str:
    """The sentence with which the file is refused; nothing may appear beside it."""
    folder = tmp_path / "inner" / "most"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "other.fmu"
    path.write_bytes(content)
    with pytest.raises(BadInput) as caught, open_fmu(path).unpacked():
        pass
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [path]
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_plain_fmu_is_read(tmp_path):
    path = tmp_path / "a.fmu"
    path.write_bytes(packed({"resources/deep/er.txt": "hello", "resources/": b""}))
    fmu = open_fmu(path)
    assert (fmu.identifier, fmu.token, fmu.version, fmu.references()) == ("a", "g", 2, {"x": 0})
    with fmu.unpacked() as folder:
        assert (folder / "resources" / "deep" / "er.txt").read_text() == "hello"
        assert str(folder).isascii()
    assert not folder.exists()


@pytest.mark.parametrize(
    "name",
    [
        "../out.txt", "a/../../out.txt", "/abs.txt", "//host/x", "C:/x.txt", "C:x.txt", "..\\out.txt", "a\\b.txt",
        "a/./b.txt", "a//b.txt", "..", "resources/..", "x\0.txt",
    ],
)  # fmt: skip
def test_names_that_lead_outside(tmp_path, name):
    content = packed({"PLACEHOLDER": "x"})
    raw = name.encode()
    # zipfile cleans names when it writes, so ours is put into the bytes.
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w") as new:
        new.writestr("modelDescription.xml", XML)
        new.writestr("P" * len(raw), "x")
    content = target.getvalue().replace(b"P" * len(raw), raw)
    assert "outside its folder" in refusal(tmp_path, content)


def special(name: str, mode: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.create_system = 3
    info.external_attr = mode << 16
    return info


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFSOCK])
def test_links_and_devices(tmp_path, kind):
    assert "link or a device" in refusal(tmp_path, packed({special("resources/x", kind | 0o777): "/etc/passwd"}))


def test_names_twice_and_files_below_files(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate"):
        target = io.BytesIO()
        with zipfile.ZipFile(target, "w") as new:
            for name in ("modelDescription.xml", "x", "x"):
                new.writestr(name, XML)
    assert "twice" in refusal(tmp_path, target.getvalue())
    assert "twice" in refusal(tmp_path, packed({"A/x": "1", "a/X": "2"}))
    assert "below a file" in refusal(tmp_path, packed({"x": "1", "x/y": "2"}))
    assert "too long" in refusal(tmp_path, packed({"é" * 150: "1"}))


def test_archives_that_swell(tmp_path, monkeypatch):
    assert "times its size" in refusal(tmp_path, packed({"resources/zeros": b"\0" * (20 * 2**20)}))
    monkeypatch.setattr(fmu_archive, "MOST_BYTES", 2**20)
    assert "unpacks to" in refusal(tmp_path, packed({"resources/zeros": b"\0" * (2 * 2**20)}))
    monkeypatch.setattr(fmu_archive, "MOST_MEMBERS", 5)
    assert "members" in refusal(tmp_path, packed({str(i): "" for i in range(6)}))


def test_a_size_that_lies(tmp_path):
    """The header says 10 bytes; what comes out is more: it must not be believed, nor written."""
    content = bytearray(packed({"resources/zeros": b"\0" * 100_000}))
    whole = struct.pack("<I", 100_000)
    at = content.find(whole)
    while at >= 0:
        content[at : at + 4] = struct.pack("<I", 10)
        at = content.find(whole)
    assert refusal(tmp_path, bytes(content))


def test_encryption_and_other_packings(tmp_path):
    content = bytearray(packed({"resources/x": "secret"}))
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.rfind(mark) + offset] |= 1
    assert "encrypted" in refusal(tmp_path, bytes(content))
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_LZMA) as new:
        new.writestr("modelDescription.xml", XML)
    assert "use deflate" in refusal(tmp_path, target.getvalue())


LAUGHS = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))


@pytest.mark.parametrize(
    "xml, why",
    [
        (f'<!DOCTYPE x [<!ENTITY a0 "ha">{LAUGHS}]><x>&a11;</x>', "document type"),
        ('<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><x>&e;</x>', "document type"),
        ('<!DOCTYPE x SYSTEM "http://127.0.0.1:9/x.dtd"><x/>', "document type"),
        ("<a>" * 100 + "</a>" * 100, "deep"),
        ("<a", "not valid XML"),
        ("", "not valid XML"),
        ('<?xml version="1.0" encoding="utf-7"?><x/>', "not valid XML"),
        ('<?xml version="1.0" encoding="no-such"?><x/>', "not valid XML"),
        ("<x/>", "FMI version"),
        (XML.replace("2.0", "1.0", 1), "FMI version"),
        (XML.replace('fmiVersion="2.0"', 'fmiVersion="1.0"'), "FMI version is '1.0'"),
        (XML.replace('fmiVersion="2.0"', 'fmiVersion="9"'), "FMI version"),
        (XML.replace("CoSimulation", "ModelExchange"), "not for co-simulation"),
        (XML.replace('modelIdentifier="a"', 'modelIdentifier="../../x"'), "C identifier"),
    ],
)
def test_descriptions_that_are_refused(tmp_path, xml, why):
    assert why in refusal(tmp_path, packed({}, xml))


def test_descriptions_that_are_absent_or_too_large(tmp_path, monkeypatch):
    assert "no modelDescription.xml" in refusal(tmp_path, packed({"x": "1"}, None))
    monkeypatch.setattr(fmu_archive, "MOST_DESCRIPTION", 2000)
    assert "unpacks to more" in refusal(tmp_path, packed({}, XML + " " * 2000))


def test_a_million_variables(tmp_path):
    many = "<s/>" * (fmu_archive.MOST_VARIABLES + 1)
    xml = f"<fmiModelDescription><ModelVariables>{many}</ModelVariables></fmiModelDescription>"
    with pytest.raises(BadInput, match="more than 1000000 variables"):
        parse_xml("x", xml.encode())


def test_declarations_in_other_descriptions(tmp_path):
    bomb = '<!DOCTYPE x [<!ENTITY a "ha">]><x>&a;</x>'
    for name in ("sources/buildDescription.xml", "terminalsAndIcons/terminalsAndIcons.xml"):
        assert "document type" in refusal(tmp_path, packed({name: bomb}))


@pytest.mark.parametrize("content", [b"", b"PK", b"not a zip", b"\0" * 1000, b"PK\x05\x06" + b"\0" * 18])
def test_what_is_no_archive(tmp_path, content):
    assert refusal(tmp_path, content)


def test_what_is_no_file(tmp_path):
    with pytest.raises(BadInput, match="folder"):
        open_fmu(tmp_path)
    with pytest.raises(BadInput, match="no such FMU"):
        open_fmu(tmp_path / "absent.fmu")


def test_an_importers_folder_is_plain_even_where_the_temporary_one_is_not(tmp_path, monkeypatch):
    odd = tmp_path / "Jürgen #1"
    odd.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(odd))
    folder = fmu_archive.plain_folder()
    try:
        assert fmu_archive._PLAIN.fullmatch(str(folder))
    finally:
        folder.rmdir()


# ---- fuzzing: BadInput or success, nothing else ----


def read_all(path: Path) -> None:
    """Everything that reads an FMU without running it."""
    try:
        fmu = open_fmu(path)
        fmu.references()
        with fmu.unpacked() as folder:
            inside = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
            assert inside <= set(fmu.members)
        python_fmu.update(path, python_fmu.read_model(path), path.with_name("new.fmu"))
    except BadInput as error:
        assert "\n" not in str(error)


edits = st.lists(st.tuples(st.floats(0.0, 1.0), st.binary(min_size=0, max_size=6), st.integers(0, 6)), max_size=6)


def damaged(content: bytes, changes: list[tuple[float, bytes, int]]) -> bytes:
    text = bytearray(content)
    for place, fresh, gone in changes:
        at = int(place * len(text))
        text[at : at + gone] = fresh
    return bytes(text)


@SLOW
@given(edits)
def test_fuzz_archive(ours, tmp_path_factory, changes):
    """Most of an FMU is binary rubbish to begin with; the end, with its directory, is where damage tells."""
    small = packed({"resources/model.toml": dumps(MODEL), "resources/a/b": "c"})
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / "a.fmu"
    path.write_bytes(damaged(small, changes))
    read_all(path)


@SLOW
@given(edits, st.booleans())
def test_fuzz_description(ours, tmp_path_factory, changes, own):
    folder = tmp_path_factory.mktemp("fuzz")
    with zipfile.ZipFile(io.BytesIO(ours)) as opened:
        xml = opened.read("modelDescription.xml") if own else XML.encode()
    path = folder / "a.fmu"
    path.write_bytes(packed({"resources/model.toml": dumps(MODEL)}, damaged(xml, changes)))
    read_all(path)


@SLOW
@given(edits)
def test_fuzz_model_file(tmp_path_factory, changes):
    text = damaged(dumps(MODEL).encode(), changes).decode("utf-8", "replace")
    try:
        model = loads(text)
    except BadInput as error:
        assert "\n" not in str(error)
    else:
        loads(dumps(model))


toml_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def as_toml(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return str(bool(value)).lower()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{quoted(k)} = {as_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return quoted(value) if isinstance(value, str) else repr(value)


def quoted(text: str) -> str:
    return '"' + "".join(c if c.isalnum() and c.isascii() else f"\\u{min(ord(c), 0xD7FF):04x}" for c in text) + '"'


@SLOW
@given(st.integers(0, 200), toml_values)
def test_fuzz_values_of_the_model_file(line, value):
    """Any value of any type in the place of any other."""
    lines = dumps(MODEL).splitlines()
    places = [i for i, text in enumerate(lines) if " = " in text and not text.endswith("[")]
    at = places[line % len(places)]
    lines[at] = f"{lines[at].split(' = ')[0]} = {as_toml(value)}"
    try:
        loads("\n".join(lines))
    except BadInput as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[noise]", "[noize]", "unknown key 'noize'; did you mean 'noise'?"),
        ("resolution = ", "resolutions = ", "[axis]: unknown key 'resolutions'; did you mean 'resolution'?"),
        ("resolution = ", "resolution = -", "[axis] resolution is -0.001: give 0 or more"),
        ("reading_std = ", "reading_std = -", "[noise] reading_std is -0.002: give 0 or more"),
        ("torque_density = ", "torque_density = -", "[noise] torque_density is -0.003: give 0 or more"),
        ("reads_speed = false", "reads_speed = 0", "[axis] reads_speed is 0: use true or false"),
        (
            "\nvalue = ", '\n"va\\nlue" = 1.0\nvalue = ',
            "[parameters.input_gain]: unknown key 'va\\nlue'; did you mean 'value'?",
        ),
        ("effects = ", "effect = [1]\neffects = ", "[structure]: unknown key 'effect'; did you mean 'effects'?"),
        ("matrix = ", "matrices = 1\nmatrix = ", "[covariance]: unknown key 'matrices'; did you mean 'matrix'?"),
    ],
)  # fmt: skip
def test_what_a_model_file_says_is_heeded_or_refused(old, new, says):
    text = dumps(replace(MODEL, resolution=1e-3, reading_std=2e-3, torque_density=3e-3))
    loads(text)
    assert old in text
    with pytest.raises(BadInput) as caught:
        loads(text.replace(old, new, 1), "MODEL.toml")
    assert str(caught.value) == f"MODEL.toml: {says}"
