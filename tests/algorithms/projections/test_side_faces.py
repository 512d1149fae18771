"""Key ``partition: faces``: the view divided by its side faces (Kozlov 2004), each piece with its own map."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from projection_cases import ALL, EYES, FOV, LIGHTS, SCENE, TEXELS, WARPS, eye_at, project, towards

from algorithms.projections.composition import compose
from wkernels.errors import InputError
from wkernels.projections.clipping import frustum_planes
from wkernels.projections.focusing import seen_body
from wkernels.projections.side_pieces import side_pieces
from wkernels.scene.views import HostView


def seen_points(eye: HostView, count: int = 4000) -> np.ndarray:
    points = np.random.default_rng(2).uniform(SCENE.low, SCENE.high, (count, 3))
    planes = frustum_planes(eye.ws_to_ss, eye.near, eye.far)
    return points[(points @ planes[:, :3].T + planes[:, 3] > 0.0).all(axis=1)]


def piece_of(eye: HostView, points: np.ndarray) -> np.ndarray:
    """0 bottom, 1 right, 2 top, 3 left: the side that a point is nearest to on the screen."""
    x, y = project(eye, points)[:, :2].T
    return np.where(np.abs(x) > np.abs(y), np.where(x > 0.0, 1, 3), np.where(y > 0.0, 2, 0))


@pytest.mark.parametrize("eye", EYES)
def test_the_pieces_are_the_body_and_share_nothing(eye: str) -> None:
    body = seen_body(SCENE, EYES[eye])
    pieces = side_pieces(body, EYES[eye])
    assert sum(piece.volume for piece, _ in pieces) == pytest.approx(body.volume, rel=1e-9)
    points = seen_points(EYES[eye])
    side = piece_of(EYES[eye], points)
    held = np.zeros(len(points), dtype=int)
    for piece, ahead in pieces:
        faces = [(f[0], np.cross(f[1] - f[0], f[2] - f[0])) for f in piece.faces]
        inside = np.array([all((p - a) @ n <= 1e-9 for a, n in faces) for p in points])
        held += inside
        assert len(set(side[inside])) <= 1, "one side of the screen"
        depth = (points[inside] - ahead.eye_ws) @ ahead.forward_ws
        assert (depth >= ahead.near - 1e-9).all() and (depth <= ahead.far + 1e-9).all()
    assert (held == 1).all() and len(points) > 20


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("warp", WARPS)
def test_every_receiver_seen_is_held_by_the_map_of_its_piece(warp: str, light: str) -> None:
    for eye in EYES.values():
        views = compose({"fit": "focused", "warp": warp, **WARPS[warp], "partition": "faces"})(
            LIGHTS[light], SCENE, SCENE, TEXELS, eye
        )
        pieces = side_pieces(seen_body(SCENE, eye), eye)
        assert len(views) == len(pieces) <= 4
        for view, (piece, _) in zip(views, pieces, strict=True):
            mapped = project(view, piece.vertices)
            limit = 1.0 - 2.0 / TEXELS
            assert (mapped[:, 3] > 0.0).all()
            np.testing.assert_allclose(mapped[:, :2].max(axis=0), limit, rtol=1e-6)  # and nothing more than it
            np.testing.assert_allclose(mapped[:, :2].min(axis=0), -limit, rtol=1e-6)
        points = seen_points(eye)
        room = [1.0 - np.abs(project(view, points)[:, :2]).max(axis=1) for view in views]
        assert (np.max(room, axis=0) >= 0.0).all()


def worst_errors(settings: dict[str, Any], gamma: float, resolution: int) -> np.ndarray:
    """Texel over pixel, the larger over all directions across the light, at random receivers in the whole frustum."""
    eye, light = eye_at((0, 0, 0), far=100.0), towards(gamma)
    views = compose({"fit": "focused", **settings})(light, ALL, ALL, resolution, eye)
    rng = np.random.default_rng(1)
    z = np.exp(rng.uniform(0.0, np.log(100.0), 4000))
    x, y = rng.uniform(-1.0, 1.0, (2, 4000)) * np.tan(0.5 * FOV) * z
    points = x[:, None] * eye.right_ws + y[:, None] * eye.up_ws + z[:, None] * eye.forward_ws
    pixel = 2.0 * np.tan(0.5 * FOV) * z / TEXELS
    across = np.linalg.svd(light[None, :3])[2][1:]
    out, room = np.full(len(points), np.nan), np.zeros(len(points))
    for view in views:
        rows, mapped = view.ws_to_ss, project(view, points)
        gradient = (rows[None, :2, :3] - mapped[:, :2, None] * rows[None, 3:, :3]) / mapped[:, 3, None, None]
        least = np.linalg.svd(0.5 * resolution * gradient @ across.T, compute_uv=False)[:, 1]
        inside = 1.0 - np.abs(mapped[:, :2]).max(axis=1)
        taken = (inside >= room) & (mapped[:, 3] > 0.0)
        out[taken], room[taken] = (1.0 / least / pixel)[taken], inside[taken]
    assert np.isfinite(out).all(), "every receiver is held"
    return out


def test_faces_warp_where_frusta_duel() -> None:
    """One map cannot be warped when the light looks along the view; those of the sides can (f/n = 100, theta = 30)."""
    for gamma, alone in ((0.0, 100.0), (5.0, 200.0)):
        one = worst_errors({"warp": "lispsm_nopt"}, gamma, TEXELS)
        faces = worst_errors({"warp": "lispsm_nopt", "partition": "faces"}, gamma, TEXELS)
        halved = worst_errors({"warp": "lispsm_nopt", "partition": "faces"}, gamma, TEXELS // 2)
        assert one.max() == pytest.approx(alone, rel=0.02)
        assert faces.max() < 0.2 * alone and np.sqrt(np.mean(faces**2)) < 0.2 * np.sqrt(np.mean(one**2))
        assert halved.max() < 0.4 * alone, "four maps of half the side hold as many texels as one"
    # beside an overhead light the view vector lies across the light already, and there is nothing to win
    one = worst_errors({"warp": "lispsm_nopt"}, 90.0, TEXELS)
    faces = worst_errors({"warp": "lispsm_nopt", "partition": "faces"}, 90.0, TEXELS)
    assert faces.max() == pytest.approx(one.max(), rel=0.2)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"splits": 4}, r"projection.partition: 'faces' needs one split"),
        ({"stabilise": "exact"}, r"projection.stabilise: cannot stabilise the maps of faces"),
        ({"selection": "best"}, r"projection.selection: 'best' chooses among splits"),
        ({"fit": "scene"}, r"projection.partition: 'faces' needs a fit that follows the eye"),
    ],
)
def test_what_faces_cannot_do_is_refused(settings: dict[str, Any], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        compose({"fit": "focused", "partition": "faces", **settings})


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"near": "automatic"}, r"projection.near: 'automatic' is not available; available: user, auto, auto_previous"),
        ({"near": "auto", "fit": "scene"}, r"projection.near: 'auto' needs a fit"),
        ({"near": "auto", "stabilise": "exact"}, r"projection.near: 'auto' cannot be with texels of constant size"),
        ({"adjust": 1}, r"projection.adjust: 1 is not available; available: True, False"),
        ({"adjust": False, "fit": "scene"}, r"projection.adjust: False needs a fit"),
        ({"depth": "tight", "fit": "scene"}, r"projection.depth: 'tight' needs a fit"),
        ({"partition": "sides"}, r"projection.partition: 'sides' is not available; available: depth, faces"),
    ],
)
def test_other_values_are_refused_with_the_reason(settings: dict[str, Any], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        compose({"fit": "focused", **settings})
