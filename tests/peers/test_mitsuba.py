"""The ray-cast reference against Mitsuba 3, pixel by pixel, on scenes with real meshes.

Everything on Mitsuba's side is its own: camera rays, ray tracing, points on the emitter, random numbers. What is estimated
is the same quantity: the share of the emitter's area that a pixel's receiver point sees. Both estimates carry a standard
error, and their difference is held to a two-sided z-test whose significance is Sidak-corrected for the number of pixels
(as in Mitsuba's own rendering tests).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from experiments import reference_visibility, render_visibility
from experiments.scenes import load_scene
from wkernels.scene.lights import RectangleLight
from wkernels.scene.model import Mesh, Scene

pytestmark = pytest.mark.peers

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
WIDTH, HEIGHT, SAMPLES = 160, 120, 256
BATCH = 32  # samples of all pixels that Mitsuba traces at once
SIGNIFICANCE = 0.01

XML = """\
<scene version="3.0.0">
  <sensor type="{sensor}">
    {lens}
    <float name="near_clip" value="0.5"/><float name="far_clip" value="60"/>
    <transform name="to_world">{scale}<lookat origin="3, 4, 9" target="0, 0.8, 0" up="0.1, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/></film>
  </sensor>
  <shape type="rectangle"><transform name="to_world"><scale value="20"/><rotate x="1" angle="-90"/></transform></shape>
  <shape type="cube">
    <transform name="to_world">
      <scale x="0.5" y="0.9" z="0.4"/><rotate y="1" angle="40"/><rotate z="1" angle="-15"/><translate x="-1.4" y="1.5"/>
    </transform>
  </shape>
  <shape type="cube">
    <transform name="to_world">
      <matrix value="0.3 0.1 0 1.4  0 0.8 0.2 1.3  0.1 0 -0.4 0.3  0 0 0 1"/>
    </transform>
  </shape>
  <shape type="rectangle">
    <transform name="to_world"><scale x="1" y="0.6"/><rotate x="1" angle="100"/><translate x="0.5" y="7"/></transform>
    <emitter type="area"><rgb name="radiance" value="1"/></emitter>
  </shape>
</scene>
"""


@pytest.fixture(scope="module")
def mi() -> Any:
    mitsuba = pytest.importorskip("mitsuba")
    try:
        mitsuba.set_variant("llvm_ad_mono")
        mitsuba.Float([1.0, 2.0]).numpy()
    except Exception as error:
        pytest.skip(f"Mitsuba's vectorised variant needs an LLVM library: {error}")
    return mitsuba


def as_shape(mi: Any, mesh: Mesh, frame: int) -> Any:
    pose = mesh.object_to_ws(frame)
    corners = (mesh.vertices @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    shape = mi.Mesh(mesh.name, vertex_count=len(corners), face_count=len(mesh.faces))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = corners.ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    return shape


def as_emitter(mi: Any, light: RectangleLight, towards: np.ndarray) -> dict[str, Any]:
    """Mitsuba's rectangle spans [-1, 1]^2 and emits along +z only."""
    half_u, half_v = 0.5 * light.edge_u, 0.5 * light.edge_v
    normal = np.cross(half_u, half_v)
    if normal @ (towards - light.center) < 0.0:
        half_u, half_v, normal = half_v, half_u, -normal
    to_world = np.eye(4)
    to_world[:3] = np.stack([half_u, half_v, normal / np.linalg.norm(normal), light.center], axis=1)
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(to_world.tolist()),
        "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 1.0}},
    }


def mitsuba_visibility(mi: Any, scene: Scene, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Visibility, standard error (H, W) and seen points (H, W, 3); NaN where nothing is hit."""
    camera, (light,) = scene.camera(frame), scene.lights
    assert isinstance(light, RectangleLight)
    assert all(mesh.casts and mesh.receives for mesh in scene.meshes), "Mitsuba knows no such switches"
    content: dict[str, Any] = {
        "type": "scene",
        "light": as_emitter(mi, light, camera.target),
        "sensor": {
            "type": "perspective",
            "fov": camera.fov_deg,
            "fov_axis": "y",
            "near_clip": camera.near,
            "far_clip": camera.far,
            "to_world": mi.ScalarTransform4f().look_at(
                origin=camera.eye.tolist(), target=camera.target.tolist(), up=camera.up.tolist()
            ),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT},
        },
    }
    content |= {f"mesh_{i}": as_shape(mi, mesh, frame) for i, mesh in enumerate(scene.meshes)}
    return traced(mi, mi.load_dict(content))


def traced(mi: Any, built: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of a scene of Mitsuba's with one emitter, through its first sensor."""
    column, row = (np.tile(index.ravel(), BATCH) for index in np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)))
    position = mi.Point2f(((column + 0.5) / WIDTH).astype(np.float32), ((row + 0.5) / HEIGHT).astype(np.float32))
    sampler = mi.load_dict({"type": "independent"})
    count = np.zeros((HEIGHT, WIDTH))
    for batch in range(SAMPLES // BATCH):
        sampler.seed(batch, len(column))
        ray, _ = built.sensors()[0].sample_ray(0.0, 0.5, position, mi.Point2f(0.5, 0.5))
        hit = built.ray_intersect(ray)
        way, weight = built.sample_emitter_direction(hit, sampler.next_2d(), True)
        normal, to_light = np.asarray(hit.n), np.asarray(way.d)
        # a diffuse surface reflects nothing of what comes from behind it, however thin it is
        front = np.sum(normal * to_light, axis=0) * np.sum(normal * np.asarray(ray.d), axis=0) < 0.0
        count += np.sum((front & (np.asarray(weight)[0] > 0.0)).reshape(BATCH, HEIGHT, WIDTH), axis=0)
    seen = np.asarray(hit.is_valid()) & ~np.asarray(hit.emitter(built) != None)  # noqa: E711 (element-wise)
    seen = seen.reshape(BATCH, HEIGHT, WIDTH)[0]
    share = np.where(seen, count / SAMPLES, np.nan)
    points = np.asarray(hit.p).T.reshape(BATCH, HEIGHT, WIDTH, 3)[0]
    return share, np.sqrt(share * (1.0 - share) / (SAMPLES - 1)), np.where(seen[..., None], points, np.nan)


def rejected(difference: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Pixels whose difference is significant, all tests together at the level ``SIGNIFICANCE``."""
    level = -np.expm1(np.log1p(-SIGNIFICANCE) / difference.size)
    limit = norm.isf(0.5 * level)
    return np.abs(difference) > np.maximum(limit * error, 1e-6)


@pytest.mark.parametrize("name", ["bunny", "overlap"])
def test_reference_agrees_with_mitsuba(mi: Any, name: str) -> None:
    scene = load_scene(SCENES / f"{name}.yaml")
    agree(name, scene, *mitsuba_visibility(mi, scene, frame=0))


@pytest.mark.parametrize("sensor", ["perspective", "orthographic"])
def test_imported_xml_agrees_with_mitsuba(mi: Any, tmp_path: Path, sensor: str) -> None:
    """Mitsuba reads the file itself: shapes, transforms, camera and emitter mean the same to both."""
    lens = '<float name="fov" value="40"/>' if sensor == "perspective" else ""
    scale = '<scale value="4"/>' if sensor == "orthographic" else ""
    (tmp_path / "scene.xml").write_text(XML.format(sensor=sensor, lens=lens, scale=scale, width=WIDTH, height=HEIGHT))
    scene = load_scene({"import": str(tmp_path / "scene.xml")})
    agree(f"XML, {sensor}", scene, *traced(mi, mi.load_file(str(tmp_path / "scene.xml"))))


def agree(name: str, scene: Scene, theirs: np.ndarray, their_error: np.ndarray, points: np.ndarray) -> None:
    """Holds the reference to Mitsuba's visibility, standard error and seen points."""
    result = render_visibility(scene, "reference_multisample", {"samples": SAMPLES}, width=WIDTH, height=HEIGHT)
    ours, our_error = result.visibility, result.standard_error
    # the two see the same surface in all but the pixels that a silhouette crosses within float32 rounding
    apart = np.linalg.norm(result.world_position - points, axis=-1)
    both = np.isfinite(ours) & np.isfinite(theirs) & (apart < 1e-3)
    assert both.sum() >= 0.999 * max(np.isfinite(ours).sum(), np.isfinite(theirs).sum())
    difference = (ours - theirs)[both].astype(np.float64)
    error = np.hypot(our_error, their_error)[both]
    soft = (ours[both] > 0.0) & (ours[both] < 1.0)
    assert soft.mean() > 0.02, "the picture must show a penumbra"
    passed = 1.0 - rejected(difference, error).mean()
    z_squared = float(np.mean((difference[soft] / error[soft]) ** 2))
    figures = {
        "pixels": int(both.sum()),
        "of the union": float(both.sum() / (np.isfinite(ours) | np.isfinite(theirs)).sum()),
        "in the penumbra": float(soft.mean()),
        "passed": float(passed),
        "mean z^2 in the penumbra": z_squared,
        "rms difference": float(np.sqrt(np.mean(difference**2))),
        "mean difference": float(np.mean(difference)),
    }
    print(f"\n{name}: " + ", ".join(f"{key} {value:.5g}" for key, value in figures.items()))
    assert passed >= 0.9975
    # Mitsuba's points are independent and ours are better than that: z^2 is below 1 unless something is wrong
    assert z_squared < 1.0
    assert abs(np.mean(difference)) < 1e-3


def test_a_wrong_reference_is_rejected(mi: Any) -> None:
    """The same comparison against the shadow of a light half a size off must fail."""
    scene = load_scene(SCENES / "bunny.yaml")
    theirs, their_error, _ = mitsuba_visibility(mi, scene, frame=0)
    moved = replace(scene, lights=(scene.lights[0].moved(np.array([0.6, 0.0, 0.0])),))
    ours, our_error = reference_visibility(moved, samples=SAMPLES, width=WIDTH, height=HEIGHT, cache=False)
    both = np.isfinite(ours) & np.isfinite(theirs)
    wrong = rejected((ours - theirs)[both], np.hypot(our_error, their_error)[both])
    assert wrong.mean() > 0.0025
