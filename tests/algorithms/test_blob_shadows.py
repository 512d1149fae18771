"""blob_shadows: the ellipsoids, the formula of the blob against a NumPy twin, and how wrong it is."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from filtering_sessions import render, session, technique
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from algorithms.plugins import find
from wkernels.casters.blobs import bounding_ellipsoid, placed_ellipsoid
from wkernels.scene.lights import DirectionalLight, Light, PointLight
from wkernels.scene.model import Mesh, Scene

LIGHTS: dict[str, Light] = {
    "point": PointLight(position=np.array([1.0, 9.0, -2.0])),
    "directional": DirectionalLight(direction=np.array([0.3, -1.0, 0.2])),
}


def test_the_ellipsoid_of_a_box_goes_through_its_corners() -> None:
    """Half axes sqrt(3) times the box's: the moments of eight corners have its shape."""
    vertices = small.box((1.0, 2.0, 3.0), (2.0, 1.0, 4.0))[0]
    found = bounding_ellipsoid(vertices)
    assert found is not None
    np.testing.assert_allclose(found.centre, (1.0, 2.0, 3.0), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm((vertices - found.centre) @ found.to_unit.T, axis=1), 1.0, rtol=1e-9)
    np.testing.assert_allclose(found.axes @ found.axes.T, np.diag([3.0, 0.75, 12.0]), rtol=1e-9, atol=1e-9)
    assert found.size == pytest.approx(2.0 * np.sqrt(12.0))


@pytest.mark.parametrize("shape", [small.sphere((0.0, 1.0, 0.0), 0.7), small.random_boxes(3, seed=2), small.plane(2.0)])
def test_the_ellipsoid_holds_its_mesh(shape: small.Triangles) -> None:
    found = bounding_ellipsoid(shape[0])
    assert found is not None
    reach = np.linalg.norm((shape[0] - found.centre) @ found.to_unit.T, axis=1)
    assert reach.max() == pytest.approx(1.0, rel=1e-9)


def test_a_pose_takes_the_ellipsoid_along() -> None:
    vertices, faces = small.random_boxes(1, seed=3)
    pose = np.eye(4)
    pose[:3, :3] = 2.0 * Rotation.from_rotvec([0.3, -0.4, 0.9]).as_matrix()
    pose[:3, 3] = (5.0, -1.0, 2.0)
    mesh = Mesh("box", vertices, faces, object_to_ws=lambda frame: pose)
    origin = np.array([4.0, 0.0, 1.0])
    placed = placed_ellipsoid(bounding_ellipsoid(vertices), mesh, 0, origin)
    assert placed is not None
    moved = vertices @ pose[:3, :3].T + pose[:3, 3] - origin
    assert np.linalg.norm((moved - placed.centre) @ placed.to_unit.T, axis=1).max() == pytest.approx(1.0, rel=1e-9)
    pose[:3, :3] = 0.0
    assert placed_ellipsoid(bounding_ellipsoid(vertices), mesh, 0, origin) is None


@pytest.mark.parametrize("vertices", [np.zeros((0, 3)), np.zeros((4, 3)), np.full((3, 3), np.nan)])
def test_no_ellipsoid_without_two_points(vertices: np.ndarray) -> None:
    assert bounding_ellipsoid(vertices) is None


def test_a_caster_of_many_vertices_needs_no_matrix_of_their_square() -> None:
    """A hundred thousand would take 80 GB, as the conifers of `winter` did."""
    vertices = np.random.default_rng(5).normal(size=(100_000, 3)) * (3.0, 2.0, 1.0)
    found = bounding_ellipsoid(vertices)
    assert found is not None
    distances = np.linalg.norm((vertices - found.centre) @ found.to_unit.T, axis=1)
    assert distances.max() == pytest.approx(1.0)


def blob_twin(scene: Scene, position: np.ndarray, params: dict[str, float], along: str) -> np.ndarray:
    """The formula of the docstring for the scene's one caster, in float64."""
    caster = next(mesh for mesh in scene.meshes if mesh.casts)
    found = bounding_ellipsoid(caster.vertices)
    assert found is not None
    light = scene.lights[0].centre
    way = np.broadcast_to([0.0, 1.0, 0.0], position.shape) if along == "down" else light[:3] - position * light[3]
    offset, line = (found.centre - position) @ found.to_unit.T, way @ found.to_unit.T
    at = np.sum(offset * line, axis=-1) / np.sum(line * line, axis=-1)
    d = np.linalg.norm(offset - line * at[..., None], axis=-1)
    t = np.clip((d - params["inner"]) / (params["outer"] - params["inner"]), 0.0, 1.0)
    h = at * np.linalg.norm(way, axis=-1) / found.size
    return 1.0 - params["strength"] * (1.0 - t * t * (3.0 - 2.0 * t)) * np.maximum(1.0 - h / params["fade"], 0.0)


@pytest.mark.parametrize("along", ["light", "down"])
@pytest.mark.parametrize("lamp", LIGHTS)
def test_a_blob_is_its_formula(lamp: str, along: str) -> None:
    scene = small.box_on_ground(LIGHTS[lamp])
    params = {"strength": 0.8, "inner": 0.3, "outer": 1.2, "fade": 3.0}
    result = render(scene, "blob_shadows", along=along, **params)
    seen = np.isfinite(result.visibility)
    expected = blob_twin(scene, result.world_position[seen].astype(float), params, along)
    np.testing.assert_allclose(result.visibility[seen], expected, atol=2e-5)  # float32 positions
    assert 0.1 < expected.min() < 0.9 and expected.max() == 1.0


def test_a_blob_fades_with_height_and_darkens_nothing_above_or_beyond() -> None:
    ground = small.mesh("ground", small.plane(12.0), casts=False)
    darkest = []
    for height in (0.5, 2.0, 6.0, 12.0):  # the last one beyond the light
        box = small.mesh("box", small.box((0.0, height, 0.0), (1.0, 0.5, 1.0)), receives=False)
        result = render(small.scene([ground, box], PointLight(position=np.array([0.0, 10.0, 0.0]))), "blob_shadows")
        darkest.append(float(np.nanmin(result.visibility)))
    assert darkest[0] < darkest[1] < darkest[2] < 1.0 and darkest[3] == 1.0


def test_a_mesh_does_not_darken_itself() -> None:
    ball = small.mesh("ball", small.sphere((0.0, 1.5, 0.0), 1.2, 300))
    scene = small.scene([small.mesh("ground", small.plane(12.0), casts=False), ball], LIGHTS["point"])
    image = render(scene, "blob_shadows")
    body = image.world_position[..., 1] > 0.05
    assert set(np.unique(image.visibility[body])) == {0.0, 1.0}, "only what is turned away is dark"
    assert np.nanmin(image.visibility[~body]) < 0.3


def test_it_is_wrong_by_design() -> None:
    """Expected artefact: the rmse is several times a shadow map's, and right in the mean position all the same."""
    scene = small.box_on_ground(LIGHTS["point"])
    rays = render(scene, "ray_cast_point_shadow").visibility
    error = {name: rmse(render(scene, name).visibility, rays) for name in ("blob_shadows", "shadow_map")}
    assert 0.03 < error["blob_shadows"] < 0.25 and error["blob_shadows"] > 2.0 * error["shadow_map"], error


def test_the_sign_is_that_of_the_casters_pieces() -> None:
    """Too light where a caster in one piece floats, hardly wrong where it rests, too dark with a piece apart."""
    ground = small.mesh("ground", small.plane(12.0), casts=False)

    def mean_error(*boxes: tuple[tuple[float, ...], tuple[float, ...]]) -> float:
        shapes, vertices, faces = [small.box(*box) for box in boxes], [], []
        for corners, triangles in shapes:
            faces.append(triangles + sum(map(len, vertices)))
            vertices.append(corners)
        caster = small.mesh("caster", (np.concatenate(vertices), np.concatenate(faces)), receives=False)
        scene = small.scene([ground, caster], LIGHTS["directional"])
        error = [render(scene, name).visibility for name in ("blob_shadows", "ray_cast_point_shadow")]
        return float(np.nanmean(error[0] - error[1]))

    rests, piece = ((0.0, 0.5, 0.0), (1.0, 1.0, 1.0)), (0.3, 0.3, 0.3)
    assert mean_error(((0.0, 6.0, 0.0), (2.0, 2.0, 2.0))) > 0.004
    assert abs(mean_error(rests)) < 0.003
    apart = [mean_error(rests, ((x, 0.15, 0.0), piece)) for x in (2.0, 5.0, 40.0)]
    assert -0.005 > apart[0] > apart[1] > apart[2], apart
    around = [((x, 0.15, z), piece) for x in (-20.0, 20.0) for z in (-20.0, 20.0)]
    assert mean_error(rests, *around) < -0.4, "all of the picture is under one blob"


def test_blobs_follow_what_moves_and_are_kept_else() -> None:
    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = 0.8 * frame
        return out

    box = Mesh("box", *small.box((-1.0, 1.5, 0.0), (1.5, 1.0, 1.5)), object_to_ws=pose, moving=True, receives=False)
    scene = small.scene([small.mesh("ground", small.plane(12.0), casts=False), box], LIGHTS["point"])
    running, made = session(scene), technique("blob_shadows")
    images = []
    for frame in (0, 3, 3):
        running.begin(frame)
        images.append(running.render(made))
        running.advance()
    assert np.nanmax(np.abs(images[0].visibility - images[1].visibility)) > 0.3
    np.testing.assert_array_equal(images[1].visibility, images[2].visibility)
    assert any(what == "blobs of casters" for what, _, _ in images[2].left_out)


def test_a_blob_without_a_ramp_is_refused() -> None:
    with pytest.raises(ValidationError, match="outer must be more than inner"):
        find("blob_shadows").Params(inner=1.0, outer=1.0)
