"""Recordings as they come: units, formats, manifests, the rig's own loop, and what is guessed."""

import dataclasses
import json
import math
import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from twin.errors import BadInput
from twin.io.faults import find_resolution
from twin.io.recording import Loop, Recording, load
from twin.io.rig_file import read_rig

SHARED = Path(__file__).resolve().parents[3] / "shared"
ROOT = Path(__file__).resolve().parents[2]

TIME = np.arange(400) * 0.005
DUTY = np.where(TIME % 1 < 0.5, 40.0, -20.0)
ANGLE = np.sin(3 * TIME) + 0.2 * TIME
COLUMNS = {"t": TIME, "duty": DUTY, "pos": ANGLE, "goal": ANGLE + 0.1}
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


def write_csv(path: Path, columns: dict[str, np.ndarray], separator: str = ",") -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [separator.join(columns), *(separator.join(f"{x:.12g}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def load_one(folder: Path, columns: dict[str, np.ndarray], rig: str | None = RIG) -> Recording:
    if rig is not None:
        (folder / "rig.toml").write_text(rig)
    (recording,), _ = load([write_csv(folder / "log.csv", columns)])
    return recording


def test_what_is_written_is_read(tmp_path: Path) -> None:
    recording = load_one(tmp_path, {**COLUMNS, "t": TIME + 17.5})
    np.testing.assert_allclose(recording.time, TIME, atol=1e-9)
    np.testing.assert_allclose(recording.input, DUTY)
    np.testing.assert_allclose(recording.output, ANGLE, atol=1e-11)
    assert (recording.input_unit, recording.output_unit, recording.role) == ("%", "rad", "train")
    assert not recording.is_speed
    assert repr(recording) == "2.0 s at 5 ms, duty in %, position in rad, no readings left out"


def test_a_recording_cannot_be_changed(tmp_path: Path) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_one(tmp_path, COLUMNS).role = "holdout"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("unit", "kept", "per_unit"),
    [
        ("deg", "rad", math.pi / 180),
        ("rev", "rad", 2 * math.pi),
        ("m", "m", 1.0),
        ("mm", "m", 1e-3),
        ("rpm", "rad/s", math.pi / 30),
        ("deg/s", "rad/s", math.pi / 180),
        ("rev/s", "rad/s", 2 * math.pi),
        ("mm/s", "m/s", 1e-3),
        ("rad/s", "rad/s", 1.0),
        ("m/s", "m/s", 1.0),
    ],
)
def test_output_units(tmp_path: Path, unit: str, kept: str, per_unit: float) -> None:
    rig = RIG.replace('unit = "rad"', f'unit = "{unit}"\noffset = 3\nscale = -2')
    small = {**COLUMNS, "pos": ANGLE * 1e-2}
    recording = load_one(tmp_path, small, rig)
    assert recording.output_unit == kept
    assert recording.is_speed == kept.endswith("/s")
    np.testing.assert_allclose(recording.output, (ANGLE * 1e-2 - 3) * -2 * per_unit, rtol=1e-9)


@pytest.mark.parametrize(
    ("keys", "kept", "factor"),
    [
        ('unit = "1"', "%", 100.0),
        ('unit = "V"', "V", 1.0),
        ('unit = "N*m"', "N*m", 1.0),
        ("full_scale = 5299", "%", 100 / 5299),
    ],
)
def test_input_units(tmp_path: Path, keys: str, kept: str, factor: float) -> None:
    recording = load_one(tmp_path, COLUMNS, RIG.replace('unit = "%"', keys))
    assert recording.input_unit == kept
    np.testing.assert_allclose(recording.input, DUTY * factor)


@pytest.mark.parametrize(("unit", "second"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_time_units(tmp_path: Path, unit: str, second: float) -> None:
    rig = RIG.replace('"t"', f'"t"\nunit = "{unit}"')
    np.testing.assert_allclose(load_one(tmp_path, {**COLUMNS, "t": TIME * second}, rig).time, TIME, atol=1e-9)


def test_a_sample_time_stands_for_a_time_column(tmp_path: Path) -> None:
    recording = load_one(tmp_path, COLUMNS, RIG.replace('column = "t"', "sample_time = 0.002"))
    np.testing.assert_allclose(recording.time, np.arange(400) * 0.002)


@given(st.integers(16, 20_000), st.integers(0, 2**32 - 1))
def test_resolution_is_found(per_turn: int, seed: int) -> None:
    """Recovered from the counts of a wandering axis, also rounded to decimals; smooth values have none."""
    rng = np.random.default_rng(seed)
    step = 2 * math.pi / per_turn
    wander = np.cumsum(rng.normal(size=2000)) * 0.7
    assert find_resolution(np.round(wander) * step) == pytest.approx(step, rel=1e-6)
    assert find_resolution(np.round(np.round(wander) * step, 6)) == pytest.approx(step, rel=1e-2)
    assert find_resolution(wander) == 0.0


def test_counts_fix_the_resolution(tmp_path: Path) -> None:
    counts = {**COLUMNS, "pos": np.round(ANGLE * 4096 / (2 * math.pi))}
    rig = RIG.replace('unit = "rad"', 'unit = "count"\ncounts_per_revolution = 4096')
    recording = load_one(tmp_path, counts, rig)
    assert recording.resolution == pytest.approx(2 * math.pi / 4096)
    np.testing.assert_allclose(recording.output, ANGLE, atol=recording.resolution / 2 + 1e-12)
    assert "(0.00153 per count)" in repr(recording)


@pytest.mark.parametrize(
    ("output", "angle", "speed"),
    [
        ('unit = "count"\ncounts_per_revolution = 4096', ("counts", 4096.0), ("counts/s", 4096.0)),
        ('unit = "count"\ncounts_per_revolution = 4096\nscale = -0.5', ("counts", 8192.0), ("counts/s", 8192.0)),
        ('unit = "deg"', ("deg", 360.0), ("deg/s", 360.0)),
        ('unit = "rpm"', ("deg", 360.0), ("rpm", 60.0)),
        ('unit = "rev"', ("deg", 360.0), ("rpm", 60.0)),
        ('unit = "rad"', None, None),
        ('unit = "count"', ("counts", 1000.0), ("counts/s", 1000.0)),  # the axis itself moves in thousands of them
    ],
)
def test_a_turn_in_the_rig_s_own_unit(
    tmp_path: Path, output: str, angle: tuple[str, float] | None, speed: tuple[str, float] | None
) -> None:
    """And a turn per second; of an axis in thousands of counts, one of these."""
    (tmp_path / "rig.toml").write_text(RIG.replace('unit = "rad"', output))
    rig = read_rig(tmp_path / "rig.toml")
    axis = rig.output.unit.removesuffix("/s")
    turn = 2.0 * math.pi if axis == "rad" else 1.0
    for unit, wanted in ((axis, angle), (f"{axis}/s", speed)):
        own = rig.own_unit(unit)
        assert (own is None) == (wanted is None)
        if own and wanted:
            assert own[0] == wanted[0] and turn * own[1] == pytest.approx(wanted[1])
    assert rig.own_unit("rad/s^2") is None and rig.own_unit("1") is None and rig.own_unit("m") is None


def test_counts_per_second(tmp_path: Path) -> None:
    rig = RIG.replace('unit = "rad"', 'unit = "count/s"\ncounts_per_revolution = 4096')
    recording = load_one(tmp_path, {**COLUMNS, "pos": ANGLE * 4096}, rig)
    assert recording.output_unit == "rad/s"
    np.testing.assert_allclose(recording.output, ANGLE * 2 * math.pi, rtol=1e-9)


@pytest.mark.parametrize(
    ("keys", "values"),
    [
        ("", {1: 1, -1: 0}),
        ("", {1: 1, -1: -1}),
        ("", {1: 37, -1: -2}),
        ("forward = 2", {1: 2, -1: 1}),
        ("forward = 1\nreverse = 2", {1: 1, -1: 2}),
    ],
)
def test_the_sign_of_the_input_from_a_column_of_its_own(tmp_path: Path, keys: str, values: dict[int, int]) -> None:
    direction = np.array([values[int(sign)] for sign in np.sign(DUTY)])
    columns = {**COLUMNS, "duty": np.abs(DUTY), "dir": direction}
    recording = load_one(tmp_path, columns, f'{RIG}[input.direction]\ncolumn = "dir"\n{keys}\n')
    np.testing.assert_allclose(recording.input, DUTY)


def test_a_drive_that_is_neither_forward_nor_reverse_is_off(tmp_path: Path) -> None:
    columns = {**COLUMNS, "duty": np.full(TIME.size, 50.0), "dir": np.arange(TIME.size) // 100 % 3}
    rig = f'{RIG}[input.direction]\ncolumn = "dir"\nforward = 1\nreverse = 2\n'
    np.testing.assert_allclose(load_one(tmp_path, columns, rig).input, np.choose(columns["dir"], [0, 50, -50]))


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_signed_integers_that_were_logged_without_their_sign(tmp_path: Path, bits: int) -> None:
    rig = RIG.replace('unit = "%"', f'unit = "%"\nsigned_bits = {bits}')
    recording = load_one(tmp_path, {**COLUMNS, "duty": np.where(DUTY < 0, DUTY + 2.0**bits, DUTY)}, rig)
    np.testing.assert_allclose(recording.input, DUTY)


def test_where_the_sensor_sits_and_how_often_it_is_read(tmp_path: Path) -> None:
    recording = load_one(tmp_path, COLUMNS)
    assert (recording.location, recording.refresh) == ("link", None)
    recording = load_one(tmp_path, COLUMNS, RIG + 'location = "motor"\nrefresh = 0.02\n')
    assert (recording.location, recording.refresh) == ("motor", 0.02)


def test_optional_columns_and_known(tmp_path: Path) -> None:
    more = {"qm": ANGLE * 180 / math.pi, "i": DUTY, "T": DUTY * 0 + 20}
    rig = RIG + (
        '[optional.motor_position]\ncolumn = "qm"\nunit = "deg"\n'
        '[optional.current]\ncolumn = "i"\nunit = "mA"\n'
        '[optional.temperature]\ncolumn = "T"\nunit = "degC"\n'
        '[known]\ninertia = 0.012\n[structure]\neffects = ["gravity"]\n'
    )
    recording = load_one(tmp_path, {**COLUMNS, **more}, rig)
    np.testing.assert_allclose(recording.optional["motor_position"], ANGLE, atol=1e-9)
    np.testing.assert_allclose(recording.optional["current"], DUTY * 1e-3)
    np.testing.assert_allclose(recording.optional["temperature"], 293.15)
    assert recording.known == {"inertia": 0.012}
    assert load([tmp_path / "log.csv"])[1].effects == ("gravity",)


def test_the_loop_is_converted_with_its_signals(tmp_path: Path) -> None:
    """The law must give the same number in the user's units and in ours: that is all the factors do."""
    rig = RIG.replace('unit = "%"', 'unit = "1"').replace('unit = "rad"', 'unit = "deg"')
    rig += "[loop]\nreference = 'goal'\nlaw = 'P'\ngain = 0.3\nlimit = 0.9\nreference_rate_limit = 50\n"
    rig += "minimum = 0.02\n"
    recording = load_one(tmp_path, COLUMNS, rig)
    assert recording.loop is not None and recording.loop.gain is not None
    ours = recording.loop.gain * (recording.optional["reference"] - recording.output)
    np.testing.assert_allclose(ours, 100 * 0.3 * (COLUMNS["goal"] - ANGLE), rtol=1e-8)
    assert recording.loop.limit == pytest.approx(90)
    assert recording.loop.minimum == pytest.approx(2)
    assert recording.loop.reference_rate_limit == pytest.approx(math.radians(50))


def test_a_manifest_gives_role_window_and_known(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    write_csv(tmp_path / "runs/a.csv", COLUMNS)
    write_csv(tmp_path / "runs/still.csv", {**COLUMNS, "pos": ANGLE * 0})
    (tmp_path / "m.csv").write_text(
        "file,role,payload_mass,kp,note,start,end\n"
        "runs/a.csv,train,0.5,4,first,,\n"
        "runs/a.csv,holdout,,8,2,0.5,1.5\n"
        "runs/still.csv,,0.7,8,,,\n"
    )
    loop = "[loop]\nreference = 'goal'\nlaw = 'P'\ngain = 'kp'\ngain_scale = 0.5\n[known]\nstiffness = 'kp'\n"
    (tmp_path / "rig.toml").write_text(RIG + loop)
    (first, second, still), _ = load([tmp_path / "m.csv"])
    assert [r.role for r in (first, second, still)] == ["train", "holdout", "train"]
    assert first.known == {"payload_mass": 0.5, "kp": 4.0, "stiffness": 4.0}
    assert second.known == {"kp": 8.0, "stiffness": 8.0}
    assert second.loop == Loop("P", gain=4.0)
    assert second.time[0] == 0
    np.testing.assert_allclose(second.output, ANGLE[100:301], atol=1e-11)
    assert np.ptp(still.output) == 0  # in a set, an axis that stays put shows the dead band


def test_part_keeps_what_belongs_to_the_window(tmp_path: Path) -> None:
    angle = ANGLE.copy()
    angle[[50, 150, 350]] += 4
    whole = load_one(tmp_path, {**COLUMNS, "pos": angle})
    part = whole.part(0.5, 1.5)
    assert part.time[0] == 0 and part.time[-1] == pytest.approx(1.0)
    assert [f.start for f in part.faults] == pytest.approx([0.25])
    assert np.flatnonzero(np.isnan(part.output)).tolist() == [50]
    with pytest.raises(BadInput, match="no samples"):
        whole.part(3, 4)


@pytest.mark.parametrize(
    ("separator", "decimal"),
    [(";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), ("  ", "."), ("  ", ",")],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_separators_and_decimal_comma(tmp_path: Path, separator: str, decimal: str, newline: str) -> None:
    path = write_csv(tmp_path / "log.csv", COLUMNS, separator)
    head, *lines = path.read_text().splitlines()
    text = newline.join([head, *(line.replace(".", decimal) for line in lines)]) + newline
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    (tmp_path / "rig.toml").write_text(RIG)
    (recording,), _ = load([path])
    np.testing.assert_allclose(recording.output, ANGLE, atol=1e-11)
    np.testing.assert_allclose(recording.time, TIME, atol=1e-11)


def test_comments_blank_lines_quotes_and_text_in_other_columns(tmp_path: Path) -> None:
    lines = [f'{t:.4f},{u},"{y:.9f}","a, {k}"' for k, (t, u, y) in enumerate(zip(TIME, DUTY, ANGLE, strict=True))]
    lines.insert(100, "")
    lines.insert(200, "# paused")
    (tmp_path / "log.csv").write_text("\n".join(["# rig 7", '"t","duty","pos","note"', *lines]))
    (tmp_path / "rig.toml").write_text(RIG)
    (recording,), _ = load([tmp_path / "log.csv"])
    np.testing.assert_allclose(recording.output, ANGLE, atol=1e-8)
    lines[300] = "1,2,x,y"
    (tmp_path / "log.csv").write_text("\n".join(["# rig 7", '"t","duty","pos","note"', *lines]))
    with pytest.raises(BadInput, match=r"line 303, column 'pos': 'x'"):
        load([tmp_path / "log.csv"])


def test_names_in_a_comment_as_numpy_writes_them(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "log.csv", np.column_stack([TIME, DUTY, ANGLE]), delimiter=",", header="t,duty,pos")
    (recording,), _ = load([tmp_path / "log.csv"])
    np.testing.assert_allclose(recording.output, ANGLE)


@pytest.mark.parametrize(
    ("names", "units"),
    [
        ("t,duty,position", ("%", "rad")),
        ("Timestamp(ms),Voltage [V],Motor_Speed(RPM)", ("V", "rad/s")),
        ("time_s,torque_Nm,angle_deg", ("N*m", "rad")),
        ("Time [s],vir,qm", ("V", "rad")),
        ("t_s,pwm_pct,speed_rad_s", ("%", "rad/s")),
        ("t,u,pos_m", ("%", "m")),
    ],
)
def test_obvious_names_are_recognised_and_said(tmp_path: Path, names: str, units: tuple[str, str]) -> None:
    t, u, y = names.split(",")
    second = 1e3 if "ms" in t else 1.0
    path = write_csv(tmp_path / "log.csv", {"extra": DUTY, t: TIME * second, u: DUTY, y: ANGLE})
    (recording,), rig = load([path])
    assert (recording.input_unit, recording.output_unit) == units
    np.testing.assert_allclose(recording.time, TIME, atol=1e-9)
    assert all(f"'{name}'" in said for name, said in zip((t, u, y), rig.assumed[:3], strict=True))


def test_a_duty_of_at_most_one_is_a_fraction(tmp_path: Path) -> None:
    recording = load_one(tmp_path, {**COLUMNS, "duty": DUTY / 100}, rig=None)
    np.testing.assert_allclose(recording.input, DUTY)


def test_a_duty_in_ticks_is_a_share_of_a_usual_timer(tmp_path: Path) -> None:
    write_csv(tmp_path / "log.csv", {**COLUMNS, "duty": np.round(DUTY * 25.5)})
    (recording,), rig = load([tmp_path / "log.csv"])
    np.testing.assert_allclose(recording.input, np.round(DUTY * 25.5) / 10.23)
    assert any("full drive is taken for 1023" in said for said in rig.assumed)


def test_an_axis_of_unknown_counts_per_revolution_is_in_counts(tmp_path: Path) -> None:
    counts = np.round(ANGLE * 1000)
    (tmp_path / "rig.toml").write_text(
        '[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "counts"\nunit = "count"\nscale = -1\n'
    )
    (recording,), _ = load([write_csv(tmp_path / "log.csv", {"t": TIME, "duty": DUTY, "counts": counts})])
    np.testing.assert_allclose(recording.output, -counts / 1000)
    assert (recording.output_unit, recording.resolution, recording.is_angle) == ("kcount", 0.001, False)


def write_parquet(path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pyarrow.table({**COLUMNS, "note": ["x"] * TIME.size}), path)


def write_mat(path: Path) -> None:
    shaped = {"t": TIME[:, None], "duty": DUTY[None, :], "pos": ANGLE, "goal": COLUMNS["goal"], "kp": 2.0}
    scipy.io.savemat(path, {**shaped, "matrix": np.eye(3), "note": "text"})


def write_mat73(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            file[name] = values[None, :]
        file["kp"] = np.array([[2.0]])
    with path.open("r+b") as stream:  # the header that tells v7.3 from plain HDF5
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def write_mf4(path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    slow = slice(None, None, 4)
    signals = [asammdf.Signal(v, TIME, name=k) for k, v in COLUMNS.items() if k not in ("t", "duty")]
    with asammdf.MDF() as file:
        file.append(signals)
        file.append([asammdf.Signal(DUTY[slow], TIME[slow], name="duty")])
        file.save(path)


def write_mcap(path: Path) -> None:
    writer_module = pytest.importorskip("mcap.writer")
    with path.open("wb") as stream:
        writer = writer_module.Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        fast, slow = (writer.register_channel(topic, "json", schema) for topic in ("/state", "/command"))
        for k, t in enumerate(TIME):
            stamp = 1_700_000_000_000_000_000 + round(t * 1e9)
            if k % 4 == 0:
                message = json.dumps({"duty": DUTY[k]}).encode()
                writer.add_message(slow, log_time=stamp, data=message, publish_time=stamp)
            message = json.dumps({"pos": ANGLE[k], "goal": COLUMNS["goal"][k], "mode": "run"}).encode()
            writer.add_message(fast, log_time=stamp, data=message, publish_time=stamp)
        writer.finish()


@pytest.mark.parametrize(
    ("name", "write", "named"),
    [
        ("log.parquet", write_parquet, True),
        ("log.mat", write_mat, True),
        ("v73.mat", write_mat73, True),
        ("log.mf4", write_mf4, False),
        ("log.mcap", write_mcap, False),
    ],
)
def test_binary_formats(tmp_path: Path, name: str, write: Callable[[Path], None], named: bool) -> None:
    """Every format gives the very arrays that were written; MDF4 and MCAP bring a clock per channel."""
    write(tmp_path / name)
    rig = RIG if named else RIG.replace('[time]\ncolumn = "t"\n', "")
    if name.endswith(".mat"):
        rig += "[known]\nstiffness = 'kp'\n"
    (tmp_path / "rig.toml").write_text(rig)
    (recording,), _ = load([tmp_path / name])
    np.testing.assert_allclose(recording.time, TIME, atol=1e-9)
    np.testing.assert_array_equal(recording.input, DUTY)
    np.testing.assert_array_equal(recording.output, ANGLE)
    assert recording.faults == ()
    assert recording.known == ({"stiffness": 2.0} if name.endswith(".mat") else {})
    (tmp_path / "rig.toml").write_text(rig.replace('"pos"', '"psi"'))
    with pytest.raises(BadInput, match=r"no column 'psi'.*pos"):
        load([tmp_path / name])


def test_columns_of_unequal_length_are_refused(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "log.mat", {**COLUMNS, "duty": DUTY[:-1]})
    (tmp_path / "rig.toml").write_text(RIG)
    with pytest.raises(BadInput, match="'duty' has 399 values and 'pos' 400"):
        load([tmp_path / "log.mat"])


@pytest.mark.skipif(not SHARED.exists(), reason="the real recordings are not here")
@pytest.mark.parametrize(
    ("name", "count", "held_out"),
    [("jga25", 104, 52), ("sts3215", 96, 32), ("sts3215_brutal", 24, 8), ("emps", 2, 1), ("ak80", 6, 2)],
)
def test_manifests_of_the_real_rigs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, count: int, held_out: int
) -> None:
    monkeypatch.setattr(sys, "argv", ["manifests.py", str(SHARED / "data"), str(tmp_path)])
    runpy.run_path(str(ROOT / "scripts/manifests.py"), run_name="__main__")
    rig = ROOT / f"models/rigs/{re.sub('_.*', '', name)}.toml"
    recordings, _ = load([tmp_path / f"{name}.csv"], rig)
    assert len(recordings) == count
    assert sum(r.role == "holdout" for r in recordings) == held_out
    if name == "emps":
        assert recordings[0].loop == Loop("P-P", kp=160.18, kv=243.45)
        check_loop(recordings[0])
    if name == "sts3215":
        assert {r.known["kp"] for r in recordings if r.role == "holdout"} == {12, 24}
        assert recordings[0].loop is not None
        assert recordings[0].loop.gain == pytest.approx(100 * 0.1649 * recordings[0].known["kp"])
    if name == "ak80":
        assert [round(r.time[-1], 1) for r in recordings] == [3.0, 3.0, 3.0, 3.0, 3.5, 3.0]


def check_loop(recording: Recording) -> None:
    """The law with the gains of the file gives the recorded voltage (smoothed: velocity is differenced)."""
    assert recording.loop is not None and recording.loop.kp is not None and recording.loop.kv is not None
    velocity = np.gradient(recording.output, recording.time)
    error = recording.optional["reference"] - recording.output
    given = recording.loop.kv * (recording.loop.kp * error - velocity)
    smooth = np.ones(50) / 50
    law, measured = (np.convolve(v, smooth, "same") for v in (given, recording.input))
    assert np.corrcoef(law, measured)[0, 1] > 0.99
    assert np.std(law - measured) < 0.1 * np.std(measured)
