"""Light views shifted and turned from frame to frame, so that their texels fall elsewhere on the same receivers.

A shift is added in the plane of the map, rows x and y of the matrix by a multiple of row w, and a turn is made there
too. Both act behind any projection: uniform and warped views, splits and the faces of a cube. (Scherzer, Jeschke and
Wimmer 2007 rotate or shift the light's frustum; Schwaerzler 2009, section 5.2.2.)
"""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from wkernels.sampling.point_sets import light_set
from wkernels.scene.views import HostView, ProjectiveView


class Jitter(NamedTuple):
    """How a light view differs from the one that its projection made.

    Attributes:
        dx, dy: Shift of what is seen over the map: texels, to the right and up.
        angle: Turn about the middle of the map, counter-clockwise: radians.
    """

    dx: float
    dy: float
    angle: float


def frame_jitter(kind: str, index: int, shift: float, turn: float, seed: int | None = 0) -> Jitter:
    """The jitter of one frame, from a point set.

    Args:
        kind: A key of ``sampling.LIGHT_SETS``. The first point of plain ``r2`` is its centre: no jitter.
        index: Which point of the set, at least 0.
        shift: Width and height of the square that shifts fill, texels: 1 takes every receiver to every place in its
            texel, equally often.
        turn: Width of the range of angles, radians.
        seed: As for ``sampling.light_set``.

    Raises:
        InputError: No such set.
    """
    x, y, z = light_set(kind, 1, 3, index, seed)[0] - 0.5
    return Jitter(shift * float(x), shift * float(y), turn * float(z))


def jittered_view(view: HostView, jitter: Jitter) -> ProjectiveView:
    """A square light view after a jitter; what it held within half a texel of its border may fall outside.

    A turned view is scaled down by |cos| + |sin| of the angle, so that it still holds the whole square: its texels are
    that much larger. Depth is not touched.
    """
    cosine, sine = np.cos(jitter.angle), np.sin(jitter.angle)
    scale = abs(cosine) + abs(sine)
    rows = view.ws_to_ss.copy()
    x, y, w = rows[0].copy(), rows[1].copy(), rows[3]
    rows[0] = (cosine * x - sine * y) / scale + 2.0 * jitter.dx / view.width * w
    rows[1] = (sine * x + cosine * y) / scale + 2.0 * jitter.dy / view.height * w
    kept = {item.name: getattr(view, item.name) for item in fields(HostView)}
    # the directions that change map x, and map y, alone; for warped views in the middle of the map only, as ever
    right, up = view.right_ws, view.up_ws
    per_right, per_up = float(x[:3] @ right), float(y[:3] @ up)
    kept["right_ws"] = _unit(cosine * per_up * right - sine * per_right * up)
    kept["up_ws"] = _unit(sine * per_up * right + cosine * per_right * up)
    own = {name: getattr(view, name) for name in ("choice", "clamped_before") if hasattr(view, name)}
    return ProjectiveView(**kept, rows=rows, **own)


def _unit(v: np.ndarray) -> np.ndarray:
    out: np.ndarray = v / np.linalg.norm(v)
    return out
