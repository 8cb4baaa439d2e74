"""Calibrations as TOML files: written all at once and in full precision, read with an error for everything that is wrong.

The format is described in docs/calibration.md.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.board import Board
from extremal.estimator.calibration import MOST_PARAMETERS, Calibration, Simulation
from extremal.estimator.camera import Camera
from extremal.estimator.errors import InvalidInput
from extremal.estimator.files import write_whole
from extremal.estimator.reading import read_toml
from extremal.estimator.toml_values import Table, integer, items, number, numbers, text

FORMAT = 1
LARGEST_FILE = 2_000_000  # bytes
LARGEST_NUMBER = 1e9
_number = number(LARGEST_NUMBER)
_items = items(2 * MOST_PARAMETERS)
_numbers = numbers(LARGEST_NUMBER, 2 * MOST_PARAMETERS)
UNIT = 1e-6  # a quaternion's norm may be off 1 by this: it was rounded when written by hand

_TITLE = "# A camera calibrated on a robot's flange (extremal calibrate). Metres, radians, pixels; pixel (0, 0) is the centre\n# of the top-left one. T_a_b maps coordinates of frame b to frame a. Quaternions are x, y, z, w.\n"
_COMMENTS = {
    "camera": "# fx, fy, cx, cy [px]; distortion k1, k2, p1, p2, k3 (Brown-Conrady); blur: sd of the optics' point spread [px]",
    "hand_eye": "# T_flange_camera",
    "board_pose": "# T_base_board",
    "board": "# ChArUco board: squares, sides of square and marker [m], ArUco dictionary",
    "arm": "# deviations from the arm's data sheet [m], [rad]",
    "fit": "# views used; rms distance of corners from their predictions [px]; sd of what each view's pose is off by itself",
    "simulation": "# this calibration belongs to one simulated arm and fits no other",
    "covariance": "# of the errors of: intrinsics; twists (x, y, z [m], rotation vector rx, ry, rz [rad]) of T_flange_camera in the camera\n# frame and of T_base_board in the board's, both right-multiplied: T_actual = T exp(error); parameters of the arm",
}


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration, by a temporary file beside it, so that a reader finds all of it or nothing.

    Raises:
        InvalidInput: the file can't be written.
    """
    content, path = _content(calibration), Path(path)
    try:
        write_whole(path, content)
    except OSError as error:
        raise InvalidInput(f"calibration file {str(path)!r} can't be written: {error.strerror}") from None


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration from a TOML file.

    Raises:
        InvalidInput: one line that names the file, the key, what is wrong with it and what is accepted.
    """
    path = Path(path)
    try:
        return _calibration(Table(read_toml(path, LARGEST_FILE)))
    except InvalidInput as error:
        raise InvalidInput(f"calibration {path.name}: {' '.join(str(error).split())}") from None


def _content(calibration: Calibration) -> str:
    position, rotation = calibration.view_errors
    tables: dict[str, Mapping[str, Any]] = {
        "camera": asdict(calibration.camera),
        "hand_eye": _pose_table(calibration.T_flange_camera),
        "board_pose": _pose_table(calibration.T_base_board),
        "board": asdict(calibration.board),
        "arm": calibration.arm,
        "fit": {
            "views": calibration.views,
            "rms": calibration.rms,
            "view_position_error": position,
            "view_rotation_error": rotation,
        },
    }
    if calibration.simulation:
        tables["simulation"] = asdict(calibration.simulation)
    tables["covariance"] = {"parameters": calibration.parameters, "matrix": calibration.covariance}
    parts = [f"{_TITLE}\nformat = {FORMAT}\n"]
    for name, table in tables.items():
        lines = [f"{key} = {_value(value)}" for key, value in table.items()]
        parts.append("\n".join([f"{_COMMENTS[name]}", f"[{name}]", *lines]) + "\n")
    return "\n".join(parts)


def _value(value: Any) -> str:
    """TOML of a number, text, list of them or matrix; Python writes floats such that they are read back exactly."""
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, np.ndarray) and value.ndim == 2:
        return "[\n" + "".join(f"  {_value(row)},\n" for row in value) + "]"
    if isinstance(value, Iterable):
        return f"[{', '.join(_value(item) for item in value)}]"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))


def _pose_table(pose: RigidTransform) -> dict[str, Any]:
    return {"translation": pose.translation, "quaternion": pose.rotation.as_quat()}


def _calibration(table: Table) -> Calibration:
    version = table.take("format", integer)
    if version != FORMAT:
        raise InvalidInput(f"format is {version}; accepted: {FORMAT}")
    fit = table.take("fit", Table)
    views = fit.take("views", integer)
    rms, position, rotation = (
        fit.take(key, _number) for key in ("rms", "view_position_error", "view_rotation_error")
    )
    fit.done()
    arm = table.take("arm", _arm)
    calibration = {
        "camera": table.take("camera", _value_of(Camera)),
        "T_flange_camera": table.take("hand_eye", _pose),
        "T_base_board": table.take("board_pose", _pose),
        "board": table.take("board", _value_of(Board)),
        "simulation": table.take("simulation", _value_of(Simulation))
        if "simulation" in table.values
        else None,
    }
    names, matrix = table.take("covariance", _covariance)
    table.done()
    found = Calibration(
        **calibration, covariance=matrix, view_errors=(position, rotation), rms=rms, views=views, arm=arm
    )
    for i, (name, expected) in enumerate(zip(names, found.parameters, strict=True)):
        if name != expected:
            raise InvalidInput(f"covariance.parameters[{i}] is {name!r:.60}; accepted: {expected!r}")
    return found


def _value_of(kind: type[Any]) -> Callable[[Any, str], Any]:
    """Reads a dataclass of numbers and texts, a key for each field."""

    def read(values: Any, where: str) -> Any:
        table, content = Table(values, where), {}
        for item in fields(kind):
            reader = {int: integer, float: _number, str: text}.get(item.type, _numbers)  # pyright: ignore[reportArgumentType, reportCallIssue]
            content[item.name] = table.take(item.name, reader)
        table.done()
        return kind(**content)

    return read


def _pose(values: Any, where: str) -> RigidTransform:
    table = Table(values, where)
    translation = table.take("translation", _numbers)
    quaternion = table.take("quaternion", _numbers)
    table.done()
    if len(translation) != 3:
        raise InvalidInput(f"{where}.translation has {len(translation)} numbers; accepted: 3")
    if len(quaternion) != 4 or not abs(np.linalg.norm(quaternion) - 1) < UNIT:
        raise InvalidInput(
            f"{where}.quaternion is {list(quaternion)!r:.100}; accepted: a unit quaternion x, y, z, w"
        )
    return RigidTransform.from_components(translation, Rotation.from_quat(quaternion))


def _arm(values: Any, where: str) -> dict[str, float]:
    names = Table(values, where).values
    if len(names) > MOST_PARAMETERS:
        raise InvalidInput(f"{where} has {len(names)} parameters; accepted: up to {MOST_PARAMETERS}")
    return {name: _number(value, f"{where}.{name:.60}") for name, value in names.items()}


def _covariance(values: Any, where: str) -> tuple[list[str], np.ndarray]:
    table = Table(values, where)
    names = [
        text(item, f"{where}.parameters[{i}]") for i, item in enumerate(table.take("parameters", _items))
    ]
    rows = [_numbers(row, f"{where}.matrix[{i}]") for i, row in enumerate(table.take("matrix", _items))]
    table.done()
    if len(rows) != len(names) or any(len(row) != len(names) for row in rows):
        raise InvalidInput(
            f"{where}.matrix has {len(rows)} rows of {', '.join(map(str, sorted({len(r) for r in rows})))} numbers; accepted: "
            f"{len(names)} of {len(names)}, as there are parameters"
        )
    return names, np.array(rows)
