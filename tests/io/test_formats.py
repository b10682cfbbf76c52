"""Every file format brings the numbers that were put into it: the files are written here by other programs' writers, or
byte by byte from the format's specification.
"""

import json
import math
import re
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from twin.errors import BadInput
from twin.io.recording import Recording, load
from twin.io.tables.formats import open_table, open_tables

TIME = np.arange(200) * 0.01
DUTY = np.where(TIME % 1 < 0.5, 40.0, -20.0)
ANGLE = np.sin(3 * TIME) + 0.2 * TIME
RIG = '[time]\ncolumn = "t"\n[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "pos"\nunit = "rad"\n'
LOG_RIG = RIG.replace('[time]\ncolumn = "t"\n', "")


def load_one(path: Path, rig: str = RIG) -> Recording:
    (path.parent / "rig.toml").write_text(rig, encoding="utf-8")
    (recording,), _ = load([path])
    return recording


def check(recording: Recording) -> None:
    np.testing.assert_allclose(recording.time, TIME, atol=1e-6)
    np.testing.assert_allclose(recording.input, DUTY)
    np.testing.assert_allclose(recording.output, ANGLE)


# --- SysId's JSON ---


def sysid(test: str, units: str, per: float, rows: list[list[float]]) -> str:
    names = ("slow-forward", "slow-backward", "fast-forward", "fast-backward")
    return json.dumps(
        {"sysid": True, "test": test, "units": units, "unitsPerRotation": per, **dict.fromkeys(names, rows)}
    )


@pytest.mark.parametrize(
    ("units", "per", "kept", "each"),
    [
        ("Radians", 2 * math.pi, "rad", 2 * math.pi),
        ("Degrees", 360.0, "rad", 2 * math.pi),
        ("Rotations", 1.0, "rad", 2 * math.pi),
        ("Meters", 0.4, "m", 0.4),
        ("Feet", 1.5, "m", 1.5 * 0.3048),
        ("Inches", 18.0, "m", 18.0 * 0.0254),
    ],
)
@pytest.mark.parametrize("test", ["Simple", "Arm", "Elevator"])
def test_sysid_of_one_motor(tmp_path: Path, test: str, units: str, per: float, kept: str, each: float) -> None:
    """Positions are rotations whatever the unit; each of the four tests is a recording."""
    rows = np.column_stack([TIME + 300, DUTY, ANGLE, np.gradient(ANGLE, TIME)]).tolist()
    (tmp_path / "log.json").write_text(sysid(test, units, per, rows))
    recordings, rig = load([tmp_path / "log.json"])
    assert [r.name for r in recordings] == [
        f"log.json: {n}" for n in ("slow-forward", "slow-backward", "fast-forward", "fast-backward")
    ]
    assert rig.input.name == "voltage" and recordings[0].output_unit == kept
    np.testing.assert_allclose(recordings[2].output, ANGLE * each)
    np.testing.assert_allclose(recordings[2].time, TIME, atol=1e-9)


def test_sysid_of_a_drivetrain(tmp_path: Path) -> None:
    """Two sides and the angle of the gyroscope, which is no rotation of a wheel."""
    rows = np.column_stack([TIME, DUTY, -DUTY, ANGLE, -ANGLE, ANGLE, ANGLE, 2 * ANGLE, ANGLE]).tolist()
    (tmp_path / "log.json").write_text(sysid("Drivetrain", "Meters", 0.5, rows))
    rig = (
        '[input]\ncolumn = "right_voltage"\nunit = "V"\n[output]\ncolumn = "{}"\nunit = "{}"\n[time]\ncolumn = "time"\n'
    )
    (tmp_path / "rig.toml").write_text(rig.format("right_position", "m"))
    np.testing.assert_allclose(load([tmp_path / "log.json"])[0][0].output, -0.5 * ANGLE)
    (tmp_path / "rig.toml").write_text(rig.format("angle", "rad"))
    np.testing.assert_allclose(load([tmp_path / "log.json"])[0][0].output, 2 * ANGLE)


def test_a_manifest_gives_a_test_its_role(tmp_path: Path) -> None:
    rows = np.column_stack([TIME, DUTY, ANGLE, ANGLE]).tolist()
    (tmp_path / "log.json").write_text(sysid("Simple", "Radians", 1.0, rows))
    (tmp_path / "m.csv").write_text("file;test;role\nlog.json;fast-forward;train\nlog.json;slow-forward;holdout;\n")
    recordings, _ = load([tmp_path / "m.csv"])
    assert [(r.name, r.role) for r in recordings] == [
        ("log.json: fast-forward", "train"), ("log.json: slow-forward", "holdout"),
    ]  # fmt: skip
    (tmp_path / "m.csv").write_text("file,test\nlog.json,sideways\n")
    with pytest.raises(BadInput, match=r"no test 'sideways'.*slow-forward, slow-backward"):
        load([tmp_path / "m.csv"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is no JSON .line 1"),
        ("[1, 2]", "holds no tests"),
        ('{"slow-forward": [[1, 2, 3]]}', "row 1 has 3 numbers"),
        ('{"slow-forward": [[1, 2, 3, 4], [1, 2]]}', "row 2 has 2 numbers"),
        ('{"slow-forward": [[1, 2, "x", 4]]}', "row 1, position: 'x' is no number"),
        ('{"slow-forward": [[1, 2, 3, 4]], "units": "Furlongs"}', "'Furlongs' is not known"),
        ('{"slow-forward": [[1, 2, 3, 4]], "unitsPerRotation": 0}', "unitsPerRotation = 0"),
        ("[" * 100_000, "is no JSON"),
    ],
)
def test_json_that_is_not_sysids(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "log.json").write_text(text)
    with pytest.raises(BadInput, match=says):
        load([tmp_path / "log.json"])


# --- WPILib's data log ---


def record(entry: int, stamp: int, payload: bytes) -> bytes:
    """One record with fields as short as they may be."""
    fields = [(entry, 4), (len(payload), 4), (stamp, 8)]
    sizes = [max(1, (value.bit_length() + 7) // 8) for value, _ in fields]
    head = (sizes[0] - 1) | (sizes[1] - 1) << 2 | (sizes[2] - 1) << 4
    return bytes([head]) + b"".join(v.to_bytes(n, "little") for (v, _), n in zip(fields, sizes, strict=True)) + payload


def start(entry: int, name: str, kind: str, metadata: str = "") -> bytes:
    texts = b"".join(struct.pack("<I", len(t)) + t.encode() for t in (name, kind, metadata))
    return record(0, 0, b"\0" + struct.pack("<I", entry) + texts)


def wpilog(tests: bool) -> bytes:
    log = b"WPILOG\x00\x01" + struct.pack("<I", 3) + b"abc"
    log += (
        start(1, "/arm/duty", "double") + start(2, "/arm/pos", "float[]") + start(3, "sysid-test-state-arm", "string")
    )
    log += start(4, "NT:/name", "string") + record(4, 5, b"arm")
    states = {0: b"none", 50: b"quasistatic-forward", 100: b"quasistatic-forward", 150: b"none"}
    for k, (t, u, y) in enumerate(zip(TIME, DUTY, ANGLE, strict=True)):
        stamp = 1_000_000 + round(1e6 * t)
        if tests and k in states:
            log += record(3, stamp, states[k])
        log += record(1, stamp, struct.pack("<d", u)) + record(2, stamp, struct.pack("<2f", 0.0, y))
    return log


def test_a_data_log_without_tests_is_one_recording(tmp_path: Path) -> None:
    (tmp_path / "log.wpilog").write_bytes(wpilog(tests=False) + b"\x7f\x01")  # the last record breaks off
    recording = load_one(tmp_path / "log.wpilog", LOG_RIG.replace('"pos"', '"pos[1]"'))
    np.testing.assert_allclose(recording.input, DUTY)
    np.testing.assert_allclose(recording.output, ANGLE.astype(np.float32))
    np.testing.assert_allclose(recording.time, TIME, atol=1e-9)


def test_a_routine_of_sysid_in_a_data_log_is_cut_by_its_states(tmp_path: Path) -> None:
    (tmp_path / "log.wpilog").write_bytes(wpilog(tests=True))
    recording = load_one(tmp_path / "log.wpilog", LOG_RIG.replace('"pos"', '"pos[1]"'))
    assert recording.name == "log.wpilog: quasistatic-forward"
    np.testing.assert_allclose(recording.output, ANGLE[50:150].astype(np.float32))


# --- MATLAB ---


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(
    ("content", "names"),
    [
        ({"t": TIME, "duty": DUTY, "pos": ANGLE}, ("t", "duty", "pos")),
        ({"log": {"t": TIME, "duty": DUTY, "pos": ANGLE[:, None]}}, ("t", "duty", "pos")),
        ({"M": np.column_stack([TIME, DUTY, ANGLE])}, ("M(:,1)", "M(:,2)", "M(:,3)")),
        ({"M": np.vstack([TIME, DUTY, ANGLE])}, ("M(1,:)", "M(2,:)", "M(3,:)")),
        (
            {"out": {"time": TIME, "signals": {"values": np.column_stack([DUTY, ANGLE]), "label": "u"}}},
            ("time", "signals.values(:,1)", "signals.values(:,2)"),
        ),
        ({"a": {"t": TIME, "y": DUTY}, "b": {"y": ANGLE, "u": ANGLE}}, ("t", "a.y", "b.y")),
        (
            {"data": {"InputData": DUTY, "OutputData": ANGLE, "SamplingInstants": TIME}},
            ("SamplingInstants", "InputData", "OutputData"),
        ),
    ],
)
def test_matlabs_variables(tmp_path: Path, content: dict[str, Any], names: tuple[str, ...], compressed: bool) -> None:
    scipy.io.savemat(tmp_path / "log.mat", content, do_compression=compressed)
    for name, values in zip(names, (TIME, DUTY, ANGLE), strict=True):
        np.testing.assert_allclose(open_table(tmp_path / "log.mat").columns([name])[0], values)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.dictionaries(
        st.from_regex(r"[a-z][a-z0-9]{0,6}", fullmatch=True),
        hnp.arrays(
            st.sampled_from(["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]),
            st.tuples(st.integers(2, 9), st.just(1)),
        ),
        min_size=1,
        max_size=5,
    ),
    st.booleans(),
)
def test_mat_v5_reads_what_scipy_writes(tmp_path: Path, content: dict[str, np.ndarray], compressed: bool) -> None:
    scipy.io.savemat(tmp_path / "log.mat", content, do_compression=compressed)
    table = open_table(tmp_path / "log.mat")
    for name, values in content.items():
        wide = values.ravel().astype(np.float64)
        np.testing.assert_array_equal(table.columns([name])[0], np.where(np.isfinite(wide), wide, np.nan))


def opaque(name: str, kind: str) -> bytes:
    """A v5 file with one object, as MATLAB writes it: its class, and references into data of MATLAB's own."""

    def element(number: int, data: bytes) -> bytes:
        return struct.pack("<II", number, len(data)) + data + bytes(-len(data) % 8)

    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    references = element(14, numbers + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    texts = element(1, name.encode()) + element(1, b"MCOS") + element(1, kind.encode())
    content = element(14, element(6, struct.pack("<II", 17, 0)) + texts + references)
    return b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<H", 0x0100) + b"IM" + content


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("timetable", "writetimetable(run1, 'log.csv')"),
        ("iddata", "u = run1.InputData"),
        ("myclass", "save its numbers as vectors"),
    ],
)
@pytest.mark.parametrize("new", [False, True])
def test_an_object_of_matlabs_says_how_to_export_it(tmp_path: Path, kind: str, says: str, new: bool) -> None:
    path = tmp_path / "log.mat"
    if new:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w", userblock_size=512) as file:
            file["run1"] = np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype=np.uint32)
            file["run1"].attrs["MATLAB_class"] = np.bytes_(kind)
            file["run1"].attrs["MATLAB_object_decode"] = np.int32(3)
    else:
        path.write_bytes(opaque("run1", kind))
    with pytest.raises(BadInput, match=re.escape(f"'run1' is a {kind} object")) as caught:
        open_table(path)
    assert says in str(caught.value)


def test_hdf5_leads_to_no_other_file(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.mat", "w") as file:
        file["pos"] = ANGLE
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        file["log/t"], file["log/duty"] = TIME, DUTY
        file["log/pos"] = h5py.ExternalLink("other.mat", "/pos")
    with pytest.raises(BadInput, match=r"'log\.pos' is a link to another file"):
        load_one(tmp_path / "log.mat")
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        file["log/t"], file["log/duty"], file["log/pos"] = TIME, DUTY, ANGLE[None, :]
    check(load_one(tmp_path / "log.mat"))


# --- Parquet ---


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_stamps_of_parquet_are_seconds(tmp_path: Path, unit: str) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    per = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    step = 1 if unit == "s" else per // 100
    ticks = [1_700_000_000 * per + step * k for k in range(200)]
    table = pyarrow.table(
        {"t": pyarrow.array(ticks, pyarrow.timestamp(unit)), "duty": DUTY, "pos": ANGLE, "note": ["x"] * 200}
    )
    parquet.write_table(table, tmp_path / "log.parquet")
    (t,) = open_table(tmp_path / "log.parquet").columns(["t"])
    np.testing.assert_allclose(t - t[0], (np.array(ticks) - ticks[0]) / per, atol=1e-9)
    assert open_table(tmp_path / "log.parquet").names == ("t", "duty", "pos")


# --- ROS 2 ---


def joint_state(t: float, names: list[str], positions: list[float], stamped: bool = True) -> tuple[str, bytes]:
    """A JointState in CDR, little-endian: every field is aligned to its own size."""
    body = bytearray(struct.pack("<iI", int(t), round(t % 1 * 1e9)) if stamped else bytes(8))

    def put(form: str, value: float | int) -> None:
        body.extend(bytes(-len(body) % struct.calcsize(form)) + struct.pack("<" + form, value))

    def put_text(text: str) -> None:
        put("I", len(text) + 1)
        body.extend(text.encode() + b"\0")

    put_text("base")
    put("I", len(names))
    for name in names:
        put_text(name)
    for values in (positions, [], []):
        put("I", len(values))
        for value in values:
            put("d", value)
    return "sensor_msgs/msg/JointState", b"\0\1\0\0" + bytes(body)


def float64(value: float) -> tuple[str, bytes]:
    return "std_msgs/msg/Float64", b"\0\1\0\0" + struct.pack("<d", value)


JOINT_STATE = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    f"{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
DEFINITIONS = {"sensor_msgs/msg/JointState": JOINT_STATE, "std_msgs/msg/Float64": "float64 data\n"}
EPOCH = 1_700_000_000


def messages(joints: list[str]) -> list[tuple[str, int, str, bytes]]:
    """Topic, stamp in ns, type and bytes. The log is up to 2 ms late, the stamps in the messages are not."""
    found = []
    for k, (t, u, y) in enumerate(zip(TIME, DUTY, ANGLE, strict=True)):
        logged = EPOCH * 10**9 + round(1e9 * t) + k % 3 * 10**6
        found.append(("/duty", logged - k % 3 * 10**6, *float64(u)))
        found.append(("/joint_states", logged, *joint_state(EPOCH + t, joints, [y] + [0.5] * (len(joints) - 1))))
    return found


def write_mcap(path: Path, joints: list[str]) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels: dict[str, int] = {}
        for topic, stamp, kind, raw in messages(joints):
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], stamp, raw, stamp)
        writer.finish()
    return path


def write_db3(path: Path, joints: list[str]) -> Path:
    with sqlite3.connect(path) as base:
        base.execute("create table topics (id integer primary key, name text, type text, serialization_format text)")
        base.execute("create table messages (id integer primary key, topic_id int, timestamp int, data blob)")
        numbers: dict[str, int] = {}
        for topic, stamp, kind, raw in messages(joints):
            if topic not in numbers:
                numbers[topic] = len(numbers) + 1
                base.execute("insert into topics values (?, ?, ?, 'cdr')", (numbers[topic], topic, kind))
            base.execute(
                "insert into messages (topic_id, timestamp, data) values (?, ?, ?)", (numbers[topic], stamp, raw)
            )
    base.close()
    return path


def write_bag(path: Path, joints: list[str]) -> Path:
    path.with_suffix("").mkdir()
    write_mcap(path.with_suffix("") / "bag_0.mcap", joints)
    (path.with_suffix("") / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    return path.with_suffix("")


@pytest.mark.parametrize("write", [write_mcap, write_db3, write_bag])
@pytest.mark.parametrize("joints", [["elbow"], ["elbow", "wrist"]])
def test_messages_of_ros(tmp_path: Path, write: Callable[[Path, list[str]], Path], joints: list[str]) -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    ending = {write_mcap: ".mcap", write_db3: ".db3", write_bag: ".bag"}[write]
    name = "position" if len(joints) == 1 else "position[elbow]"
    check(load_one(write(tmp_path / f"log{ending}", joints), LOG_RIG.replace('"pos"', f'"{name}"')))


def test_messages_that_do_not_follow_their_definition_are_named(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    path = write_mcap(tmp_path / "log.mcap", ["elbow"])
    path.write_bytes(path.read_bytes().replace(b"\0\1\0\0", b"\0\1\xff\xff"))
    with pytest.raises(BadInput, match=r"cannot be read|none of its topics can be read|holds no"):
        (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:200])
        load_one(tmp_path / "cut.mcap", LOG_RIG)


def test_a_folder_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="is a folder"):
        open_tables(tmp_path)
