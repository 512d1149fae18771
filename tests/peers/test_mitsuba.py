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
import yaml
from PIL import Image
from scipy import ndimage
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
THROUGH = 0.02  # scene units: behind a card Mitsuba's ray goes on from a point beside it, which slanted ground shows

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


def with_texture_coordinates(mi: Any, mesh: Mesh, frame: int) -> Any:
    """A mesh that is cut out, with what its texture needs."""
    assert mesh.mask is not None
    pose = mesh.object_to_ws(frame)
    corners = (mesh.vertices @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32)
    shape = mi.Mesh(mesh.name, len(corners), len(mesh.faces), has_vertex_texcoords=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = corners.ravel()
    parameters["vertex_texcoords"] = mesh.mask.uv.astype(np.float32).ravel()
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
    for i, mesh in enumerate(scene.meshes):
        content[f"mesh_{i}"] = (as_shape if mesh.mask is None else with_texture_coordinates)(mi, mesh, frame)
    built = mi.load_dict(content)
    masked = [(i, mesh.mask) for i, mesh in enumerate(scene.meshes) if mesh.mask is not None]
    if not masked:
        return traced(mi, built)
    ((at, mask),) = masked
    texels = mi.TensorXf(np.asarray(mask.alpha, np.float32)[..., None])
    texture = mi.load_dict({"type": "bitmap", "data": texels, "raw": True, "wrap_mode": mask.wrap[0]})
    return traced_through_masks(mi, built, f"mesh_{at}", texture)


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


def traced_through_masks(mi: Any, built: Any, card: str, texture: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``traced`` where a shape is there only where its texture, as Mitsuba interpolates it, is one half or more.

    Of Mitsuba's ``mask`` this takes all but its own call, ``eval_null_transmission``: LLVM cannot compile that on some
    machines. Between 0 and 1 a mask would let a share of the rays through.
    """
    import drjit as dr

    column, row = (np.tile(index.ravel(), BATCH) for index in np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)))
    position = mi.Point2f(((column + 0.5) / WIDTH).astype(np.float32), ((row + 0.5) / HEIGHT).astype(np.float32))
    sampler = mi.load_dict({"type": "independent"})
    count = np.zeros((HEIGHT, WIDTH))
    cut = mi.ShapePtr(next(shape for shape in built.shapes() if shape.id() == card))

    def first_solid(ray: Any) -> Any:
        hit = built.ray_intersect(ray)
        while True:
            through = hit.is_valid() & (hit.shape == cut) & (texture.eval_1(hit) < 0.5)
            if not np.asarray(through).any():
                return hit
            on = hit.spawn_ray(ray.d)
            on.maxt = ray.maxt - hit.t
            on.maxt = mi.Float(np.where(np.asarray(through), np.asarray(on.maxt), -1.0))
            further = built.ray_intersect(on)
            hit = dr.select(through, further, hit)

    for batch in range(SAMPLES // BATCH):
        sampler.seed(batch, len(column))
        ray, _ = built.sensors()[0].sample_ray(0.0, 0.5, position, mi.Point2f(0.5, 0.5))
        hit = first_solid(ray)
        way, weight = built.sample_emitter_direction(hit, sampler.next_2d(), False)
        normal, to_light = np.asarray(hit.n), np.asarray(way.d)
        front = np.sum(normal * to_light, axis=0) * np.sum(normal * np.asarray(ray.d), axis=0) < 0.0
        end = first_solid(hit.spawn_ray_to(way.p))
        # each card that a ray passes shifts it a little, so that it may reach the light itself
        blocked = np.asarray(end.is_valid()) & ~np.asarray(end.emitter(built) != None)  # noqa: E711 (element-wise)
        lit = front & ~blocked & (np.asarray(weight)[0] > 0.0)
        count += np.sum(lit.reshape(BATCH, HEIGHT, WIDTH), axis=0)
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


def test_masks_agree_with_mitsubas(mi: Any, tmp_path: Path) -> None:
    """A bitmap mask in a file that both read: on a card above the ground, which casts and receives."""
    rng = np.random.default_rng(5)
    texels = 255 * (ndimage.gaussian_filter(rng.random((24, 24)), 1.2, mode="wrap") > 0.5).astype(np.uint8)
    Image.fromarray(texels).save(tmp_path / "leaf.png")
    card = """<shape type="rectangle" id="card"><transform name="to_world"><scale x="2.2" y="1.6"/><rotate x="1" angle="-70"/>
        <translate x="0.3" y="1.6" z="0.5"/></transform>
        <bsdf type="mask"><texture type="bitmap" name="opacity"><string name="filename" value="leaf.png"/>
        <boolean name="raw" value="true"/></texture>
        <bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf></shape></scene>"""
    lens = '<float name="fov" value="40"/>'
    text = XML.format(sensor="perspective", lens=lens, scale="", width=WIDTH, height=HEIGHT)
    (tmp_path / "scene.xml").write_text(text.replace("</scene>", card))
    scene = load_scene({"import": str(tmp_path / "scene.xml")})
    texture = mi.load_dict({"type": "bitmap", "filename": str(tmp_path / "leaf.png"), "raw": True})
    theirs = traced_through_masks(mi, mi.load_file(str(tmp_path / "scene.xml")), "card", texture)
    agree("mask", scene, *theirs, near=THROUGH)


def test_the_hedge_agrees_with_mitsuba(mi: Any) -> None:
    """Leaf cards as meshes of Mitsuba's with a mask of its own, whose opacity counts from one half on."""
    # fewer cards than the scene has: each of Mitsuba's rays is cast again behind every one that it passes
    hedge = {"generate": "hedge", "triangles": 800, "card": 0.5}
    lawn = {"primitive": "plane", "size": [14, 14]}
    sun = {"kind": "point", "position": [0, 9, 0]}
    scene = load_scene(
        {**yaml.safe_load((SCENES / "hedge.yaml").read_text()), "meshes": [lawn, hedge], "lights": [sun]}
    )
    lamp = RectangleLight(
        center=np.array([3.0, 7.0, -4.0]), edge_u=np.array([0.7, 0.0, 0.0]), edge_v=np.array([0.0, 0.3, 0.5])
    )
    scene = replace(scene, lights=(lamp,))
    # a ray that went on beside a card is off by a hundredth of a pixel, where every pixel has the outlines of leaves
    agree("hedge", scene, *mitsuba_visibility(mi, scene, frame=0), near=THROUGH, same=0.995)


def agree(
    name: str,
    scene: Scene,
    theirs: np.ndarray,
    their_error: np.ndarray,
    points: np.ndarray,
    near: float = 1e-3,
    same: float = 0.999,
) -> None:
    """Holds the reference to Mitsuba's visibility, standard error and seen points.

    At least the share ``same`` of the pixels must show the same point in both, to the distance ``near``.
    """
    result = render_visibility(scene, "reference_multisample", {"samples": SAMPLES}, width=WIDTH, height=HEIGHT)
    ours, our_error = result.visibility, result.standard_error
    # the two see the same surface in all but the pixels that a silhouette crosses within float32 rounding
    apart = np.linalg.norm(result.world_position - points, axis=-1)
    both = np.isfinite(ours) & np.isfinite(theirs) & (apart < near)
    assert both.sum() >= same * max(np.isfinite(ours).sum(), np.isfinite(theirs).sum())
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
