"""Tables of way points: every form in which people write them gives the same numbers, or says why it is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eos_pin.errors import InputError
from eos_pin.trajectories.waypoints import from_angles, from_quaternions, pose_numbers, read_waypoints

RANDOM = np.random.default_rng(7)
TURNS = Rotation.random(3, random_state=8)
PLACES = RANDOM.normal(size=(3, 3))
TIMES = np.array([0.0, 0.5, 2.0])
#: x y z qx qy qz qw, the order of SciPy.
POSES = np.hstack((PLACES, TURNS.as_quat()))
NAMES = ["t", "x", "y", "z", "qx", "qy", "qz", "qw"]
ORDER = ["qw", "z", "qx", "t", "y", "qy", "qz", "x"]


def write(tmp_path, text, name="path.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


def table(names, columns, separator=",", end=""):
    rows = [names, *([repr(float(x)) for x in row] for row in np.column_stack(columns))]
    return "".join(separator.join(row) + end + "\n" for row in rows)


FORMS = {
    "commas": table(NAMES, (TIMES, POSES)),
    "semicolons": table(NAMES, (TIMES, POSES), ";"),
    "decimal commas": table(NAMES, (TIMES, POSES), ";").replace(".", ","),
    "tabs": table(NAMES, (TIMES, POSES), "\t"),
    "spaces": table(NAMES, (TIMES, POSES), "   "),
    "commas and spaces": table(NAMES, (TIMES, POSES), " , "),
    "trailing commas": table(NAMES, (TIMES, POSES), ",", ",,"),
    "any order": table(
        ["qw", "z", "qx", "t", "y", "qy", "qz", "x"], (POSES[:, [6, 2, 3]], TIMES, POSES[:, [1, 4, 5, 0]])
    ),
    "comments": "# a log\n\n" + table(NAMES, (TIMES, POSES), ",", " # so") + "# end\n",
    "byte order mark, CRLF": "\ufeff" + table(NAMES, (TIMES, POSES)).replace("\n", "\r\n"),
    "Excel": "sep=;\n" + table(NAMES, (TIMES, POSES), ";"),
    "quotes and units": table(['"Time [s]"', '"X (m)"', "Y_m", "z", "QX", "Qy", "qz", "w"], (TIMES, POSES)),
    "ROS": table(
        ["time", *(f"field.pose.position.{a}" for a in "xyz"), *(f"pose.orientation.{a}" for a in "xyzw")],
        (TIMES, POSES),
    ),
    "TUM": table(["#", "timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"], (TIMES, POSES), " "),
    "epoch times": table(NAMES, (TIMES + 1.7e9, POSES)),
    "the other sign": table(NAMES, (TIMES, PLACES, -POSES[:, 3:])),
    "rounded quaternions": table(NAMES, (TIMES, PLACES, 1.0009 * POSES[:, 3:])),
    "roll pitch yaw": table(["t", "x", "y", "z", "roll", "pitch", "yaw"], (TIMES, PLACES, TURNS.as_euler("xyz"))),
}


@pytest.mark.parametrize("form", FORMS)
def test_table_of_poses_is_read_as_people_write_it(tmp_path, form):
    found = read_waypoints(write(tmp_path, FORMS[form]))
    assert len(found) == 3
    np.testing.assert_array_equal(found.t, TIMES)
    if form == "TUM":
        position, rotation = pose_numbers(found.values, "the file", found.lines)
    else:
        position, rotation = found.position, found.rotation
        assert found.axes == "xyz"
    np.testing.assert_allclose(position, PLACES, atol=1e-15)
    np.testing.assert_allclose(rotation, TURNS.as_matrix(), atol=1e-14)
    assert found.start == (1.7e9 if form == "epoch times" else 0.0)


def test_table_in_utf_16_is_read(tmp_path):
    found = read_waypoints(write(tmp_path, FORMS["tabs"], encoding="utf-16"))
    np.testing.assert_allclose(found.rotation, TURNS.as_matrix(), atol=1e-14)


def test_table_keeps_the_digits_of_epoch_times(tmp_path):
    times = [f"1700000000.{k:03d}000001" for k in range(4)]
    found = read_waypoints(write(tmp_path, "t x\n" + "\n".join(f"{t} 1" for t in times)))
    np.testing.assert_allclose(found.t, [0.0, 0.001, 0.002, 0.003], rtol=1e-15)


def test_table_gives_only_its_own_columns(tmp_path):
    found = read_waypoints(write(tmp_path, "y,x\n1,2\n3,4\n"))
    assert (found.t, found.rotation, found.heading, found.values) == (None, None, None, None)
    assert found.axes == "xy"
    np.testing.assert_array_equal(found.position, [[2, 1], [4, 3]])
    found = read_waypoints(write(tmp_path, "x,y,heading\n1,2,0.5\n"))
    np.testing.assert_array_equal(found.heading, [0.5])
    found = read_waypoints(write(tmp_path, "z2,t,z1\n1,2,3\n"))
    np.testing.assert_array_equal(found.values, [[3, 1]])
    found = read_waypoints(write(tmp_path, "3 1 2\n4 2 3\n"))
    np.testing.assert_array_equal(found.values, [[1, 2], [2, 3]])
    assert (found.start, found.columns, found.lines) == (3.0, ("t", "z1", "z2"), (1, 2))


REFUSED = {
    "an unknown column": ("t,x,y,z,gripper\n0,1,2,3,4\n", "line 1: no column is named 'gripper'; the columns are t; x"),
    "a velocity": ("t,velocity.x\n0,1\n", "no column is named 'velocity.x'"),
    "a joint": ("t,panda_joint1\n0,1\n", "no column is named 'panda_joint1'"),
    "millimetres": ("# mine\nt,x [mm]\n0,1\n", r"line 2: column 'x \[mm\]' must be in m, not in mm"),
    "milliseconds": ("t_ms,x\n0,1\n", "must be in s, not in ms"),
    "degrees in the name": ("roll_deg,pitch_deg,yaw_deg\n0,1,2\n", "must be in rad, not in deg"),
    "degrees": ("roll,pitch,yaw\n0,1,2\n0,0,90\n", r"path\.csv, line 3: an angle of 90 rad .* divide by 57"),
    "a column twice": ("x,y,X\n0,1,2\n", "column x is there more than once"),
    "half a quaternion": ("x,y,z,qw,qx\n0,0,0,1,0\n", "qw, qx without qy, qz"),
    "two orientations": ("qw,qx,qy,qz,roll,pitch,yaw\n1,0,0,0,0,0,0\n", "the orientation is given twice"),
    "a long quaternion": (
        "qw,qx,qy,qz\n1,0,0,0\n1,0.1,0,0\n",
        r"line 3: a quaternion .* this one 1\.005",
    ),
    "no quaternion": ("qw,qx,qy,qz\n0,0,0,0\n", "line 2: a quaternion has length 1"),
    "a gap": ("z1,z3\n0,1\n", "without gaps"),
    "mixed kinds": ("t,z1,x\n0,1,2\n", "stand alone or beside t"),
    "times only": ("t\n0\n", "more than the time"),
    "names only": ("t,x\n", "no row follows the names"),
    "nothing": ("# empty\n,,\n", "no rows of numbers"),
    "one column": ("0\n1\n", "one column only"),
    "a word": ("t,x\n0,1\n1,two\n", "line 3: every entry must be a number, got 'two' in column x"),
    "an empty cell": ("t,x,y\n0,,1\n", "line 2: every entry must be a number, got '' in column x"),
    "nan": ("t,x\n0,1\n1,nan\n", "line 3: every entry must be finite"),
    "a signalling nan": ("t,x\n0,1\n1,snan\n", "line 3: every entry must be finite"),
    "a huge number": ("t,x\n0,1\n1,1e999\n", "line 3: every entry must be finite"),
    "a short row": ("t,x,y\n0,1,2\n\n1,2\n", r"line 4: expected 3 columns \(t, x, y\), got 2"),
    "a time twice": ("t,x\n0,1\n0,2\n", "line 3: the times must increase, got 0 after 0"),
    "no time, no names": ("1,2,3\n0,1,2\n", "line 2: .* Without names the first column is the time"),
    "dates": ("t,x\n2024-01-01 00:00:00,1\n", "line 2: every entry must be a number"),
    "a quote": ('t,x\n0,"' + "1" * 200_000 + '"\n', "line 2: field larger"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_table_is_refused_with_file_line_and_cause(tmp_path, case):
    text, told = REFUSED[case]
    with pytest.raises(InputError, match=told) as error:
        read_waypoints(write(tmp_path, text))
    assert "path.csv" in str(error.value)


def test_table_that_cannot_be_read_is_refused(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"cannot read the path .*missing\.csv"):
        read_waypoints(tmp_path / "missing.csv")
    (tmp_path / "binary.csv").write_bytes(b"\x80\x81\x82")
    with pytest.raises(InputError, match="not text in UTF-8"):
        read_waypoints(tmp_path / "binary.csv")
    monkeypatch.setattr("eos_pin.trajectories.text_tables.MOST_ROWS", 2)
    with pytest.raises(InputError, match="more than 2 rows; keep every second"):
        read_waypoints(write(tmp_path, FORMS["commas"]))
    monkeypatch.setattr("eos_pin.trajectories.text_tables.MOST_BYTES", 50)
    with pytest.raises(InputError, match="longer than"):
        read_waypoints(write(tmp_path, FORMS["commas"]))


def test_pose_numbers_take_four_counts():
    angles, matrices = TURNS.as_euler("xyz"), TURNS.as_matrix()
    assert pose_numbers(PLACES, "it")[1] is None
    for rest in (angles, TURNS.as_quat(), matrices.reshape(3, 9)):
        position, rotation = pose_numbers(np.hstack((PLACES, rest)), "it")
        np.testing.assert_array_equal(position, PLACES)
        np.testing.assert_allclose(rotation, matrices, atol=1e-14)
    with pytest.raises(InputError, match="has 5 numbers; a pose is 3"):
        pose_numbers(np.zeros((1, 5)), "it")
    with pytest.raises(InputError, match="it: a quaternion"):
        pose_numbers(np.ones((1, 7)), "it")
    with pytest.raises(InputError, match="it, line 4: the last nine numbers are no rotation"):
        pose_numbers(np.ones((1, 12)), "it", [4])


def test_rotations_are_those_of_scipy():
    turns = Rotation.random(50, random_state=1)
    np.testing.assert_allclose(from_quaternions(turns.as_quat()[:, [3, 0, 1, 2]]), turns.as_matrix(), atol=1e-14)
    angles = np.random.default_rng(2).uniform(-7.0, 7.0, (50, 3))
    np.testing.assert_allclose(from_angles(angles), Rotation.from_euler("xyz", angles).as_matrix(), atol=1e-14)
