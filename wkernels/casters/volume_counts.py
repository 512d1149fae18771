"""In how many shadow volumes of a light point each pixel's surface lies: what hard volumes show and wedges start from.

Faces of volumes are counted along the way of the eye's ray. Before what is seen (z-pass: Crow 1977; Heidmann 1991)
front faces less back faces are the volumes that the ray has entered and not left, which is right for an eye outside of
all. Behind what is seen (z-fail: Everitt and Kilgard 2002) back faces less front faces are those that it has still to
leave, wherever the eye is and whatever its near plane cuts.

A volume's cap at the caster is made of the caster's own faces, which the eye's picture shows. So none ever lies before
what is seen there: z-pass needs no caps, and z-fail needs no depths for them, which would have to be equal.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Literal

import numpy as np
import warp as wp

from wkernels.casters.components import Components
from wkernels.casters.pulls import pull_components, pull_silhouettes, pull_volumes
from wkernels.projections.clipping import frustum_planes
from wkernels.raster import COUNT_ALL, COUNT_FARTHER, COUNT_NEARER, Rasteriser
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import HostView
from wkernels.workspace.left_out import Omission
from wkernels.workspace.workspace import Workspace

VolumeRule = Literal["zpass", "zfail", "per_caster"]

SLACK = 1e-5  # share of distances: some hundred float32 roundings


class Uncounted(Omission):
    """What a view saves, and what z-pass cannot do."""

    BESIDE = "shadow volumes of casters", "they lie beside the view"
    AT_EYE = "entries into volumes that the eye may be in", "z-pass takes the near plane for lit"


@wp.kernel
def add_counts(first: int, a: wp.array2d(dtype=int), b: wp.array2d(dtype=int), sum_out: wp.array2d(dtype=int)):
    """Sum of two images; one of them may be the output."""
    row, x = wp.tid()
    y = first + row
    sum_out[y, x] = a[y, x] + b[y, x]


def count_volumes(
    work: Workspace,
    rasteriser: Rasteriser,
    geometry: Geometry,
    gbuffer: GBuffer,
    eye: HostView,
    light_ws: np.ndarray,
    rule: VolumeRule = "per_caster",
    slot: Hashable = 0,
    chosen: np.ndarray | None = None,
) -> wp.array:
    """How many faces lie between each pixel's surface and the light, of closed casters those that hide it.

    Args:
        work: Keeps silhouettes and volumes for as long as light and casters stand still.
        rasteriser: Counts.
        geometry: The casters.
        gbuffer: What the eye sees; of all casters too.
        eye: The view that it was drawn through.
        light_ws: Light point (4,), float64, rebased world; w = 1, or 0 for a direction.
        rule: ``zpass``, of no meaning where the eye is in a volume, which is told where it may be; ``zfail``; or,
            ``per_caster``, z-pass for casters (connected components) of which it is certain that nothing of their
            volumes lies at the near plane.
        slot: Which of several light points this is.
        chosen: Casters (components) that count, bool (C,); all unless given.

    Returns:
        int32 (H, W), valid until the next call; of no meaning where nothing is seen.
    """
    silhouettes = pull_silhouettes(work, geometry, light_ws, slot=slot)
    volumes = pull_volumes(work, geometry, silhouettes, light_ws, slot=slot)
    components = pull_components(work, geometry)
    seen = np.ones(len(components.low), bool)
    if work.may_leave_out(Uncounted.BESIDE):
        seen = may_be_seen(components, eye, light_ws)
        if not seen.all():
            work.leave_out(Uncounted.BESIDE, count=int((~seen).sum()))
    if chosen is not None:
        seen = seen & chosen
    at_eye = seen if rule == "zfail" else seen & may_hold_near_plane(components, eye, light_ws)
    if rule == "zpass" and at_eye.any():
        work.tell(Uncounted.AT_EYE, count=lambda: int(at_eye.sum()))
    failing = np.zeros_like(seen) if rule == "zpass" else at_eye
    passing = seen & ~failing
    shape = gbuffer.depth.shape
    total, part = (work.buffer(f"{name} of volumes", shape, wp.int32) for name in ("counts", "some counts"))
    counted = False

    def count(triangles: wp.array, test: int, front: int) -> None:
        nonlocal counted
        out = part if counted else total
        seen_at = None if test == COUNT_ALL else gbuffer.depth
        rasteriser.count(volumes.points_ws, triangles, gbuffer.view, seen_at, out, test, front, -front)
        if counted:
            work.launch(add_counts, shape, [total, part], [total])
        counted = True

    with work.timed("faces of volumes"):
        if passing.any():
            count(volumes.sides_of(passing), COUNT_NEARER, 1)
        if failing.any():
            count(volumes.sides_of(failing), COUNT_FARTHER, -1)
            count(volumes.caps_of(failing), COUNT_ALL, -1)
        if not counted:
            total.zero_()
    return total


def may_be_seen(components: Components, eye: HostView, light_ws: np.ndarray) -> np.ndarray:
    """Whether any of what lies behind a component's box may be in a view, bool (C,); false is certain.

    Args:
        components: Of the casters.
        eye: The view; its far plane does not count.
        light_ws: Light point (4,).
    """
    centre, half = components.middle, components.half
    out = np.ones(len(centre), bool)
    for plane in frustum_planes(eye.ws_to_ss, eye.near, eye.far)[:5]:
        highest = centre @ plane[:3] + half @ np.abs(plane[:3])
        slack = SLACK * (np.abs(centre) @ np.abs(plane[:3]) + half @ np.abs(plane[:3]) + abs(plane[3]))
        # all of it is beyond one plane, and carried away from it
        out &= ~((highest + plane[3] < -slack) & (highest * light_ws[3] <= light_ws[:3] @ plane[:3]))
    return out


def may_hold_near_plane(components: Components, eye: HostView, light_ws: np.ndarray) -> np.ndarray:
    """Whether any of what lies behind a component's box may be at the near plane's part of a view, bool (C,).

    That is so where the box meets the hull of the near plane's four corners and the light point (Everitt and Kilgard
    2002); false is certain, as a face of the one or the other parts them.

    Args:
        components: Of the casters.
        eye: The view.
        light_ws: Light point (4,).
    """
    hull = near_hull(eye, light_ws)
    centre, half = components.middle, components.half
    size = np.abs(hull).max()
    slack = SLACK * ((np.abs(centre) + half).max(axis=1, initial=0.0) + size)
    apart = np.zeros(len(components.low), bool)
    for axis in range(3):
        for side, border in ((1.0, components.high), (-1.0, components.low)):
            beyond = side * (hull[:, axis] - border[:, axis, None] * hull[:, 3])
            apart |= (beyond >= slack[:, None] * hull[:, 3]).all(axis=1)
    for a, b, c in ((0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (0, 1, 2)):
        point = hull[a, :3]
        normal = np.cross(hull[b, :3] - point, hull[c, :3] - point * hull[c, 3])
        if not normal.any():
            continue
        normal /= np.linalg.norm(normal)
        within = (hull[:, :3] - point * hull[:, 3:]) @ normal
        inward = np.sign(within[np.abs(within).argmax()])
        if (inward * within < -SLACK * size).any():
            continue  # rounding has tilted the face into the hull
        apart |= inward * ((centre - point) @ normal) + half @ np.abs(normal) < -slack
    return ~apart


def near_hull(eye: HostView, light_ws: np.ndarray) -> np.ndarray:
    """The four corners of the near plane's part of a view, in turn, and a light point: float64 (5, 4), homogeneous."""
    left, right, bottom, top = (side * (eye.near if eye.perspective else 1.0) for side in eye.window)
    middle = eye.eye_ws + eye.near * eye.forward_ws
    across = ((left, bottom), (right, bottom), (right, top), (left, top))
    corners = [np.append(middle + x * eye.right_ws + y * eye.up_ws, 1.0) for x, y in across]
    return np.array([*corners, light_ws])
