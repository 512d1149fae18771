"""Shadows of moving casters in both shadow buffers: what leaves is gone in time, and what that costs (Schwaerzler 2009,
section 5.2.5 and appendix A; Scherzer et al. 2009, section 3.4)."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from scipy.ndimage import binary_dilation
from sessions import true_visibility

from algorithms.plugins import find
from wkernels.frame.session import FrameResult, Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Scene

SIZE = (96, 72)
LAMP = small.light("rectangle", (2.0, 8.0, 1.0), 2.0)
LEAVES = 24  # the frame from which on the box is gone
BOTH = ("tc_soft_paper", "tc_soft_thesis")
STARTS: dict[str, dict[str, Any]] = {"tc_soft_paper": {"start_weight": 4.0}, "tc_soft_thesis": {"start": "blur"}}
"""Starts that are stored as more than one sample, so that there is something to fade."""
ETA = {"tc_soft_paper": 4, "tc_soft_thesis": 16}


def pose(x: float = 0.0, y: float = 0.0) -> np.ndarray:
    out = np.eye(4)
    out[:2, 3] = x, y
    return out


def trembling(x: float, frame: int) -> np.ndarray:
    """A place that changes with every frame by next to nothing: what stays where it is would rest, and be no mover."""
    return pose(x + 1e-6 * (frame % 2))


def leaving() -> Scene:
    """The box hovers, then jumps out of the light."""
    scene = small.box_on_ground(LAMP)
    box = replace(
        scene.meshes[1],
        object_to_ws=lambda frame: trembling(0.0 if frame < LEAVES else 200.0, frame),
        moving=True,
    )
    return replace(scene, meshes=(scene.meshes[0], box))


class Walk:
    """Renders one frame after the other and shows what the shadow buffer then holds."""

    def __init__(self, scene: Scene, device: str, name: str, **params: Any) -> None:
        self.session = Session(Geometry(scene, device), width=SIZE[0], height=SIZE[1], device=device)
        plugin: Any = find(name)
        self.technique = plugin(plugin.Params(**{"resolution": 256, "overscan": 0.0, **params}))
        self.index = 0

    def frames(self, count: int) -> list[FrameResult]:
        out = []
        for _ in range(count):
            self.session.begin(self.index)
            out.append(self.session.render(self.technique))
            self.session.advance()
            self.index += 1
        return out

    @property
    def texels(self) -> np.ndarray:
        held: np.ndarray = self.session.history("shadow buffer", lambda: None).previous.numpy()
        return held


# ---- leaving ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("movers", ["disocclude", "at_once", "gradual"])
@pytest.mark.parametrize("name", BOTH)
def test_what_leaves_is_gone_in_time(name: str, movers: str, device: str) -> None:
    """In one frame, or for ``gradual`` in as many as the start counts for; and nothing of it comes back."""
    walk = Walk(leaving(), device, name, movers=movers, **STARTS[name])
    before = walk.frames(LEAVES)[-1].visibility
    assert np.nanmean(before < 0.5) > 0.02
    due = ETA[name] if movers == "gradual" else 1
    after = [1.0 - np.nanmin(result.visibility) for result in walk.frames(due + 4)]
    assert max(after[due - 1 :]) < 0.05, after
    assert max(after[due:]) == 0.0, "nothing trails"
    if movers == "gradual":
        assert after[0] > 0.2, "it must fade, not vanish"


@pytest.mark.parametrize("name", BOTH)
def test_published_defaults_leave_no_trail(name: str, device: str) -> None:
    walk = Walk(leaving(), device, name)
    walk.frames(LEAVES)
    (result,) = walk.frames(1)
    np.testing.assert_array_equal(result.visibility[np.isfinite(result.visibility)], 1.0)


@pytest.mark.parametrize("name", BOTH)
def test_without_treatment_the_trail_lasts_as_long_as_the_shadow_stood(name: str, device: str) -> None:
    """n tests that were hidden, then k that are not: psi = n / (n + k), so that half is left after n frames."""
    walk = Walk(leaving(), device, name, movers="ignore", start="sample")
    walk.frames(LEAVES)
    umbra = walk.texels[..., 0] == LEAVES
    assert umbra.sum() > 20 and (walk.texels[..., 2] >= 0.0).all()
    after = walk.frames(LEAVES)
    for k in (1, 6, LEAVES):
        psi = 1.0 - after[k - 1].visibility[umbra]
        assert np.median(psi) == pytest.approx(LEAVES / (LEAVES + k), abs=0.02)  # its filter sees the penumbra, too


@pytest.mark.parametrize("decrement", [1.0, 4.0])
@pytest.mark.parametrize("name", BOTH)
def test_sums_fade_as_the_equations_say(name: str, decrement: float, device: str) -> None:
    """Equations 5.15 to 5.17 with the frame's own test: psi falls linearly and n by the decrement, down to that test."""
    walk = Walk(leaving(), device, name, movers="gradual", mover_decrement=decrement, **STARTS[name])
    walk.frames(LEAVES)
    eta = ETA[name]
    start = walk.texels
    tagged = (start[..., 2] < 0.0) & (start[..., 1] == eta) & (start[..., 0] > 0.0)
    assert tagged.sum() > 50
    psi, n = start[tagged, 0] / eta, float(eta)
    while psi.max() > 0.0:
        walk.frames(1)
        left = max(n - decrement - 1.0, 0.0)
        psi, n = psi * left / (left + 1.0), left + 1.0
        held = walk.texels[tagged]
        if left == 0.0 and name == "tc_soft_paper":
            n = float(eta)  # nothing is left, and so it starts anew
        np.testing.assert_allclose(held[:, 1], n, atol=1e-5)
        np.testing.assert_allclose(held[:, 0] / n, psi, atol=1e-5)
        assert ((held[:, 2] < 0.0) == (left > 0.0)).all(), "the tag lasts for as long as there is something left"


@pytest.mark.parametrize("name", BOTH)
def test_tags_lie_where_a_mover_casts(name: str, device: str) -> None:
    """Under a static and a moving plate: the sign of the eye depth is that of the caster nearest to the light."""
    for movers in ("at_once", "gradual", "disocclude", "ignore"):
        walk = Walk(overlapping(), device, name, movers=movers, filter=False, start="sample")
        walk.frames(3)
        tagged = walk.texels[..., 2] < 0.0
        if movers in ("disocclude", "ignore"):
            assert not tagged.any()
        else:
            shadowed = walk.texels[..., 0] > 0.0
            assert tagged.sum() > 50 and not (tagged & ~shadowed).any() and (shadowed & ~tagged).sum() > 100


# ---- flicker ------------------------------------------------------------------------------------------------------------


def overlapping() -> Scene:
    """A high static plate with a wide penumbra, and a low one that trembles."""
    low = small.mesh("low", small.plane(1.4, 1.5, (1.0, 0.6)), receives=False)
    return small.scene(
        [
            small.mesh("ground", small.plane(12.0), casts=False),
            small.mesh("high", small.plane(2.0, 4.0, (0.5, 0.2)), receives=False),
            replace(low, object_to_ws=lambda frame: trembling(0.0, frame), moving=True),
        ],
        LAMP,
    )


def flicker(scene: Scene, device: str, name: str, regions: tuple[np.ndarray, ...], **params: Any) -> list[float]:
    """Root mean square change from frame to frame in each region, frames 16 to 32."""
    frames = Walk(scene, device, name, **params).frames(32)[16:]
    changes = [b.visibility - a.visibility for a, b in pairwise(frames)]
    return [float(np.mean([np.sqrt(np.mean(change[region] ** 2)) for change in changes])) for region in regions]


@pytest.mark.parametrize("name", BOTH)
def test_moving_shadows_flicker_over_static_penumbrae(name: str, device: str) -> None:
    """What both sources admit, measured: next to nothing moves, so that every change is noise."""
    scene = overlapping()
    reference: Any = find("reference_multisample")

    def seen(*names: str) -> np.ndarray:
        session = Session(
            Geometry(replace(scene, meshes=tuple(m for m in scene.meshes if m.name in ("ground", *names))), device),
            width=SIZE[0],
            height=SIZE[1],
            device=device,
        )
        out: np.ndarray = session.render(reference(reference.Params(samples=256))).visibility
        return out

    high, low = seen("high"), seen("low")
    penumbra = (high > 0.1) & (high < 0.9)
    both = penumbra & (low < 0.95)
    static = penumbra & ~binary_dilation(low < 1.0, iterations=10)  # beyond the reach of a filter
    assert both.sum() > 30 and static.sum() > 100
    rows = {
        m: flicker(scene, device, name, (both, static), movers=m)
        for m in ("disocclude", "at_once", "gradual", "ignore")
    }
    print(name, {m: [round(v, 4) for v in row] for m, row in rows.items()})
    for movers in ("disocclude", "at_once", "gradual"):
        assert rows[movers][0] > 2.0 * rows[movers][1], rows
        assert rows[movers][1] == pytest.approx(rows["ignore"][1], rel=0.2), "static shadows keep their history"
    assert rows["ignore"][0] < 0.5 * rows["gradual"][0], rows


# ---- surfaces that move -------------------------------------------------------------------------------------------------


def rising_tray() -> Scene:
    scene = small.box_on_ground(LAMP)
    tray = small.mesh("tray", small.plane(16.0, 0.2), casts=False)
    return replace(
        scene, meshes=(*scene.meshes, replace(tray, object_to_ws=lambda f: pose(0.0, 0.02 * f), moving=True))
    )


@pytest.mark.parametrize("name", BOTH)
def test_a_surface_that_moves_can_be_followed(name: str, device: str) -> None:
    """A tray that rises under a static box is new in every frame, unless its own motion is followed."""
    errors, images = {}, {}
    for surfaces in ("camera", "own_motion"):
        walk = Walk(rising_tray(), device, name, filter=False, mover_surfaces=surfaces, mover_samples=8.0)
        errors[surfaces] = walk.frames(24)[-1]
        images[surfaces] = walk.texels[..., 1]
    receives = np.isfinite(errors["camera"].visibility)
    assert (errors["camera"].standard_error[receives] == 1.0).all()
    followed = errors["own_motion"].standard_error[receives] < 1.0
    assert followed.mean() > 0.95, "only what enters at the border is new"
    assert images["own_motion"].max() == 9.0, "8 samples that were kept, and the frame's own"
    truth = true_visibility(rising_tray(), device, 23, size=SIZE)
    error = {surfaces: rmse(result.visibility, truth) for surfaces, result in errors.items()}
    assert error["own_motion"] < 0.6 * error["camera"], error
    print(name, error)


@pytest.mark.parametrize("name", BOTH)
def test_following_changes_nothing_where_nothing_moves(name: str, device: str) -> None:
    scene = small.cluttered(LAMP)
    images = [Walk(scene, device, name, mover_surfaces=s).frames(3)[-1].visibility for s in ("camera", "own_motion")]
    np.testing.assert_array_equal(*images)
