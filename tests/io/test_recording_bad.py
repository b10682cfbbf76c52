"""Bad input: one clear line that says what is wrong, where and what to do; never anything but BadInput."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from twin.errors import BadInput
from twin.io.recording import Recording, load, read_rig

RIG = """
[time]
column = "t"
[input]
column = "duty"
unit = "%"
[output]
column = "pos"
unit = "rad"
"""


def rows(count: int = 80) -> list[str]:
    return [f"{0.01 * k:.3f},{10 * (k // 20 % 2)},{math.sin(0.05 * k):.5f}" for k in range(count)]


def csv(lines: list[str] | None = None, header: str = "t,duty,pos") -> str:
    return "\n".join([header, *(rows() if lines is None else lines)]) + "\n"


def changed(at: int, line: str) -> str:
    lines = rows()
    lines[at] = line
    return csv(lines)


def refused(folder: Path, log: bytes | str, rig: str = RIG, name: str = "log.csv") -> str:
    path = folder / name
    path.write_bytes(log.encode() if isinstance(log, str) else log)
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        load([path])
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_good_file_is_good(tmp_path: Path) -> None:
    """What all the cases below start from must load, or they would be refused for another reason."""
    (tmp_path / "log.csv").write_text(csv())
    (tmp_path / "rig.toml").write_text(RIG)
    (recording,), _ = load([tmp_path / "log.csv"])
    assert recording.time.size == 80
    assert recording.faults == ()


def test_a_name_with_line_breaks_is_told_in_one_line(tmp_path: Path) -> None:
    for k, mark in enumerate("\n\r\v\f\x1c\x85"):
        scipy.io.savemat(tmp_path / "made.mat", {"t": np.arange(80.0), f"du{mark}ty": np.arange(80.0)})
        said = refused(tmp_path, (tmp_path / "made.mat").read_bytes(), name=f"{k}.mat")
        assert "no column 'pos'" in said and len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (csv(header="t,pwm,pos"), ["no column 'duty'", "t, pwm, pos", "[input]"]),
        (csv(header="t,Duty,pos"), ["no column 'duty'", "did you mean 'Duty'?"]),
        (changed(79, "1e9,10,0.1"), ["line 81", "'t'", "1e+09 s after"]),
        (changed(30, "0.300,65535,0.1"), ["line 32", "'duty'", "65535 %", "beyond full drive"]),
        (csv([f"{2 * k},{k % 3},{k}" for k in range(80)]), ["'t'", "2 s from sample to sample", "ms"]),
        (
            csv([f"{2000 * k},{k % 3},{k}" for k in range(80)]),
            ["2000 s from sample", 'say unit = "us"', "makes it 2 ms"],
        ),
        (csv([f"{2 * k}e-12,{k % 3},{k}" for k in range(80)]), ["0.002 ns from sample", "too short"]),
        (csv([f"{(k % 2 * 2 - 1)}e308,{k % 3},{k}" for k in range(80)]), ["line 3", "1e+308 is no time stamp"]),
        (csv([f"{0.01 * k:.2f},{k % 3},{(k % 2 * 2 - 1)}e308" for k in range(80)]), ["'pos': -1e+308"]),
        (csv([f"{0.01 * k:.2f},{(k % 2 * 2 - 1)}e308,{k}" for k in range(80)]), ["input holds no number"]),
        (changed(30, "0.300,10,abc"), ["log.csv", "line 32", "'pos'", "'abc'", "is no number"]),
        (changed(30, "0.300,1O,0.1"), ["line 32", "'duty'", "'1O'", "correct or empty it"]),
        (changed(30, "2024-01-01T10:00:00,10,0.1"), ["line 32", "times in seconds", "sample_time"]),
        (changed(30, '0.300,"10,5",0.1'), ["line 32", "'10,5'", "decimal point"]),
        (changed(40, "0.350,0,0.1"), ["line 42", "backwards", "0.35", "0.39"]),
        (changed(40, "0.400,0"), ["line 42", "2 cells", "header 3"]),
        (changed(40, "0.400,0,1,2"), ["line 42", "4 cells", "header 3"]),
        (csv([line.replace(",10,", ",0,") for line in rows()]), ["input is 0 all the time"]),
        (csv([",".join([*line.split(",")[:2], "0.5"]) for line in rows()]), ["output is 0.5 all the time"]),
        (csv([",".join([*line.split(",")[:2], ""]) for line in rows()]), ["'pos' holds no number"]),
        ("", ["is empty"]),
        ("\n\n", ["is empty"]),
        ("t,duty,pos\n", ["only a header"]),
        ("\n".join(rows()), ["no column 'pos'", "no header", "1, 2, 3"]),
        (csv(rows(3)), ["only 3 samples", "50"]),
        (csv([f"{row},1" for row in rows()], header="t,duty,pos,pos"), ["'pos' comes twice", "rename"]),
        (csv(header="t,duty,pos,load"), ["line 1 names 4 columns", "line 2 has 3 cells", "complete the header"]),
        (bytes(range(256)) * 9, ["binary"]),
        (csv([f"{k // 2 * 0.02:.2f},{k % 3},{k}" for k in range(80)]), ["come twice", "sample_time"]),
    ],
)
def test_a_recording_that_cannot_be_used(tmp_path: Path, log: bytes | str, words: list[str]) -> None:
    message = refused(tmp_path, log)
    assert "log.csv" in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit = "rad"', 'unit = "furlong"', ["[output]", "furlong", '"rad", "deg", "rev", "count", "m", "mm"']),
        ('unit = "%"', 'unit = "percent"', ["[input]", "percent", '"%", "1", "V", "A", "N*m", "N"']),
        ('unit = "rad"', "", ["[output]", "unit is missing"]),
        ('unit = "rad"', 'unit = "count"\n[known]\ninertia = 1', ["inertia", "counts_per_revolution in [output]"]),
        (
            'unit = "rad"',
            'unit = "count"\n[optional.speed]\ncolumn = "t"\nunit = "rpm"',
            ["counts_per_revolution in [o"],
        ),
        ('unit = "rad"', 'unit = "count"\ncounts_per_revolution = 0', ["greater than 0"]),
        ('column = "pos"', 'colum = "pos"', ["unknown key 'colum'", "did you mean 'column'"]),
        ("[output]", "[outptu]", ["unknown key 'outptu'", "did you mean 'output'"]),
        ('column = "pos"', "column = 9", ["no column '9'", "[output]", "t, duty, pos"]),
        ('column = "pos"', "column = 0", ["[output]", "column = 0"]),
        ('unit = "rad"', 'unit = "rad"\nlocation = "hub"', ["[output]", "'hub'", '"link" or "motor"']),
        ('unit = "rad"', 'unit = "rad"\nrefresh = 0', ["[output]", "refresh = 0", "greater than 0"]),
        ('unit = "%"', 'unit = "%"\nsigned_bits = 7', ["[input]", "signed_bits = 7", "8, 16 or 32"]),
        ("[output]", "[input.direction]\nforward = 1\n[output]", ["[input.direction]", "column is missing"]),
        ("[output]", "[input.direction]\ncolumn = 'pos'\nreverse = 1\n[output]", ["reverse needs forward"]),
        ("[output]", "[input.direction]\ncolumn = 'duty'\n[output]", ["neither a sign nor 0 or 1", "forward"]),
        ('column = "pos"', "column = ", ["not valid TOML", "line 8", "column 10"]),
        ("[output]", "[loop]\nreference = 'pos'\nlaw = 'PID'\n[output]", ["PID", '"P" or "P-P"']),
        ("[output]", "[loop]\nreference = 'pos'\nlaw = 'P'\n[output]", ["needs gain"]),
        ("[output]", "[loop]\nreference = 'pos'\nlaw = 'P'\ngain = 'kp'\n[output]", ["'kp'", "manifest"]),
        ("[output]", "[optional.curent]\ncolumn = 'i'\n[output]", ["did you mean 'current'"]),
        ("[output]", "[structure]\neffects = 'gravity'\n[output]", ["list of names"]),
        ("[output]", "[known]\ninertia = true\n[output]", ["inertia = True", "number"]),
        ("[output]", f"[known]\ninertia = {'9' * 5000}\n[output]", ["not valid TOML", "too many digits", "line 8"]),
        ("[output]", f"[known]\ninertia = {'9' * 4000}\n[output]", ["inertia", "finite"]),
        ("[output]", "[known]\ninertia = nan\n[output]", ["inertia", "finite"]),
        ("[output]", "[known]\ninertia = -1\n[output]", ["inertia = -1", "negative"]),
        ("[output]", "[known]\ninertai = 1\n[output]", ["'inertai'", "did you mean 'inertia'"]),
        ('column = "pos"', 'column = "duty"', ["[input] and [output]", "'duty'"]),
        ('column = "t"', "sample_time = 2", ["sample_time", "2 s from sample to sample"]),
        ('column = "t"', "sample_time = -1", ["sample_time", "greater than 0"]),
        ('unit = "%"', 'unit = "V"\nfull_scale = 5299', ["full_scale"]),
        ('unit = "rad"', 'unit = "rad"\nscale = 0', ["scale = 0"]),
    ],
)
def test_a_rig_file_that_cannot_be_used(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in RIG
    message = refused(tmp_path, csv(), RIG.replace(old, new))
    assert "rig.toml" in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["file,role", "nowhere.csv,train"], ["m.csv", "line 2", "nowhere.csv"]),
        (["file,role", "log.csv,training"], ["line 2", "'role'", "'training'", "train or holdout"]),
        (["file,start", "log.csv,soon"], ["line 2", "'start'", "'soon'"]),
        (["file,start,end", "log.csv,5,6"], ["no samples from 5 to 6 s"]),
        (["file,start,end", "log.csv,0,0.2"], ["only 21 samples"]),
        (["file,role", "log.csv"], ["line 2", "1 cells"]),
        (["file,role"], ["without rows"]),
        (["File,role", "log.csv,train"], ["m.csv", "line 1", "'file'"]),
        (["file,payload_mas", "log.csv,1"], ["'payload_mas'", "did you mean 'payload_mass'"]),
        (["file,payload_mass", "log.csv,-1"], ["payload_mass = -1", "negative"]),
        (["file,role", "x" * 5000 + ",train"], ["line 2", "no such file"]),
    ],
)
def test_a_manifest_that_cannot_be_used(tmp_path: Path, lines: list[str], words: list[str]) -> None:
    (tmp_path / "log.csv").write_text(csv())
    message = refused(tmp_path, "\n".join(lines), name="m.csv")
    for word in words:
        assert word in message


@pytest.mark.parametrize("name", ["no.csv", "no.parquet", "no.mat", "no.mf4", "no.mcap"])
def test_a_file_that_is_not_there(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInput, match="no such file"):
        load([tmp_path / name])


def test_a_folder_and_a_rig_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="is a folder"):
        load([tmp_path])
    with pytest.raises(BadInput, match="no such rig file"):
        load([tmp_path / "log.csv"], tmp_path / "no.toml")
    with pytest.raises(BadInput, match="cannot be read"):
        read_rig(tmp_path)
    with pytest.raises(BadInput, match="no recording given"):
        load([])


def test_a_rig_file_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInput, match="UTF-8"):
        read_rig(tmp_path / "rig.toml")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("t,goal,pos", "no column looks like the input"),
        ("t,duty,temp", "no column looks like the output"),
    ],
)
def test_columns_that_cannot_be_guessed(tmp_path: Path, header: str, words: str) -> None:
    (tmp_path / "log.csv").write_text(csv(header=header))
    with pytest.raises(BadInput, match=words):
        load([tmp_path / "log.csv"])


def test_numbers_that_no_axis_reaches_are_named(tmp_path: Path) -> None:
    log = csv([f"{0.01 * k:.3f},{k % 2},{(-1) ** k}e308" for k in range(80)])
    message = refused(tmp_path, log)
    assert "line 2, column 'pos'" in message and "1e+308" in message


def test_a_log_without_stamps_needs_the_sample_time(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("\n".join(["duty,pos", *(row.split(",", 1)[1] for row in rows())]))
    with pytest.raises(BadInput, match=r"no column looks like time.*sample_time"):
        load([tmp_path / "log.csv"])


@pytest.mark.parametrize("name", ["log.parquet", "log.mat", "log.mf4", "log.mcap"])
@pytest.mark.parametrize("content", [b"", b"t,duty,pos\n1,2,3\n", bytes(range(256)) * 20])
def test_rubbish_under_the_name_of_a_binary_format(tmp_path: Path, name: str, content: bytes) -> None:
    assert re.search("cannot be read as|holds no", refused(tmp_path, content, name=name))


@pytest.mark.parametrize(("name", "package"), [("a.parquet", "pyarrow"), ("a.mf4", "asammdf"), ("a.mcap", "mcap")])
def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, package: str) -> None:
    monkeypatch.setitem(__import__("sys").modules, package, None)
    monkeypatch.setitem(__import__("sys").modules, f"{package}.reader", None)
    message = refused(tmp_path, b"x", name=name)
    assert f"needs {package}: pip install '.[formats]' in the clone of twin, or pip install {package}" in message


def _loads_or_is_refused(folder: Path, name: str, log: bytes) -> None:
    (folder / name).write_bytes(log)
    try:
        recordings, _ = load([folder / name])
    except BadInput as error:
        assert str(error) and "\n" not in str(error)
    else:
        assert all(isinstance(r, Recording) and (r.time[1:] > r.time[:-1]).all() for r in recordings)


Mutation = Callable[[bytes], bytes]


@st.composite
def mutations(draw: st.DrawFn) -> bytes:
    data = bytearray(csv().encode())
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data) - 1))
        size = draw(st.sampled_from([0, 1, 1, 2, 9, 300]))
        data[at : at + size] = draw(
            st.one_of(
                st.binary(max_size=4),
                st.sampled_from([b"\n", b",", b"nan", b"-inf", b"1e400", b'"', b";", b"\r", b"\t", b"#", b"1e308"]),
            )
        )
        if not data:
            break
    return bytes(data)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mutations())
def test_a_damaged_csv_loads_or_is_refused(tmp_path: Path, log: bytes) -> None:
    _loads_or_is_refused(tmp_path, "log.csv", log)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=400), st.sampled_from(["log.csv", "log.parquet", "log.mat", "log.mcap", "log.dat"]))
def test_random_bytes_load_or_are_refused(tmp_path: Path, log: bytes, name: str) -> None:
    _loads_or_is_refused(tmp_path, name, log)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(RIG) - 1), st.integers(0, 12), st.text(max_size=6))
def test_a_damaged_rig_file_is_read_or_refused(tmp_path: Path, at: int, size: int, text: str) -> None:
    mutated = RIG[:at] + text + RIG[at + size :]
    (tmp_path / "rig.toml").write_bytes(mutated.encode("utf-8", "replace"))
    try:
        read_rig(tmp_path / "rig.toml")
    except BadInput as error:
        assert "\n" not in str(error)
