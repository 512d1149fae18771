"""Mitsuba's transforms and the shapes that its files have by name, in their own spaces."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.scenes import primitives
from experiments.scenes.importing.mitsuba_xml import Element
from experiments.scenes.primitives import Triangles

_SPHERE_SUBDIVISIONS = 4
_Z_TO_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # turns +y into +z


def transform(element: Element, name: str) -> np.ndarray:
    """A ``transform`` below an element, float64 (4, 4): its parts one after the other; the identity without one."""
    found, out = element.named(name, "transform"), np.eye(4)
    for part in found.children if found else []:
        step = np.eye(4)
        if part.tag == "translate":
            step[:3, 3] = _xyz(part, 0.0)
        elif part.tag == "scale":
            step[:3, :3] = np.diag(_xyz(part, 1.0))
        elif part.tag == "rotate":
            axis = _xyz(part, 0.0)
            if not np.linalg.norm(axis) > 0.0:
                raise part.error("a rotation needs an axis.")
            turn = np.radians(part.numbers("angle", 1)[0]) * axis / np.linalg.norm(axis)
            step[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        elif part.tag == "lookat":
            step = _look_at(part)
        elif part.tag == "matrix":
            values = part.numbers("value", None)
            if len(values) not in (9, 16):
                raise part.error(f"a matrix has 9 or 16 numbers, not {len(values)}.")
            size = int(np.sqrt(len(values)))
            step[:size, :size] = np.reshape(values, (size, size))
            if size == 4 and not np.array_equal(step[3], [0.0, 0.0, 0.0, 1.0]):
                raise part.error("only affine matrices are supported, their last row being 0 0 0 1.")
        else:
            raise part.error(f"<{part.tag}> is no transform.")
        out = step @ out
    return out


def _xyz(part: Element, default: float) -> np.ndarray:
    if "value" in part.keys:
        values = part.numbers("value", None)
        if len(values) not in (1, 3):
            raise part.error(f"<{part.tag}> needs one number or three, not {len(values)}.")
        return np.array(values * 3 if len(values) == 1 else values)
    return np.array([part.numbers(axis, 1, str(default))[0] for axis in "xyz"])


def _look_at(part: Element) -> np.ndarray:
    origin, target = np.array(part.numbers("origin", 3)), np.array(part.numbers("target", 3))
    ahead, up = target - origin, np.array(part.numbers("up", 3, "0, 0, 0"))
    if not np.linalg.norm(ahead) > 0.0:
        raise part.error("the origin lies on the target.")
    ahead = ahead / np.linalg.norm(ahead)
    if not np.linalg.norm(np.cross(up, ahead)) > 1e-6 * np.linalg.norm(up):  # none, or along the view
        up = np.eye(3)[np.argmin(np.abs(ahead))]
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left)
    out = np.eye(4)
    out[:3, :4] = np.stack([left, np.cross(ahead, left), ahead, origin], axis=1)
    return out


def translation(offset: np.ndarray) -> np.ndarray:
    """The matrix (4, 4) that moves by an offset (3,)."""
    out = np.eye(4)
    out[:3, 3] = offset
    return out


def own_placement(element: Element) -> np.ndarray:
    """The radius and the centre or ends that spheres and cylinders have besides their transform."""
    out = np.eye(4)
    if element.kind == "sphere":
        out[:3, :3] *= element.number("radius", 1.0)
        out[:3, 3] = element.vector("center", (0.0, 0.0, 0.0))
    elif element.kind == "cylinder":
        low, high = element.vector("p0", (0.0, 0.0, 0.0)), element.vector("p1", (0.0, 0.0, 1.0))
        along, radius = high - low, element.number("radius", 1.0)
        length = float(np.linalg.norm(along))
        if not length > 0.0:
            raise element.error("a cylinder has no length.")
        turn, _ = Rotation.align_vectors([along / length], [[0.0, 0.0, 1.0]])
        out[:3, :3] = turn.as_matrix() * [radius, radius, length]
        out[:3, 3] = low
    return out


def _open_cylinder() -> Triangles:
    """From z = 0 to 1 about z, radius 1, without caps."""
    sides = primitives.CYLINDER_SEGMENTS
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    here = np.arange(sides)
    after = np.roll(here, -1)
    faces = np.concatenate(
        [np.stack([here, after, after + sides], axis=1), np.stack([here, after + sides, here + sides], axis=1)]
    )
    return np.concatenate([ring, ring + np.array([0.0, 0.0, 1.0])]), faces


def _facing_z(triangles: Triangles) -> Triangles:
    return triangles[0] @ _Z_TO_Y.T, triangles[1]


SHAPES: dict[str, Triangles] = {
    "rectangle": _facing_z(primitives.plane((2.0, 2.0))),
    "disk": _facing_z(primitives.disc(1.0)),
    "cube": primitives.box((2.0, 2.0, 2.0)),
    "sphere": primitives.sphere(1.0, _SPHERE_SUBDIVISIONS),
    "cylinder": _open_cylinder(),
}
"""Of radius 1 or from -1 to 1; the cylinder from z = 0 to 1."""
